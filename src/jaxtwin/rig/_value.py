"""A physical value of a rig: a number, or a number times parameters to powers.

A rig file says `"4 cm"` or names a parameter (`"R_E"`); rules such as "mass times specific heat"
multiply such values.
Keeping the product of parameters, instead of its number, lets a twin be evaluated, differentiated
and redrawn for other parameters without reading the file again.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Value:
    r"""A product $f \prod_i p_i^{e_i}$ of a number and parameters, in SI units.

    **Arguments:**

    - `factor`: the number $f$.
    - `powers`: pairs (parameter name $p_i$, exponent $e_i$). They are stored sorted by name, one
      pair for each name, without zero exponents, so that equal products compare equal.

    **Raises:** `ValueError` if the factor or an exponent is not a finite number.
    """

    factor: float | int
    powers: tuple[tuple[str, float | int], ...] = ()

    def __post_init__(self):
        exponents: dict[str, float] = {}
        for name, exponent in self.powers:
            exponents[name] = exponents.get(name, 0.0) + float(exponent)
        powers = tuple(sorted((n, e) for n, e in exponents.items() if e != 0))
        factor = float(self.factor)
        if not math.isfinite(factor) or not all(math.isfinite(e) for _, e in powers):
            raise ValueError(f"a value needs finite numbers, got {factor} and {powers}")
        object.__setattr__(self, "factor", factor)
        object.__setattr__(self, "powers", powers)

    @property
    def is_constant(self) -> bool:
        """Whether the value contains no parameter."""
        return not self.powers

    def evaluate(self, values_si: Mapping[str, Any]) -> Any:
        """The number for given parameters.

        **Arguments:**

        - `values_si`: name -> value in SI units, a float or an array; only plain arithmetic
          is done with it, so JAX arrays and tracers work and gradients flow.

        **Returns:** a float if the value is constant, else the result of the arithmetic.

        **Raises:** `KeyError` if a parameter is missing.
        """
        result: Any = self.factor
        for name, exponent in self.powers:
            result = _times_power(result, values_si[name], exponent)
        return result

    def __mul__(self, other: "Value | float | int") -> "Value":
        if isinstance(other, Value):
            return Value(self.factor * other.factor, self.powers + other.powers)
        if isinstance(other, int | float):
            return Value(self.factor * other, self.powers)
        return NotImplemented

    __rmul__ = __mul__

    def __truediv__(self, other: "Value | float | int") -> "Value":
        if isinstance(other, Value):
            inverse = tuple((name, -exponent) for name, exponent in other.powers)
            return Value(self.factor / other.factor, self.powers + inverse)
        if isinstance(other, int | float):
            return Value(self.factor / other, self.powers)
        return NotImplemented

    def __rtruediv__(self, other: float | int) -> "Value":
        return Value(other) / self

    def __pow__(self, exponent: float | int) -> "Value":
        if self.factor < 0 and exponent != int(exponent):
            raise ValueError(f"{self} is negative and has no real power {exponent}")
        return Value(self.factor**exponent, tuple((n, e * exponent) for n, e in self.powers))

    def __str__(self) -> str:
        names = [name if e == 1 else f"{name}^{e:g}" for name, e in self.powers]
        if not names:
            return f"{self.factor:g}"
        return " ".join(names if self.factor == 1 else [f"{self.factor:g}", *names])


def _times_power(result: Any, base: Any, exponent: float) -> Any:
    # A power costs a logarithm and an exponential and its gradient is NaN at 0; nearly all
    # exponents are 1 or -1, where neither is needed.
    if exponent == 1:
        return result * base
    if exponent == -1:
        return result / base
    if exponent == int(exponent):
        return result * base ** int(exponent)
    return result * base**exponent
