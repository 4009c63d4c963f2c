"""The joint distribution of the parameters of a global analysis, and the distributions of single
ones.
"""

import abc
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .._arguments import finite_number
from ..errors import ParameterError
from ._sampling import MAX_NORMAL_SCORE

# A probability that replaces 0. It is smaller than any other number of a generator of float64. The
# quantile of 0 is the end of a distribution, where a resistance may be 0.
MIN_PROBABILITY = 2.0**-54

# The probability on each side that a grid leaves out if a distribution has tails.
TAIL = 0.025

# The name and the numbers of a distribution, as in SALib's `dists` and `bounds`.
SALibDistribution = tuple[Literal["unif", "norm", "truncnorm", "lognorm"], list[float]]


class AbstractMarginal(abc.ABC):
    """The distribution of a single parameter, in the unit of the rig's table.

    - `tail`: the probability on each side that a grid of levels leaves out; 0 without tails.
    - `polynomials`: the family of polynomials that are orthogonal under this distribution, for
      polynomial chaos.
    """

    tail: float
    polynomials: Literal["legendre", "hermite"]

    @abc.abstractmethod
    def quantile(self, probability: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The values below which the parameter lies with these probabilities."""

    @abc.abstractmethod
    def poincare_weight(self, values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        r"""The weight $w$ of Poincaré's inequality, $\operatorname{var}(f) \le E[(w f')^2]$ for
        every smooth function $f$ of the parameter: the smallest weight, if it is known."""

    @abc.abstractmethod
    def to_salib(self) -> SALibDistribution:
        """The distribution as SALib writes it."""


@final
@dataclass(frozen=True)
class Normal(AbstractMarginal):
    """A normal distribution, truncated at limits.

    **Arguments:**

    - `mean`, `std`: the mean and the standard deviation of the distribution before it is truncated.
    - `low`, `high`: the limits, infinite for no limit.

    **Raises:** `ParameterError` if the standard deviation is not above 0, or the limits leave
    nothing between them.
    """

    mean: float
    std: float
    low: float = -math.inf
    high: float = math.inf

    tail = TAIL
    polynomials = "hermite"

    def __post_init__(self) -> None:
        _check_finite("Normal", mean=self.mean, std=self.std)
        _check_positive("Normal: std", self.std)
        below, above = self._probabilities()
        if not below < above:
            raise ParameterError(
                f"Normal: expected limits with a part of the distribution between them, got "
                f"{self.low} to {self.high}"
            )

    def quantile(self, probability: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        below, above = self._probabilities()
        inside = below + _open(probability) * (above - below)
        return self.mean + self.std * ndtri(np.clip(inside, MIN_PROBABILITY, 1 - 2.0**-53))

    def poincare_weight(self, values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        # Cutting a normal distribution off makes the constant no larger (Bakry and Emery 1985).
        return np.full(np.shape(values), self.std)

    def to_salib(self) -> SALibDistribution:
        if math.isinf(self.low) and math.isinf(self.high):
            return "norm", [self.mean, self.std]
        farthest = MAX_NORMAL_SCORE * self.std
        low, high = max(self.low, self.mean - farthest), min(self.high, self.mean + farthest)
        return "truncnorm", [low, high, self.mean, self.std]

    def _probabilities(self) -> tuple[float, float]:
        low, high = (self.low - self.mean) / self.std, (self.high - self.mean) / self.std
        return float(ndtr(low)), float(ndtr(high))


@final
@dataclass(frozen=True)
class Uniform(AbstractMarginal):
    """A uniform distribution between two values.

    **Raises:** `ParameterError` if `low` is not below `high`, or a value is not finite.
    """

    low: float
    high: float

    tail = 0.0
    polynomials = "legendre"

    def __post_init__(self) -> None:
        _check_finite("Uniform", low=self.low, high=self.high)
        if not self.low < self.high:
            raise ParameterError(
                f"Uniform: expected low below high, got {self.low} and {self.high}"
            )

    def quantile(self, probability: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return self.low + probability * (self.high - self.low)

    def poincare_weight(self, values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.full(np.shape(values), (self.high - self.low) / math.pi)

    def to_salib(self) -> SALibDistribution:
        return "unif", [self.low, self.high]


@final
@dataclass(frozen=True)
class LogNormal(AbstractMarginal):
    """A parameter whose logarithm is normal.

    **Arguments:**

    - `median`: the median, above 0.
    - `spread`: the standard deviation of the natural logarithm; if small, about the relative
      standard deviation of the parameter.

    **Raises:** `ParameterError` if one of them is not above 0.
    """

    median: float
    spread: float

    tail = TAIL
    polynomials = "hermite"

    def __post_init__(self) -> None:
        _check_finite("LogNormal", median=self.median, spread=self.spread)
        _check_positive("LogNormal: median", self.median)
        _check_positive("LogNormal: spread", self.spread)

    def quantile(self, probability: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return self.median * np.exp(self.spread * ndtri(_open(probability)))

    def poincare_weight(self, values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        # This is the weight of the logarithm, which is normal.
        return self.spread * values

    def to_salib(self) -> SALibDistribution:
        return "lognorm", [math.log(self.median), self.spread]


def _open(probability: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Replaces the probabilities 0 and 1, whose quantiles are the ends of the distribution."""
    return np.clip(probability, MIN_PROBABILITY, 1 - 2.0**-53)


