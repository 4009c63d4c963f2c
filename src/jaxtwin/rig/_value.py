"""The quantities of a rig: a value, which is a number or a number times parameters to powers, so
that a match can change it; a parameter, a row of the parameter table; and an input besides the
duty, such as the state of a lid, the speed of a fan or a measured voltage.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, final


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


# Whether there is one value for all recordings, one for each group, or one for each recording.
Scope = Literal["shared", "group", "recording"]


@final
@dataclass(frozen=True)
class Parameter:
    """A number that a rig leaves open to matching, sweeps and sensitivity analysis.

    **Arguments:**

    - `name`: a Python identifier, unique in the rig.
    - `value`, `lower`, `upper`: the value and its bounds in `unit`; a missing bound is infinite.
    - `unit`: the unit as in the rig file, for example `"K/W"` or `"degC"`.
    - `free`: whether matching may change it.
    - `scope`: `"shared"` by all recordings, or one value per `"group"` of them, such as a day, or
      per `"recording"`.
    - `description`: one line for tables.
    - `prior_spread`: the standard deviation of the prior: relative (that of the logarithm) if the
      lower bound is above 0 and the unit is not degC, otherwise in `unit`. None without a prior.
    - `prior_value`: the centre of the prior; by default the `value` in the rig file.
    - `group_spread`: for the scope `"group"`, the standard deviation of a group's value about the
      value that all groups share, measured as `prior_spread` is. `prior_spread` is then that of the
      shared value.
    - `scale`, `offset`: SI value = scale * value + offset; the offset is 0 except for degC.
    """

    name: str
    value: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = ""
    free: bool = False
    scope: Scope = "shared"
    description: str = ""
    scale: float = 1.0
    offset: float = 0.0
    prior_spread: float | None = None
    prior_value: float | None = None
    group_spread: float | None = None

    @property
    def standard_deviation(self) -> float | None:
        """The prior standard deviation of a single value: that of the shared value, combined with
        that of a group about it. None without a prior."""
        if self.prior_spread is None or self.group_spread is None:
            return self.prior_spread
        return math.hypot(self.prior_spread, self.group_spread)

    @property
    def is_logarithmic(self) -> bool:
        """Whether the parameter is matched by its logarithm: it is above 0 and its unit is not
        degC."""
        return self.lower > 0 and self.offset == 0

    def to_entry(self, value: float) -> float:
        """Returns the entry of a value in the vector of a match: its logarithm, or the value
        itself."""
        return math.log(value) if self.is_logarithmic else value

    def from_entry(self, entry: float) -> float:
        """Returns the value of an entry in the vector of a match."""
        return math.exp(entry) if self.is_logarithmic else entry

    def to_si(self, value: Any) -> Any:
        """A value (float or array) given in `unit`, in SI units."""
        return self.scale * value + self.offset

    def from_si(self, value: Any) -> Any:
        """A value (float or array) given in SI units, in `unit`."""
        return (value - self.offset) / self.scale

    def __str__(self) -> str:
        bounds = f"{self.lower:g} ... {self.upper:g}"
        kind = f"{'free' if self.free else 'fixed'}, {self.scope}"
        return f"{self.name} = {self.value:g} {self.unit} ({bounds}; {kind})".replace("  ", " ")


@final
@dataclass(frozen=True)
class Input:
    """A quantity that changes during a run and is known, such as a column of a recording.

    An input has states, such as `("closed", "open")`, or is a number with a unit.

    **Arguments:**

    - `name`: a Python identifier, unique among the inputs and parameters of the rig.
    - `value`: its value where none is stated, in `unit`; for states, the position of one of them.
    - `unit`: the unit as in the rig file.
    - `states`: the names of its states, in the order of their numbers 0, 1, ...; none for a number.
    - `description`: one line for tables.
    - `scale`, `offset`: SI value = scale * value + offset.
    """

    name: str
    value: float
    unit: str = ""
    states: tuple[str, ...] = ()
    description: str = ""
    scale: float = 1.0
    offset: float = 0.0

    def share(self, state: str) -> str:
        """The name of the share of a state, 0 to 1, in a `Value`."""
        return f"{self.name}={state}"

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which a `Value` depends on this input."""
        return (self.name, *(self.share(state) for state in self.states))

    def shares(self, level: Any) -> dict[str, Any]:
        """The numbers of these names at a level of the input.

        A level between the numbers of two states, such as the mean over a step in which the lid is
        opened, is shared between them.

        **Arguments:**

        - `level`: the number of a state, or the value in SI units; a float or an array.
        """
        between = {
            self.share(state): _hat(level - number) for number, state in enumerate(self.states)
        }
        return {self.name: level, **between}

    @property
    def level(self) -> float:
        """Its value where none is stated: the number of a state, or the value in SI units."""
        return self.scale * self.value + self.offset

    @property
    def nominal(self) -> dict[str, float]:
        """The `shares` of its level where none is stated."""
        return self.shares(self.level)


def _hat(distance: Any) -> Any:
    """1 at 0, falling to 0 at a distance of 1."""
    nearness = 1 - abs(distance)
    return nearness * (nearness > 0)


@final
@dataclass(frozen=True)
class Switched:
    """A value for each state of an input: `{ closed = "R_wall", open = "R_open", by = "lid" }`.

    **Arguments:**

    - `values`: pairs (name of the share of a state, value in that state).
    """

    values: tuple[tuple[str, Value], ...]

    def __mul__(self, factor: Value | float | int) -> "Switched":
        return Switched(tuple((share, value * factor) for share, value in self.values))


def conductances(resistance: Value | Switched) -> tuple[Value, ...]:
    """The conductance of a resistance that inputs change, as the terms of a sum, W/K.

    A conductance is used because it stays finite where a fan stands still and where a path is
    closed; between two states it changes linearly.
    """
    if isinstance(resistance, Value):
        return (1 / resistance,)
    return tuple(Value(1.0, ((share, 1.0),)) / value for share, value in resistance.values)


def depends_on(value: Value, inputs: tuple[Input, ...]) -> bool:
    """Whether a value depends on one of these inputs."""
    names = {name for rig_input in inputs for name in rig_input.names}
    return any(name in names for name, _ in value.powers)


def nominal_inputs(inputs: tuple[Input, ...]) -> Mapping[str, float]:
    """The numbers of all inputs where none is stated, by the names that a `Value` has for them."""
    return {name: number for rig_input in inputs for name, number in rig_input.nominal.items()}
