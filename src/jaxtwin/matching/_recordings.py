"""The recordings of a match, checked: names, groups, masks, times of corrections, units."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from itertools import count as count_from

import numpy as np
from jaxtyping import Float

from .._arguments import is_ordered, of_kind
from .._celsius import ZERO_CELSIUS, is_probably_kelvin
from .._name_suggestions import did_you_mean
from ..errors import MatchError
from ..io import Experiment, Gaps, parts_between_gaps, separate_recordings
from ..physics import Twin, check_twin
from ..rig import Parameter, Rig, Value
from ..simulation import checked_channels
from ._start import first_readings, first_sample, room_temperature

# Whether two recordings hold the same samples: one of them is a part of the other, under
# another name, beginning at 0 s, with fewer channels or samples, or the two overlap.


# Times of a sample in two recordings differ by less, s: those of a part may be shifted.
SAME_TIME = 1e-6

# As many samples of different readings, or more, are no coincidence.
MIN_SHARED_SAMPLES = 3


def shared_samples(a: Experiment, b: Experiment) -> int:
    """The number of samples that two recordings share; 0 if they only look alike for a while, as
    two runs from the same start do without noise."""
    names = [name for name in a.channels if name in b.channels]
    if not names or a.n_cells != b.n_cells:
        return 0
    a, b = a.select(names), b.select(names)
    shorter, longer = sorted((_Samples(a), _Samples(b)), key=lambda samples: len(samples.time))
    if not len(shorter.time) or len(np.unique(shorter.rows, axis=0)) < MIN_SHARED_SAMPLES:
        return 0
    # A part is wherever its first sample is: at its own time, if it kept that.
    alike = np.all(longer.rows == shorter.rows[0], axis=1)
    for shift in longer.time[alike] - shorter.time[0]:
        if len(shorter.time) == _same(shorter, longer, shift):
            return len(shorter.time)
    first, last = (max(a.time[0], b.time[0]), min(a.time[-1], b.time[-1]))
    if a.time[0] == b.time[0]:
        return 0  # neither is the beginning of the other
    early, late = (samples.between(first, last) for samples in (shorter, longer))
    if len(early.time) != len(late.time) or len(np.unique(early.rows, axis=0)) < MIN_SHARED_SAMPLES:
        return 0
    return len(early.time) if _same(early, late, 0.0) == len(early.time) else 0


class _Samples:
    """The samples with a reading: their times, and readings and duty as rows; -inf for a missing
    reading, which no reading is."""

    def __init__(self, experiment: Experiment):
        assert experiment.temperatures is not None, "named_recordings has checked it"
        there = experiment.sampled.any(axis=1)
        self.time: Float[np.ndarray, " samples"] = experiment.time[there]
        readings = np.nan_to_num(experiment.temperatures[there], nan=-np.inf)
        self.rows: Float[np.ndarray, "samples values"] = np.hstack(
            [readings, experiment.duty[there]]
        )

    def between(self, first: float, last: float) -> "_Samples":
        """The samples in a span of time."""
        inside = (self.time >= first) & (self.time <= last)
        part = object.__new__(_Samples)
        part.time, part.rows = self.time[inside], self.rows[inside]
        return part


def _same(shorter: _Samples, longer: _Samples, shift: float) -> int:
    """How many samples of one recording are, after a shift of time, those of the other."""
    time = shorter.time + shift
    at = np.clip(np.searchsorted(longer.time, time - SAME_TIME), 0, len(longer.time) - 1)
    same = (np.abs(longer.time[at] - time) < SAME_TIME) & np.all(
        longer.rows[at] == shorter.rows, axis=1
    )
    return int(np.count_nonzero(same))


# The number of samples at the start that are looked at, of all channels together.
FIRST_SAMPLES = 50

# How far the first reading may lie outside the bounds of the plate's temperature at the start, K:
# sensors err, and a plate may be uneven.
BEYOND_BOUNDS = 5.0

# Beginning and end of a span, s, and the weight in between, which is 0 if it is not given.
Span = tuple[float, float] | tuple[float, float, float]


def named_recordings(twin: Twin, experiments: Sequence[Experiment]) -> dict[str, Experiment]:
    """Checks recordings, and returns them by the names of their results.

    **Arguments:**

    - `twin`: a twin of the rig to which they must belong.
    - `experiments`: one or several recordings.

    **Returns:** name -> recording, in order. The name is the recording's own, or its number if it
    has none. A repeated name is followed by its number, or by the next number that is not taken.

    **Raises:** `MatchError` if there is no recording, or one has no temperatures, or a channel of
    one has none, or one is in kelvin; `SimulationError` for a recording of another
    rig.
    """
    check_twin("twin", twin, MatchError)
    if not experiments:
        raise MatchError("experiments: expected one or several recordings, got none")
    names: list[str] = []
    for number, experiment in enumerate(experiments, start=1):
        name = experiment.name or f"recording {number}"
        if experiment.temperatures is None or not experiment.channels:
            raise MatchError(f"{name}: expected recorded temperatures, got none")
        checked_channels(twin, experiment)
        if experiment.unsampled:
            raise MatchError(
                f"{name}: channel {experiment.unsampled[0]}: expected at least one sample, got "
                "missing ones only; leave the channel out with Experiment.select"
            )
        check_units(twin, name, experiment)
        names.append(name)
    # Two recordings of one name must not share a row of a table.
    result: list[str] = []
    for number, name in enumerate(names, start=1):
        free = (f"{name} ({other})" for other in count_from(number))
        result.append(
            name if name not in result else next(other for other in free if other not in names)
        )
    return dict(zip(result, experiments, strict=True))


def divided(
    experiments: Sequence[Experiment], groups: Sequence[str] | None = None, gaps: Gaps = "hold"
) -> tuple[list[Experiment], Sequence[str] | None]:
    """The recordings that are matched or predicted, and their groups: the given ones, divided at
    each gap or only where nobody knows what happened.

    **Raises:** `MatchError` for another treatment of gaps.
    """
    if gaps not in ("hold", "split"):
        raise MatchError(f'gaps: expected "hold" or "split", got {gaps!r}')
    pieces = parts_between_gaps if gaps == "split" else separate_recordings
    parts = [pieces(experiment) for experiment in experiments]
    if groups is not None and is_ordered(groups) and len(groups) == len(parts):
        groups = [name for name, of_one in zip(groups, parts, strict=True) for _ in of_one]
    return [part for of_one in parts for part in of_one], groups


def named_groups(
    recordings: Mapping[str, Experiment], groups: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """The groups of recordings: their names, and the number of each recording's group.

    **Arguments:**

    - `groups`: the name of each recording's group; by default the groups that the recordings name.

    **Raises:** `MatchError` if there is not a name for each recording.
    """
    several = list(recordings.values())
    if groups is None:
        named = [experiment.group for experiment in several]
        if not any(named):
            return ("",), (0,) * len(named)
    else:
        if not is_ordered(groups):
            raise MatchError(f"groups: expected a name for each recording, got {groups!r}")
        named = list(groups)
        for name in named:
            of_kind("groups", name, str, "text", MatchError)
    if len(named) != len(several) or not all(named):
        raise MatchError(
            "groups: expected a name for each recording, such as its day, got "
            f"{named!r} for {', '.join(recordings)}"
        )
    names = tuple(dict.fromkeys(named))
    return names, tuple(names.index(name) for name in named)


def check_distinct(recordings: Mapping[str, Experiment]) -> None:
    """Refuses a recording that is there twice, under whatever names, or of which another one holds
    a part: its samples would count as new data, and standard errors would be too small.

    **Raises:** `MatchError` with both names.
    """
    for (name, experiment), (later, other) in combinations(recordings.items(), 2):
        if other.fingerprint == experiment.fingerprint:
            raise MatchError(
                f"experiments: {later} is the same recording as {name}: expected each once, "
                "because the second adds no information; leave it out"
            )
        shared = shared_samples(experiment, other)
        if shared:
            raise MatchError(
                f"experiments: {shared} samples of {later} are those of {name}: expected each "
                "once, because the second adds no information; leave one of the two out, or divide "
                "the recording with Experiment.between"
            )


def check_units(twin: Twin, name: str, experiment: Experiment) -> None:
    """Refuses a recording in kelvin that says degC: its first readings are 273 K above a room.

    **Raises:** `MatchError` that names the recording and its first reading.
    """
    assert experiment.temperatures is not None, "named_recordings has checked it"
    # A median, because the first sample of all may be a wrong one.
    first = float(np.median(experiment.temperatures[experiment.sampled][:FIRST_SAMPLES]))
    recorded = first_sample(experiment).ambient
    start = room_temperature(twin.rig, twin.numbers_si, recorded)
    celsius = first - ZERO_CELSIUS
    if is_probably_kelvin(first, start):
        raise MatchError(
            f"{name}: temperatures: expected degC, got {first:.1f} degC at the start in a room of "
            f"{start:.0f} degC; are they in K, {celsius:.1f} degC? A column of kelvin is called "
            "NAME_K"
        )


def check_start(rig: Rig, free: Iterable[Parameter], name: str, experiment: Experiment) -> None:
    """Refuses a recording that begins where the bounds do not let the twin begin.

    A free parameter that is by itself the temperature at the start of what some channels read, such
    as `T_start` of the bundled rigs, is compared with their first readings.

    **Raises:** `MatchError` that names the recording, the parameter and its bounds.
    """
    starts = _channel_starts(rig)
    for row in free:
        own = {Value(1.0, ((row.name, 1.0),))}
        begins = np.array([starts[channel] == own for channel in experiment.channels])
        # A part behind a gap does not begin with its first reading.
        read = first_readings(experiment)[begins & experiment.sampled[0]]
        if not len(read):
            continue
        first = float(read.mean())
        lower, upper = (row.to_si(bound) - ZERO_CELSIUS for bound in (row.lower, row.upper))
        if not lower - BEYOND_BOUNDS <= first <= upper + BEYOND_BOUNDS:
            raise MatchError(
                f"{name}: temperatures: expected a start within the bounds of {row.name}, "
                f"{lower:g} to {upper:.10g} degC, got {first:.1f} degC; other bounds are given by "
                f'bounds={{"{row.name}": (lowest, highest)}}'
            )


def _channel_starts(rig: Rig) -> dict[str, set[Value]]:
    """The temperatures at the start of what each channel reads: those of the rig, unless its bodies
    have their own."""
    own = {body.name: body.initial_temperature for body in rig.bodies} | dict(rig.initial_nodes)
    starts = {}
    for channel in rig.channels:
        nodes = channel.sensor.weights(rig.plate)
        starts[channel.name] = {own.get(node) or rig.initial_temperature for node in nodes}
    return starts


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
                    f"s, got {event:.10g} s"
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
