"""Predictions of data that a match has not seen: another recording, the rest of a recording (also
as an observer expects it), or each recording or group of recordings in turn."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from .._arguments import check_callable, finite_number, names_of, of_kind
from .._progress import announced
from ..errors import MatchError
from ..io import Experiment, Recordings, as_experiments
from ..matching import (
    WARM_UP,
    Band,
    Fit,
    Iteration,
    estimate_initial_conditions,
    match,
    named_recordings,
)
from ..matching._band import LEVEL, UncertainValues, band_about, values_of_matched, values_of_unseen
from ..matching._match_group import NEW_GROUP, check_given, match_first_part, match_group
from ..matching._nominal_twin import nominal_twin
from ..matching._recordings import divided, named_groups
from ..observers import ProcessNoise
from ..physics import Twin
from ..simulation import Initial, Run, prepare_simulation, simulate
from ._validation import Prediction, Validation

# The rest of a recording, as an observer that has followed its first part expects it.


def forecast_rest(
    name: str, fit: Fit, recording: Experiment, start: float, noise: ProcessNoise
) -> Prediction:
    """Predicts a recording from a time on.

    The observer follows a recording whose readings from this time on are missing, so that all that
    it expects of them is a forecast. Its band contains the error of the twin itself beside that of
    its values.

    **Arguments:**

    - `name`: the name of the recording.
    - `recording`: the whole recording, with the name of its group.
    - `start`: the time, s.
    - `noise`: the noise of rig and readings.
    """
    # A validation without an observer does not wait for its import.
    from ..observers import observe

    assert recording.temperatures is not None
    is_given = recording.time < start
    readings = np.where(is_given[:, None], recording.temperatures, np.nan)
    observed = observe(fit, replace(recording, temperatures=readings), noise)
    twin, expected, estimates = observed.observer.model.twin, observed.expected, observed.estimates
    run = Run(
        experiment=recording,
        channels=observed.channels,
        temperatures=expected.mean,
        nodes=estimates.nodes,
        states=np.asarray(estimates.moments.nodes.mean),
        rig=twin.rig.name,
        elements=len(twin.rig.plate.element_names),
    )
    band = Band(run, expected.lower, expected.upper, LEVEL).between(start)
    last = np.flatnonzero(is_given)[-1]
    table = twin.rig.parameters
    values = {
        name: float(parameter.mean[last])
        for name, parameter in estimates.parameters.items()
        if table[name].scope != "shared"
    }
    is_matched = recording.fingerprint in fit.fingerprints
    return Prediction(
        name, band.run, twin, values, (), None, is_matched, make_band=lambda: band
    )  # fmt: skip


# The smallest number of samples of each channel in a predicted part.
MIN_SAMPLES = 30

# A prediction has a warning if it leaves the range of the given readings by more than this part of
# the range.
EXTRAPOLATION_FRACTION = 0.2


ONE_RECORDING = (
    "a match to one recording does not know how much the rig differs between recordings, so that "
    "its bands are wide; a match to more recordings makes them narrower"
)


@announced("validation")
def validate(
    twin: Twin | Fit | str | os.PathLike[str],
    experiments: Recordings,
    *,
    warm_up: float | int = WARM_UP,
    names: Iterable[str] | None = None,
    group: str | None = None,
    given: Experiment | Sequence[Experiment] | float | int | None = None,
    initial: Initial = None,
    noise: ProcessNoise | None = None,
    on_progress: Callable[[Prediction], None] | None = None,
) -> Validation:
    """Predicts recordings that the match has not seen.

    The values that belong to a recording and not to the rig (room temperature, temperature of the
    rig at the start, delay of the drive) are estimated from its first `warm_up` seconds, see
    `jaxtwin.matching.estimate_initial_conditions`. The rest of the recording is predicted, except
    corrections of the camera, which cannot be known beforehand.

    Parameters that differ between groups of recordings, such as days, have the values of the
    recording's group if the fit knows it, and otherwise those expected of a new group. Either way
    recordings that are `given` correct them.

    **Arguments:**

    - `twin`: a fit, the path of a saved fit, or a twin.
    - `experiments`: one or several recordings of the same rig, or their files.
    - `warm_up`: the length of the part from which own values are estimated, s.
    - `names`: the parameters that are estimated from a recording; by default those with a value for
      each recording in the fit or in the rig's table.
    - `group`: the group of the recordings; by default the one that each names itself, and beside
      `given` a new group for a recording without a name of its group.
    - `given`: further data of the group, of which its values are estimated with what the fit knows
      as the prior: the length of the first part of each recording, s, which replaces `warm_up`; or
      other recordings of the group.
    - `initial`: the temperatures at the start of each recording, as in `simulate`, if they are
      known; not beside a length that is `given`. By default they are estimated.
    - `noise`: the noise of rig and readings, as `estimate_noise` finds it. An observer then follows
      the first part and forecasts the rest, instead of a simulation with the values estimated from
      it: the prediction starts from the state that the readings show, and its band contains the
      error of the twin itself. Not beside `names` or `initial`.
    - `on_progress`: called with each `Prediction`.

    **Raises:** `MatchError` if a recording is too short or has no temperatures, or if something is
    given beside recordings that the fit has seen, or beside a twin that is not a fit;
    `SimulationError` for recordings of another rig; `ParameterError` if a saved fit cannot be read.
    """
    fitted = Fit.load(twin) if isinstance(twin, str | os.PathLike) else twin
    twin = fitted.twin if isinstance(fitted, Fit) else fitted
    names = None if names is None else names_of("validate: names", names, MatchError)
    warm_up = finite_number("validate: warm_up", warm_up, MatchError)
    if noise is not None:
        of_kind("validate: noise", noise, ProcessNoise, "a ProcessNoise", MatchError)
        of_kind("validate: noise: beside it", fitted, Fit, "a Fit", MatchError)
        if names is not None or initial is not None:
            raise MatchError(
                "validate: noise: expected no names and initial beside it, since an observer "
                "estimates both"
            )
    rig = twin.rig if isinstance(twin, Twin) else None
    several, _ = divided(as_experiments("validate: experiments", experiments, MatchError, rig))
    labels = named_recordings(twin, several)
    check_callable("validate: on_progress", on_progress, MatchError)
    if group is not None:
        of_kind("validate: group", group, str, "text", MatchError)
    groups = [experiment.group if group is None else group for experiment in several]
    kind = f"{'predicted' if noise is None else 'forecast'} after the first {warm_up:g} s"
    span = None
    if given is not None:
        groups = [name or NEW_GROUP for name in groups]
        known = check_given(fitted, groups[:1], several)
        if isinstance(given, float | int):
            span = finite_number("validate: given", given, MatchError)
            if initial is not None:
                raise MatchError(
                    "validate: initial: expected None beside given as a length, got "
                    f"{initial!r}; give other recordings of the group, or leave one of them out"
                )
            kind = (
                f"{'predicted' if noise is None else 'forecast'} after the first {span:g} s, from "
                "which its group follows"
            )
        else:
            recordings = as_experiments("validate: given", given, MatchError, rig)
            fitted = match_group(check_given(known, groups, recordings), recordings, groups[0])
            kind += f", given {', '.join(fitted.recordings)}"
    predictions = []
    for name, experiment, of in zip(labels, several, groups, strict=True):
        if span is not None:
            assert isinstance(fitted, Fit)
            predictions.append(_predict_rest(name, fitted, experiment, span, of, noise))
        elif noise is not None:
            assert isinstance(fitted, Fit)
            start = _start_of_rest(name, experiment, "warm_up", warm_up)
            own = replace(experiment, group=of)
            predictions.append(forecast_rest(name, fitted, own, start, noise))
        else:
            predictions.append(
                _predict(name, fitted, experiment, warm_up, names=names, group=of, initial=initial)
            )
        _report_progress(on_progress, predictions[-1])
    if all(prediction.is_matched for prediction in predictions):
        kind = "matched, not a prediction"
    return Validation(twin.rig.name, kind, tuple(predictions))


@announced("validation of the second part")
def validate_split(
    twin: Twin | Fit,
    experiments: Experiment | Sequence[Experiment],
    at: float | int,
    *,
    on_progress: Callable[[Iteration | Prediction], None] | None = None,
    **options: Any,
) -> Validation:
    """Matches the first part of recordings and predicts the rest.

    **Arguments:**

    - `twin`: the start of the match, as in `match`.
    - `experiments`: one or several recordings.
    - `at`: the match uses the samples before this time, s.
    - `on_progress`: called with each `Iteration` of the match and each `Prediction`.
    - `options`: the other arguments of `match`. Events and masks at or after the split are left
      out.

    **Raises:** `MatchError` if the split leaves too few samples on either side; the errors of
    `match`.
    """
    twin = nominal_twin("twin", twin, MatchError)
    at = finite_number("validate_split: at", at, MatchError)
    several, _ = divided(
        as_experiments("validate_split: experiments", experiments, MatchError, twin.rig)
    )
    names = named_recordings(twin, several)
    check_callable("validate_split: on_progress", on_progress, MatchError)
    for name, recording in zip(names, several, strict=True):
        before, after = (
            _samples(recording, part) for part in (recording.time < at, recording.time >= at)
        )
        if min(before, after) < MIN_SAMPLES:
            raise MatchError(
                f"{name}: split at {at:g} s: expected at least {MIN_SAMPLES} samples in every "
                "channel "
                f"before and after it, got {before} and {after}; the recording goes from "
                f"{recording.time[0]:g} to {recording.time[-1]:g} s"
            )
    fit = match(
        twin,
        [recording.between(None, at) for recording in several],
        on_progress=on_progress,
        **_before(at, several, options),
    )
    predictions = []
    for name, recording in zip(names, several, strict=True):
        run = simulate(fit.twins[name], recording, initial=options.get("initial")).between(at)
        band = partial(_band, fit, recording, values_of_matched(fit, name), at)
        own = fit.recording_values[name]
        predictions.append(Prediction(name, run, fit.twins[name], own, (), fit, make_band=band))
        _report_progress(on_progress, predictions[-1])
    kind = f"matched before {at:g} s, predicted from there"
    return Validation(twin.rig.name, kind, tuple(predictions))


@announced("leave-one-out validation")
def leave_one_out(
    twin: Twin | Fit,
    experiments: Sequence[Experiment],
    *,
    by: Literal["recording", "group"] = "recording",
    warm_up: float | int = WARM_UP,
    on_progress: Callable[[Iteration | Prediction], None] | None = None,
    **options: Any,
) -> Validation:
    """Predicts each recording with a twin that is matched to the others.

    **Arguments:**

    - `twin`: the start of every match, as in `match`.
    - `experiments`: two or more recordings.
    - `by`: which recordings are left out of a match: a single recording, or all recordings of its
      group, such as its day. Parameters that differ between groups then have the values expected of
      a new group.
    - `warm_up`: as in `validate`.
    - `on_progress`: called with each `Iteration` of each match and each `Prediction`.
    - `options`: the other arguments of `match`.

    **Raises:** `MatchError` for fewer than two recordings, or fewer than two groups if groups are
    left out; the errors of `match` and `validate`.
    """
    twin = nominal_twin("twin", twin, MatchError)
    several, of_each = divided(
        as_experiments("leave_one_out: experiments", experiments, MatchError, twin.rig),
        options.pop("groups", None),
    )
    warm_up = finite_number("leave_one_out: warm_up", warm_up, MatchError)
    check_callable("leave_one_out: on_progress", on_progress, MatchError)
    recordings = named_recordings(twin, several)
    names = list(recordings)
    if len(several) < 2:
        raise MatchError(f"leave_one_out: expected two recordings or more, got {len(several)}")
    if by not in ("recording", "group"):
        raise MatchError(f'leave_one_out: by: expected "recording" or "group", got {by!r}')
    groups, numbers = named_groups(recordings, of_each)
    if by == "group" and len(set(numbers)) < 2:
        raise MatchError(
            "leave_one_out: by: expected recordings of two groups or more, got one group "
            f"{groups[0]!r}; give groups=[...], or leave out one recording at a time"
        )
    parts = numbers if by == "group" else range(len(several))
    predictions: list[Prediction] = []
    for part in dict.fromkeys(parts):
        out = [number for number, other in enumerate(parts) if other == part]
        others = [number for number in range(len(several)) if number not in out]
        fit = match(
            twin,
            [several[number] for number in others],
            groups=[groups[numbers[number]] for number in others] if any(groups) else None,
            on_progress=on_progress,
            **_without({names[number] for number in out}, options),
        )
        for number in out:
            group = groups[numbers[number]] or None
            predictions.append(
                _predict(names[number], fit, several[number], warm_up, fit=fit, group=group)
            )
            _report_progress(on_progress, predictions[-1])
    others_are = "the others" if by == "recording" else "the other groups"
    kind = f"each predicted by a match to {others_are}"
    return Validation(twin.rig.name, kind, tuple(predictions))


def _predict(
    name: str,
    fitted: Twin | Fit,
    recording: Experiment,
    warm_up: float,
    *,
    names: Iterable[str] | None = None,
    fit: Fit | None = None,
    group: str | None = None,
    initial: Initial = None,
) -> Prediction:
    start = _start_of_rest(name, recording, "warm_up", warm_up)
    twin = nominal_twin("twin", fitted, MatchError)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(prepare_simulation, twin, recording)
        result = estimate_initial_conditions(
            fitted, recording, warm_up, names, group=group, initial=initial
        )
    run = simulate(result.twin, recording, initial=initial).between(start)
    band, is_matched, warnings = None, False, result.warnings
    if isinstance(fitted, Fit):
        uncertain = values_of_unseen(fitted, recording.group if group is None else group, result)
        band = partial(_band, fitted, recording, uncertain, start)
        is_matched = recording.fingerprint in fitted.fingerprints
        if len(fitted.recordings) == 1 and not is_matched:
            warnings = (*warnings, ONE_RECORDING)
    return Prediction(
        name, run, result.twin, result.values, warnings, fit, is_matched, make_band=band
    )


def _predict_rest(
    name: str,
    fit: Fit,
    recording: Experiment,
    given: float,
    group: str,
    noise: ProcessNoise | None,
) -> Prediction:
    """Predicts the rest of a recording from its first part, which its group's values follow
    from."""
    start = _start_of_rest(name, recording, "given", given)
    first = match_first_part(fit, recording, given, group)
    if noise is not None:
        return forecast_rest(name, first, replace(recording, group=group), start, noise)
    whole = simulate(first.twin, recording)
    run = whole.between(start)
    (recording_values,) = first.recording_values.values()
    estimated = {**recording_values, **first.group_values[group]}
    warnings = _beyond_given(whole.temperatures, recording.time < start, given)
    uncertain = values_of_matched(first, first.recordings[0])
    band = partial(_band, first, recording, uncertain, start)
    return Prediction(name, run, first.twin, estimated, warnings, first, make_band=band)


def _band(fit: Fit, recording: Experiment, values: UncertainValues, start: float) -> Band:
    """The band of the predicted part of a recording."""
    return band_about(fit, recording, values, start).between(start)


def _beyond_given(
    predicted: Float[np.ndarray, "times channels"],
    is_given: Bool[np.ndarray, " times"],
    given: float,
) -> tuple[str, ...]:
    """A warning if the predicted temperatures lie far outside those in the given part."""
    low, high = predicted[is_given].min(axis=0), predicted[is_given].max(axis=0)
    later = predicted[~is_given]
    outside = np.maximum(later.max(axis=0) - high, low - later.min(axis=0))
    farthest = int(np.argmax(outside))
    span = float(high[farthest] - low[farthest])
    if outside[farthest] <= EXTRAPOLATION_FRACTION * span:
        return ()
    warning = (
        f"readings are predicted up to {outside[farthest]:.1f} K outside of the first {given:g} s, "
        f"whose range is {span:.1f} K: there the prediction and its band rest on how the earlier "
        "match expects groups to differ; give a longer part"
    )
    return (warning,)


def _start_of_rest(name: str, recording: Experiment, what: str, span: float) -> float:
    start = recording.time[0] + span
    left = _samples(recording, recording.time >= start)
    if left < MIN_SAMPLES:
        raise MatchError(
            f"{name}: {what} = {span:g} s: expected at least {MIN_SAMPLES} samples after it in "
            f"every channel, got {left}; give less"
        )
    return float(start)


def _samples(recording: Experiment, part: Bool[np.ndarray, " times"]) -> int:
    """The number of samples of the channel with the fewest samples in a part."""
    return int(recording.sampled[part].sum(axis=0).min(initial=len(recording.time)))


def _report_progress(
    on_progress: Callable[[Prediction], None] | None, prediction: Prediction
) -> None:
    if on_progress is not None:
        on_progress(prediction)


def _before(at: float, recordings: Sequence[Experiment], options: dict[str, Any]) -> dict[str, Any]:
    """The options of a match that uses recordings up to a time."""
    last = max(float(recording.time[recording.time < at][-1]) for recording in recordings)
    kept = dict(options)
    if isinstance(events := options.get("events"), Mapping):
        kept["events"] = {n: [e for e in times if e <= last] for n, times in events.items()}
    if isinstance(masks := options.get("masks"), Mapping):
        kept["masks"] = {
            n: [(s[0], min(s[1], last), *s[2:]) for s in spans if s[0] < last]
            for n, spans in masks.items()
        }
    return kept


def _without(left_out: set[str], options: dict[str, Any]) -> dict[str, Any]:
    """The options of a match that does not use some of the recordings."""
    kept = dict(options)
    for key in ("events", "masks"):
        if isinstance(given := options.get(key), Mapping):
            kept[key] = {name: value for name, value in given.items() if name not in left_out}
    return kept
