"""Estimates the values that belong to one recording and not to the rig from its first minute.

A fit determines the rig. It does not determine how a new recording begins: the temperatures of
room, plate and sinks, and the delay of the drive. These few values are matched to the first part of
the recording with everything else held; later samples are not used.

Room, plate and sinks are different states with different priors: see `_initial_condition_priors`.

While the drive is on, a minute contains little information on the room temperature: a model with an
error of a few per cent of the driven change cannot resolve a tenth of a kelvin. The weight of a
sample therefore decreases with its distance from the first reading. `InitialConditions.covariance`
says how uncertain the estimates are.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from ..errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..simulation import Initial, checked_initial
from ._descent import descend
from ._descent_result import DescentResult
from ._fit import Fit
from ._initial_condition_priors import (
    HiddenStarts,
    matched_starts,
    prior_of_differences,
    starting_shares,
    with_prior,
)
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._noise_model import Noise, initial_noise_model, update_noise_model
from ._objective import make_objective
from ._problem import LinearPrior, MatchProblem, ParameterChoice, choose_unknowns
from ._recordings import named_recordings
from ._start import (
    FirstSample,
    first_readings,
    first_sample,
    hidden_parameters,
    names_in,
    replaced_by_recorded_room,
    room_parameters,
    room_temperature,
    starts_without_effect,
)
from ._unknowns import Unknowns

WARM_UP = 60.0
"""Length of the part of a recording from which its own values are estimated, s."""

# The error of a good twin, as a part of the change of a reading since the first sample.
MODEL_ERROR = 0.2

# The autocorrelation time of a camera at 1 Hz, in samples.
MEMORY = 4.0

REWEIGHTINGS = 4
ITERATIONS = 50

# The steps of central differences, as a part of the distance that a value is expected to move: far
# above rounding, and so small that the derivatives are exact to six digits.
RELATIVE_STEP = 1e-4

# A value is reported as undetermined if its standard deviation is still this part of its prior's.
UNSEEN = 0.7


@final
@dataclass(frozen=True, eq=False)
class InitialConditions:
    """The estimated values of one recording.

    - `twin`: the given twin with these values.
    - `values`: name -> value, in the parameter's unit.
    - `covariance`: the covariance of the values in the order of `values`; of the logarithm for
      parameters that are matched by their logarithm.
    - `warnings`: the values that the first part of the recording does not determine, as text.
    - `initial`: the temperatures at the start if they were given, as `simulate` takes them.
    """

    twin: Twin
    values: Mapping[str, float]
    covariance: Float[np.ndarray, "values values"]
    warnings: tuple[str, ...]
    initial: Initial = None


def estimate_initial_conditions(
    twin: Twin | Fit,
    experiment: Experiment,
    warm_up: float | int = WARM_UP,
    names: Iterable[str] | None = None,
    *,
    group: str | None = None,
    initial: Initial = None,
) -> InitialConditions:
    """Estimates the values of one recording from its first part.

    **Arguments:**

    - `twin`: a fit, whose recordings give the priors of room and delay; or a twin, for which the
      rig file gives them.
    - `experiment`: a recording, of which the part before `warm_up` is used, but for its
      `glitches`.
    - `warm_up`: the end of that part, s from the first sample.
    - `names`: the parameters to estimate. By default those that have a value for each recording in
      the fit or in the rig's table, except a drift of the room, which a minute does not determine.
    - `group`: the group of the recording; by default the one that it names itself. Parameters that
      differ between groups have the values of this group if the fit knows it, and otherwise those
      expected of a new group.

    - `initial`: the temperatures at the start, as in `simulate`, if they are known. Those of plate
      and hidden states are then not estimated.

    **Returns:** the values, their covariance, and the twin with these values.

    **Raises:** `MatchError` if the recording has no temperatures, if the part has fewer times with
    a sample than values to estimate, if a value of the twin lies outside its bounds, or if the twin
    gives no finite temperatures; `ParameterError` for unknown names; `SimulationError` for a
    recording of another rig.
    """
    earlier = twin.recording_values if isinstance(twin, Fit) else {}
    group = experiment.group if group is None else group
    matched = matched_starts(twin) if isinstance(twin, Fit) else ()
    twin, names = _twin_and_names(twin, names, group)
    if experiment.ambient is not None:
        names = [name for name in names if name not in replaced_by_recorded_room(twin.rig)]
    given = starts_without_effect(twin, checked_initial(twin, initial))
    names = [name for name in names if name not in given]
    if not names:
        return InitialConditions(twin, {}, np.zeros((0, 0)), (), initial)
    (label,) = named_recordings(twin, [experiment])
    early = experiment.time < experiment.time[0] + warm_up
    count = int(np.count_nonzero(experiment.sampled[early].any(axis=1)))
    if count < max(2, len(names)):
        raise MatchError(
            f"{label}: warm_up = {warm_up:g} s: expected at least {max(2, len(names))} samples to "
            f"estimate {', '.join(names)}, got {count}; use a longer warm-up"
        )
    # The whole run follows from these few readings, of which a glitch is none.
    part = experiment.without_glitches().between(None, experiment.time[0] + warm_up)
    first = first_sample(part)
    unknowns = choose_unknowns(twin, (0,), ParameterChoice(names, per_recording=names))
    rows = tuple(
        with_prior(row, twin.rig, first.reading, earlier) for row in unknowns.per_recording
    )
    unknowns = replace(unknowns, per_recording=rows)
    hidden = [row.name for row in rows if row.name in hidden_parameters(twin.rig)]
    known = HiddenStarts(starting_shares(twin, hidden), matched)
    result = _descend(twin, part, unknowns, first, known, initial)
    if not np.isfinite(result.cost):
        raise MatchError(
            f"{label}: expected finite temperatures from the twin, got none; look for parameters "
            "far outside their bounds"
        )
    (values,) = unknowns.recording_values(result.vector)
    values = {name: float(value) for name, value in values.items()}
    covariance = _covariance(result)
    return InitialConditions(
        twin=twin.with_values(values),
        values=values,
        covariance=covariance,
        warnings=_warnings(unknowns, result, covariance, warm_up),
        initial=initial,
    )


def _twin_and_names(
    fitted: Twin | Fit, requested: Iterable[str] | None, group: str
) -> tuple[Twin, list[str]]:
    """Returns the twin with the mean of the recordings' own values and with the values of a group,
    and the names of the parameters to estimate: the requested ones, or the default."""
    if isinstance(fitted, Fit):
        twin = fitted.twin_of_group(group)
        names = [
            row.name for row in fitted.parameters.values() if row.free and row.scope == "recording"
        ]
    else:
        twin = fitted
        names = [name for name, row in twin.rig.parameters.items() if row.scope == "recording"]
    if requested is not None:
        return twin, list(requested)
    drifts = names_in(twin.rig.ambient_drift)
    if not isinstance(fitted, Fit):
        twin = twin.with_values({n: twin.rig.parameters[n].value for n in drifts & {*names}})
    return twin, [name for name in names if name not in drifts]


def _descend(
    twin: Twin,
    part: Experiment,
    unknowns: Unknowns,
    first: FirstSample,
    hidden: HiddenStarts,
    initial: Initial,
) -> DescentResult:
    """The values with the largest posterior density."""
    error = twin.rig.common_error
    sensor = Noise(twin.rig.noise, MEMORY)
    problem = MatchProblem(
        twin=twin,
        experiments=(part,),
        names=(part.name,),
        unknowns=unknowns,
        sample_weights=(_weights(part, sensor.effective),),
        events=None if error is not None and error.detect else ((),),
        common_error=error,
        loss=None,
        group_names=("",),
        prior_weights=unknowns.prior_weights(),
        linear_prior=LinearPrior.none(unknowns.size),
        initial=initial,
    )
    noise_model = replace(initial_noise_model(problem), channel=sensor, common_mode=sensor)
    solver = BoundedLevenbergMarquardt(rtol=1e-6)
    steps = RELATIVE_STEP * unknowns.scales()
    space = replace(unknowns.search_space(), difference_steps=steps)
    own_room = [row.name for row in unknowns.per_recording if row.name in room_parameters(twin.rig)]
    is_estimated = first.ambient is None and bool(own_room)
    # A rig whose room is not known begins at rest until the first round has found a room.
    room = first.reading
    if not is_estimated:
        room = room_temperature(twin.rig, twin.numbers_si, first.ambient)
    results: list[DescentResult] = []
    for _ in range(REWEIGHTINGS):
        prior = prior_of_differences(
            twin.rig, unknowns, first.reading, room, hidden, is_estimated=is_estimated
        )
        problem = replace(problem, linear_prior=prior)
        results = descend(
            [problem],
            [make_objective(problem, noise_model)],
            solver,
            results or [unknowns.start()],
            space,
            ITERATIONS,
        )
        (result,) = results
        if not np.isfinite(result.cost):
            break
        # Corrections of the camera are detected, because they would otherwise look like a plate
        # that cools. A minute is too short to estimate the noise as well.
        events = update_noise_model(problem, noise_model, result.recording_errors()).events
        (simulated,) = result.temperatures()
        weights = _weights(part, sensor.effective, simulated)
        noise_model = replace(noise_model, events=events, channel_weights=(weights,))
        (values,) = unknowns.recording_values(result.vector)
        if is_estimated:
            room = float(values[own_room[0]])
    return results[0]


def _weights(
    part: Experiment, noise: float, simulated: Float[np.ndarray, "times channels"] | None = None
) -> Float[np.ndarray, "times channels"]:
    """The weight of each sample, 0 to 1: the noise variance divided by the sum of noise variance
    and the variance of the model's error; 0 for a missing sample.

    The model's error keeps its sign during the whole part, so that all samples together carry as
    much information on it as a single sample. It grows with the change since the first sample,
    recorded or simulated: if the drive begins late, only one of the two has changed.
    """
    moved = np.abs(part.temperatures - first_readings(part))
    if simulated is not None:
        first = simulated[part.sampled.argmax(axis=0), np.arange(simulated.shape[1])]
        moved = np.maximum(moved, np.abs(simulated - first))
    moved = np.where(part.sampled, moved, np.inf)
    return 1 / (1 + (MODEL_ERROR * moved * math.sqrt(len(moved)) / noise) ** 2)


def _covariance(result: DescentResult) -> Float[np.ndarray, "values values"]:
    """The inverse of the normal matrix, which contains the priors and the prior of differences."""
    jacobian = result.jacobian()
    return np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)


def _warnings(
    unknowns: Unknowns,
    result: DescentResult,
    covariance: Float[np.ndarray, "values values"],
    warm_up: float | int,
) -> tuple[str, ...]:
    errors = np.sqrt(np.diag(covariance))
    objective = result.objective
    differences = np.asarray(objective.linear_prior.matrix)
    prior = np.diag(np.square(objective.prior_weights)) + differences.T @ differences
    before = np.sqrt(np.diag(np.linalg.pinv(prior, hermitian=True)))
    warnings = []
    (values,) = unknowns.recording_values(result.vector)
    for row, error, expected in zip(unknowns.per_recording, errors, before, strict=True):
        value = float(values[row.name])
        if row.prior_spread is not None and error > UNSEEN * expected:
            warnings.append(
                f"{row.name}: the first {warm_up:g} s hardly show it, {value:.4g} +- {error:.2g} "
                "is mostly what was expected beforehand"
            )
    correlation = covariance / np.outer(errors, errors)
    names = [row.name for row in unknowns.per_recording]
    for a, b in zip(*np.nonzero(np.triu(np.abs(correlation) > 0.95, 1)), strict=True):
        warnings.append(
            f"{names[a]} and {names[b]} cannot be distinguished in the first {warm_up:g} s"
        )
    return tuple(warnings)