def _check_finite(where: str, **numbers: float) -> None:
    for name, value in numbers.items():
        finite_number(f"{where}: {name}", value, ParameterError)


def _check_positive(where: str, value: float) -> None:
    if not value > 0:
        raise ParameterError(f"{where}: expected a number above 0, got {value}")


@final
@dataclass(frozen=True, eq=False)
class Inputs:
    """The joint distribution of the drawn parameters: their marginal distributions and their
    correlation.

    Correlated parameters are a Gaussian copula: their normal scores, `ndtri` of their
    probabilities, are jointly normal.

    **Arguments:**

    - `marginals`: name -> distribution.
    - `correlation`: the correlation of the normal scores; None for independent parameters.
    - `relative_to`: the values around which parameters are drawn, name -> value. A twin with other
      values then gets draws at the same ratios to its own values. None if all twins get the same
      draws.
    """

    marginals: Mapping[str, AbstractMarginal]
    correlation: Float[np.ndarray, "parameters parameters"] | None = None
    relative_to: Mapping[str, float] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return tuple(self.marginals)

    def correlated(
        self, unit: Float[np.ndarray, "draws parameters"]
    ) -> Float[np.ndarray, "draws parameters"]:
        """Transforms independent probabilities to probabilities with the correlation of the
        parameters."""
        if self.correlation is None:
            return unit
        return ndtr(ndtri(np.clip(unit, MIN_PROBABILITY, 1 - 2.0**-53)) @ self.root.T)

    @cached_property
    def root(self) -> Float[np.ndarray, "parameters parameters"]:
        """A matrix whose product with its transpose is the correlation, which may be singular."""
        if self.correlation is None:
            return np.eye(len(self.names))
        squares, directions = np.linalg.eigh(self.correlation)
        return directions * np.sqrt(np.maximum(squares, 0.0))

    def values(
        self, unit: Float[np.ndarray, "draws parameters"]
    ) -> Float[np.ndarray, "draws parameters"]:
        """Transforms probabilities to values of the parameters, each by its quantile function."""
        pairs = zip(self.marginals.values(), unit.T, strict=True)
        return np.column_stack([marginal.quantile(column) for marginal, column in pairs])

    def check_independent(self, method: str) -> None:
        """Refuses correlated parameters.

        **Raises:** `ParameterError`.
        """
        if self.correlation is not None:
            raise ParameterError(
                f"sensitivity: inputs: expected independent parameters for {method}, whose indices "
                'have no meaning for others, got correlated ones; use method="shapley", or "src" '
                'or "prcc" for the effect of a parameter while the others are held'
            )

    def to_salib(self) -> dict[str, Any]:
        """Returns the problem in SALib's form, for its samplers and analysers.

        **Raises:** `ParameterError` for correlated parameters, which SALib's form cannot represent.
        """
        if self.correlation is not None:
            raise ParameterError(
                "to_salib: expected independent parameters, got correlated ones, for which SALib "
                "has no form"
            )
        written = [marginal.to_salib() for marginal in self.marginals.values()]
        return {
            "num_vars": len(written),
            "names": list(self.names),
            "bounds": [numbers for _, numbers in written],
            "dists": [kind for kind, _ in written],
        }
