"""The joint distribution of the parameters of a global analysis, the distributions of single ones,
and how the argument `inputs` stands for them.
"""

import abc
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, final, get_args

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .._arguments import finite_number, mapping_of, names_of
from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..matching import Fit, solution_of
from ..physics import Twin
from ..rig import Parameter
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


# Resolves the argument `inputs` of a global analysis to distributions of the parameters: around
# their values, between their bounds, by their priors, or by the posterior of a match.

InputKind: TypeAlias = Literal["normal", "lognormal", "bounds", "priors", "posterior"]

# A kind, or name -> distribution.
InputChoice: TypeAlias = InputKind | Mapping[str, AbstractMarginal]


def resolve_inputs(
    choice: InputChoice,
    origin: object,
    twin: Twin,
    names: Iterable[str] | None,
    spread: float,
) -> Inputs:
    """Returns the distributions of the drawn parameters.

    **Arguments:**

    - `choice`: a kind, or name -> distribution.
    - `origin`: the fit whose posterior is meant by "posterior"; any other object has none.
    - `twin`: the twin whose values are the centres.
    - `names`: names of the drawn parameters; None for all that are free, have a prior, or were
      matched.
    - `spread`: relative standard deviation of "normal" and "lognormal".

    **Raises:** `ParameterError` for parameters that have no such distribution.
    """
    if not isinstance(choice, str):
        return _given_marginals(
            mapping_of("sensitivity: inputs", choice, _EXPECTED, ParameterError), twin
        )
    if choice not in get_args(InputKind):
        raise ParameterError(
            f"sensitivity: inputs: expected {_EXPECTED}, got {choice!r}"
            f"{did_you_mean([choice], get_args(InputKind))}"
        )
    if choice == "posterior":
        return _posterior(origin, names)
    if choice == "bounds":
        rows = [twin.rig.parameters[name] for name in drawn_names(twin, names)]
        return Inputs({row.name: _in_bounds(twin, row) for row in rows})
    if choice == "priors":
        return _priors(twin, names)
    values = central_values(twin, names)
    if choice == "normal":
        marginals = {name: _around(value, spread) for name, value in values.items()}
        return Inputs(marginals, relative_to=values)
    for name, value in values.items():
        if value < 0:
            raise ParameterError(
                f"{twin.rig.name}: parameter {name}: expected a value above 0 for a log-normal "
                f"distribution, got {value:.10g}"
            )
    lognormal = {name: LogNormal(value, spread) for name, value in values.items()}
    return Inputs(lognormal, relative_to=values)


_EXPECTED = f"one of {', '.join(get_args(InputKind))}, or name -> distribution"


def _around(value: float, spread: float) -> Normal:
    """The normal distribution of the paper, truncated at 0 so that a resistance stays positive."""
    limits = {"low": 0.0} if value > 0 else {"high": 0.0}
    return Normal(value, spread * abs(value), **limits)


def _in_bounds(twin: Twin, row: Parameter) -> Uniform:
    if not (np.isfinite(row.lower) and np.isfinite(row.upper)):
        raise ParameterError(
            f"{twin.rig.name}: parameter {row.name}: expected two bounds, got {row.lower:.10g} to "
            f"{row.upper:g}; give them in the rig file, or leave it out with names=[...]"
        )
    return Uniform(row.lower, row.upper)


def _priors(twin: Twin, names: Iterable[str] | None) -> Inputs:
    rows = [twin.rig.parameters[name] for name in drawn_names(twin, names)]
    if names is None:
        rows = [row for row in rows if row.standard_deviation is not None]
    marginals: dict[str, AbstractMarginal] = {}
    for row in rows:
        if row.standard_deviation is None:
            raise ParameterError(
                f"{twin.rig.name}: parameter {row.name}: expected a prior, got none; give it one "
                "in the rig file, or leave it out with names=[...]"
            )
        centre = row.value if row.prior_value is None else row.prior_value
        if row.is_logarithmic:
            marginals[row.name] = LogNormal(centre, row.standard_deviation)
        else:
            marginals[row.name] = Normal(centre, row.standard_deviation, row.lower, row.upper)
    if not marginals:
        raise ParameterError(
            f'{twin.rig.name}: inputs "priors": expected priors in the rig file, got none; use '
            '"normal" or "bounds"'
        )
    return Inputs(marginals)


