"""The table of fitted parameters, with the warnings that belong to each."""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from .._name_suggestions import unknown_name
from .._statistics import QUANTILE_975
from ..errors import ParameterError
from ..rig import Parameter, Scope
from ._group_values import new_group_values
from ._problem import MatchProblem
from ._start import replaced_by_recorded_room
from ._uncertainty import Uncertainty
from ._unknowns import Unknowns

# A value counts as near a bound if its distance is at most this part of the range between the
# bounds (of their logarithms).
NEAR_BOUND_FRACTION = 0.01

# A warning is given from this many standard deviations from the prior.
FAR_FROM_PRIOR_SIGMAS = 2.0


@final
@dataclass(frozen=True)
class FittedParameter:
    r"""A matched or held parameter: a row of Table 4 of the paper.

    **Arguments:**

    - `name`, `unit`, `description`, `free`, `scope`: as in the rig's parameter table.
    - `initial`, `value`: the value before and after the match, in `unit`. For a parameter with a
      value for each recording, the mean; for one with a value for each of several groups, the
      expected value of another group.
    - `published`: the value in the rig's parameter set `published`, None if it has none.
    - `lower`, `upper`: the bounds of the match.
    - `is_logarithmic`: whether the parameter was matched by its logarithm. `prior_spread` is then
      relative.
    - `at_bound`: whether the value ended at a bound, so that the optimum without bounds lies
      outside.
    - `standard_error`: in `unit`, including the effect of autocorrelated residuals; infinite if the
      parameter is undetermined, NaN if it was held or ended at a bound.
    - `prior_value`, `prior_spread`: centre and standard deviation of the prior, None without a
      prior.
    - `prior_distance`: the distance of the value from the prior's centre in standard deviations;
      the largest of all recordings.
    - `prior_to_data_ratio`: the prior's standard deviation divided by the one that the recordings
      alone would give if all other parameters were known.
    - `warnings`: the reasons to be careful with the value.
    - `relative_standard_error`: the standard error of the natural logarithm, for a parameter that
      was matched by its logarithm; otherwise NaN.
    - `interval`: the two ends of the 95 % interval, in `unit`: $v e^{\pm 1.96 s}$ for a parameter
      that was matched by its logarithm, otherwise $v \pm 1.96 s$; bounds do not cut it. It is
      unbounded for an undetermined parameter and NaN where `standard_error` is NaN. For a parameter
      with a value for each recording it has the largest error.
    - `group_spread`: the prior standard deviation between groups, in the measure of `prior_spread`,
      or None.
    """

    name: str
    unit: str
    description: str
    free: bool
    scope: Scope
    initial: float
    value: float
    published: float | None
    lower: float
    upper: float
    is_logarithmic: bool
    at_bound: bool
    standard_error: float
    prior_value: float | None = None
    prior_spread: float | None = None
    prior_distance: float | None = None
    prior_to_data_ratio: float = math.nan
    warnings: tuple[str, ...] = ()
    relative_standard_error: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)
    group_spread: float | None = None


@final
class FittedParameters(dict[str, FittedParameter]):
    """A mapping name -> parameter, in the order of the rig's table. An unknown name raises a
    `ParameterError` that suggests the nearest name."""

    def __missing__(self, name: object) -> FittedParameter:
        raise ParameterError(f"fit: {unknown_name('parameter', str(name), self)}")


def matched_parameter(row: FittedParameter, parameter: Parameter) -> Parameter:
    """A parameter of the rig with the value, the bounds and the scope of its match. If it was free,
    also with the prior of the match: that of a refit is not the rig's."""
    names = ["value", "lower", "upper", "free", "scope"]
    if row.free:
        names += ["prior_value", "prior_spread", "group_spread"]
    return replace(parameter, **{name: getattr(row, name) for name in names})


