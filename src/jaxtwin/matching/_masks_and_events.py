"""Masks of recordings, and given times of the camera's corrections, checked."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._errors import MatchError
from .._name_suggestions import did_you_mean
from ..io import Experiment

Span = tuple[float, float] | tuple[float, float, float]
"""Beginning and end of a span, s, and the weight in between, which is 0 if it is not given."""


def span_weights(
    recordings: Mapping[str, Experiment],
    spans: Mapping[str, Sequence[Span]] | None,
) -> list[Float[np.ndarray, "_times _channels"]]:
    """Weights of all samples, 0 to 1; missing samples have the weight 0.

    **Raises:** `MatchError` for unknown recordings, spans outside their recording, and weights that
    are not 0 to 1.
    """
    check_recording_names("masks", recordings, spans or {})
    weights = []
    for name, experiment in recordings.items():
        weight = experiment.sampled.astype(float)
        for span in (spans or {}).get(name, ()):
            if len(span) not in (2, 3):
                raise MatchError(
                    f"masks: {name}: expected (from, to) or (from, to, weight), got {span!r}"
                )
            start, end, value = (*span, 0.0)[:3]
            first, last = experiment.time[0], experiment.time[-1]
            if not (first <= start < end <= last and 0 <= value <= 1):
                raise MatchError(
                    f"masks: {name}: expected spans inside {first:g} to {last:g} s with a weight "
                    f"of 0 to 1, got {span!r}"
                )
            weight[(experiment.time >= start) & (experiment.time <= end)] *= value
        if not weight.any():
            raise MatchError(
                f"masks: {name}: expected at least one sample outside the masks, got none"
            )
        weights.append(weight)
    return weights


def given_events(
    recordings: Mapping[str, Experiment], events: Mapping[str, Sequence[float]]
) -> list[tuple[float, ...]]:
    """Times of the camera's corrections in each recording, s.

    **Raises:** `MatchError` for unknown recordings and times outside their recording.
    """
    check_recording_names("events", recordings, events)
    times = []
    for name, experiment in recordings.items():
        first, last = experiment.time[0], experiment.time[-1]
        for event in events.get(name, ()):
            if not first < event <= last:
                raise MatchError(
                    f"events: {name}: expected times inside the recording, {first:g} to {last:g} "
                    f"s, got {event:g} s"
                )
        times.append(tuple(sorted(float(event) for event in events.get(name, ()))))
    return times


def check_recording_names(
    what: str, recordings: Collection[str], given: Mapping[str, object]
) -> None:
    """Refuses names that are not those of recordings.

    **Raises:** a `MatchError` whose message starts with `what`.
    """
    unknown = [name for name in given if name not in recordings]
    if unknown:
        raise MatchError(
            f"{what}: expected some of the recordings {', '.join(recordings)}, got {unknown[0]!r}"
            f"{did_you_mean(unknown[:1], recordings)}"
        )