def _posterior(origin: object, names: Iterable[str] | None) -> Inputs:
    """The Gaussian approximation of a match, in the logarithms of positive parameters. Values that
    ended at a bound, or that the recordings do not determine, are held."""
    if not isinstance(origin, Fit):
        raise ParameterError(
            'sensitivity: inputs "posterior": expected a fit, got a twin; pass the fit itself'
        )
    rows = solution_of(origin).problem.unknowns.shared
    variances = np.diag(origin.uncertainty.vector_covariance)[: len(rows)]
    known = [row.name for row, square in zip(rows, variances, strict=True) if square > 0]
    where = f'{origin.twin.rig.name}: inputs "posterior"'
    if not known:
        raise ParameterError(
            f"{where}: expected a fit whose shared values have standard errors, got one in which "
            'all ended at bounds or are open; use "priors" or "bounds"'
        )
    wanted = known if names is None else drawn_names(origin.twin, names)
    missing = [name for name in wanted if name not in known]
    if missing:
        raise ParameterError(
            f"{where}: expected some of {', '.join(known)}, got {', '.join(missing)}"
            f"{did_you_mean(missing, known)}"
        )
    entries = [[row.name for row in rows].index(name) for name in wanted]
    covariance = origin.uncertainty.vector_covariance[np.ix_(entries, entries)]
    errors = np.sqrt(np.diag(covariance))
    marginals: dict[str, AbstractMarginal] = {}
    for entry, error in zip(entries, errors.tolist(), strict=True):
        row, value = rows[entry], float(origin.twin.values[rows[entry].name])
        marginals[row.name] = (
            LogNormal(value, error) if row.is_logarithmic else Normal(value, error)
        )
    return Inputs(marginals, covariance / np.outer(errors, errors))


def _given_marginals(marginals: Mapping[str, AbstractMarginal], twin: Twin) -> Inputs:
    names = drawn_names(twin, marginals)
    for name, marginal in marginals.items():
        if not isinstance(marginal, AbstractMarginal):
            raise ParameterError(
                f"sensitivity: inputs: {name}: expected Normal, Uniform or LogNormal of "
                f"jaxtwin.sensitivity_analysis, got {marginal!r}"
            )
    return Inputs({name: marginals[name] for name in names})


def central_values(twin: Twin, names: Iterable[str] | None) -> dict[str, float]:
    """Returns the values around which parameters are drawn: name -> value in the rig's unit.

    **Arguments:**

    - `names`: as in `drawn_names`.

    **Raises:** `ParameterError` for unknown names, none at all, or a value of 0.
    """
    values = {name: float(twin.values[name]) for name in drawn_names(twin, names)}
    for name, value in values.items():
        if value == 0:
            raise ParameterError(
                f"{twin.rig.name}: parameter {name}: expected a value other than 0, because draws "
                "have a standard deviation relative to it, got 0; leave it out with names=[...]"
            )
    return values


def drawn_names(twin: Twin, names: Iterable[str] | None) -> list[str]:
    """Returns the names of the parameters that are drawn.

    **Arguments:**

    - `names`: their names; None for the free parameters that recordings share, without the
      camera's registration.

    **Raises:** `ParameterError` for unknown names, or none at all.
    """
    table = twin.rig.parameters
    if names is None:
        # The registration is a length and an angle about 0, and not a property of the plant.
        zones = twin.wiring.zones
        registration = frozenset() if zones is None else zones.registration.names
        selected = [
            name
            for name, row in table.items()
            if row.free and row.scope != "recording" and name not in registration
        ]
    else:
        selected = list(names_of("names", names, ParameterError))
    unknown = [name for name in selected if name not in table]
    if unknown or not selected:
        raise ParameterError(
            f"{twin.rig.name}: names: expected some of {', '.join(table)}, got "
            f"{', '.join(unknown) or 'none'}{did_you_mean(unknown, table)}"
        )
    return selected


def rescaled_draws(
    twin: Twin, values: Mapping[str, float], samples: Mapping[str, Float[np.ndarray, " draws"]]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Moves draws from around `values` to around the values of a twin, at the same ratios.

    Twins of several recordings thus get the same draws relative to their values.
    """
    return {
        name: float(twin.values[name]) / values[name] * sample for name, sample in samples.items()
    }
