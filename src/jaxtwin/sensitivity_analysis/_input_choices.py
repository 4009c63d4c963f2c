"""Resolves the argument `inputs` of a global analysis to distributions of the parameters: around
their values, between their bounds, by their priors, or by the posterior of a match.
"""

from collections.abc import Iterable, Mapping
from typing import Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from .._arguments import mapping_of, names_of
from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..matching import Fit, solution_of
from ..physics import Twin
from ..rig import Parameter
from ._inputs import AbstractMarginal, Inputs, LogNormal, Normal, Uniform

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