def fitted_parameters(
    problem: MatchProblem, vector: Float[np.ndarray, " unknowns"], uncertainty: Uncertainty
) -> FittedParameters:
    """Makes a row for every parameter of the rig, in the order of its table.

    **Arguments:**

    - `vector`: the optimiser's vector at the end of the match.
    """
    twin, unknowns = problem.twin, problem.unknowns
    errors = np.sqrt(np.diag(uncertainty.covariance))
    # An undetermined value has a finite entry in the vector's covariance.
    finite_errors = np.sqrt(np.diag(uncertainty.vector_covariance))
    vector_errors = np.where(np.isinf(errors), np.inf, finite_errors)
    lower, upper = unknowns.lower(), unknowns.upper()
    with np.errstate(invalid="ignore"):
        touching = (vector <= lower + 1e-9) | (vector >= upper - 1e-9)
    prior_distances = (vector - unknowns.prior_means()) * unknowns.prior_weights()
    published = twin.rig.parameter_sets.get("published", {})
    entries_of: dict[str, list[int]] = {}
    for number, row in enumerate(unknowns.entry_parameters):
        entries_of.setdefault(row.name, []).append(number)
    values = unknowns.to_values(vector)
    expected = _expected_of_groups(unknowns, vector, uncertainty)
    table = FittedParameters()
    recorded = replaced_by_recorded_room(twin.rig)
    for name, row in twin.rig.parameters.items():
        entries = entries_of.get(name, [])
        matched = unknowns.entry_parameters[entries[0]] if entries else row
        initial = float(twin.values[name])
        value = float(np.mean(values[entries])) if entries else initial
        error = float(np.max(vector_errors[entries])) if entries else math.nan
        standard_error = float(np.max(errors[entries])) if entries else math.nan
        if name in expected:
            value, error = expected[name]
            standard_error = error * value if matched.is_logarithmic else error
        ratios = uncertainty.prior_to_data_ratio[entries]
        logarithmic = matched.is_logarithmic
        has_prior = bool(entries) and matched.prior_spread is not None
        fitted = FittedParameter(
            name=name,
            unit=row.unit,
            description=row.description,
            free=bool(entries),
            scope=matched.scope,
            initial=initial,
            value=value,
            published=published.get(name),
            lower=matched.lower,
            upper=matched.upper,
            is_logarithmic=logarithmic,
            at_bound=bool(np.any(touching[entries])),
            standard_error=standard_error,
            prior_value=matched.prior_value if has_prior else None,
            prior_spread=matched.prior_spread if has_prior else None,
            prior_distance=max(prior_distances[entries].tolist(), key=abs) if has_prior else None,
            prior_to_data_ratio=float(np.min(ratios)) if entries else math.nan,
            relative_standard_error=error if logarithmic else math.nan,
            interval=interval_95(value, error, is_logarithmic=logarithmic),
            group_spread=matched.group_spread if has_prior else None,
        )
        warnings = parameter_warnings(fitted, uncertainty, is_recorded=name in recorded)
        table[name] = replace(fitted, warnings=warnings)
    return table


def _expected_of_groups(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], uncertainty: Uncertainty
) -> dict[str, tuple[float, float]]:
    """Name -> expected value of all groups and its standard error (of the logarithm for a parameter
    matched by it), for parameters with a value for each of several groups."""
    if not unknowns.per_group:
        return {}
    result = new_group_values(unknowns, vector)
    covariance = np.nan_to_num(uncertainty.vector_covariance)
    variances = np.diag(result.lift @ covariance @ result.lift.T)
    errors = np.sqrt(variances + result.shared_variance)
    pairs = zip(result.values.items(), errors.tolist(), strict=True)
    return {name: (value, error) for (name, value), error in pairs}


def parameter_warnings(
    row: FittedParameter, uncertainty: Uncertainty, *, is_recorded: bool
) -> tuple[str, ...]:
    """Short warnings on one parameter; empty if there are none. `is_recorded`: whether a recorded
    ambient temperature replaces it."""
    if not row.free:
        return ()
    labels = [
        label
        for label in uncertainty.labels
        if label == row.name or label.startswith(f"{row.name}[")
    ]
    warnings = []
    if row.at_bound:
        warnings.append("at bound")
    elif near_bound(row):
        warnings.append("near bound")
    if row.prior_distance is not None and abs(row.prior_distance) > FAR_FROM_PRIOR_SIGMAS:
        warnings.append(f"{row.prior_distance:+.1f} sd from prior")
    if any(label in uncertainty.insensitive for label in labels):
        warnings.append("replaced by the recording" if is_recorded else "no effect")
    elif row.prior_to_data_ratio < 1:
        warnings.append("not determined" if row.prior_spread is None else "prior only")
    elif math.isinf(row.standard_error):
        warnings.append("not determined")
    if any(label in pair[:2] for pair in uncertainty.collinear for label in labels):
        warnings.append("correlated")
    return tuple(warnings)


def near_bound(row: FittedParameter) -> bool:
    """Whether a value lies within 1 % of the range from a bound, on the scale of the match."""
    lower, value, upper = row.lower, row.value, row.upper
    if row.is_logarithmic:
        lower, value, upper = math.log(lower), math.log(value), math.log(upper)
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return False
    return min(value - lower, upper - value) < NEAR_BOUND_FRACTION * (upper - lower)


def interval_95(value: float, error: float, *, is_logarithmic: bool) -> tuple[float, float]:
    r"""Computes the 95 % interval of a value, in its own unit.

    A positive parameter is matched by its logarithm, in which the likelihood is nearly normal. Its
    interval is $v e^{\pm 1.96 s}$, which is positive for any error. The interval of any other
    parameter is $v \pm 1.96 s$. Bounds do not cut the interval.

    **Arguments:**

    - `value`: the matched value.
    - `error`: its standard error, of the logarithm if it was matched by it; infinite for an
      undetermined value, NaN if there is none.

    **Returns:** lower and upper end, both NaN if there is no error.
    """
    if math.isnan(error):
        return math.nan, math.nan
    reach = QUANTILE_975 * error
    if not is_logarithmic:
        return value - reach, value + reach
    try:
        return value * math.exp(-reach), value * math.exp(reach)
    except OverflowError:
        return 0.0, math.inf
