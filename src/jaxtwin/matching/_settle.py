"""What belongs to a recording and not to the rig, taken from the recording's first minute.

A saved fit says what the rig is like. Where it stands today it cannot say: the room's temperature,
the rig's own at the start, the delay of the drive. These few values are matched to the first part
of a recording with everything else held, and no later sample is looked at.

Where the drive is off until then, the readings show the start temperature, and the room's by the
way they drift. Where it is on from the start, the match knows the drive and the rig, and does the
same. In both cases a rig that is switched on is expected to have stood in its room: beforehand both
temperatures are what the camera reads first, give or take `AT_REST`. A drift of the room does not
show in a minute: it stays what the rig file says.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter
from ._descend import descend
from ._estimate import Setting, first_knowledge, learn, make_problem
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._match import checked_recordings
from ._unknowns import choose_unknowns

WARM_UP = 60.0
"""Length of the part of a recording from which its own values are taken, s."""

AT_REST = 2.0
"""How far room and rig are from the first reading, K, as a standard deviation beforehand."""

MOVED = 2.0
"""A reading that has moved this far from the first, K, counts half."""

ITERATIONS = 50


def settle(
    twin: Twin, recording: Experiment, warm_up: float = WARM_UP, own: Iterable[str] | None = None
) -> Twin:
    """The twin with the values of one recording, taken from its first part alone.

    **Arguments:**

    - `twin`: with the values of the rig, such as a fit's.
    - `recording`: of which the part before `warm_up` is looked at.
    - `warm_up`: from the first sample on, s.
    - `own`: the parameters that belong to a recording; by default those that the rig's table gives
      the scope `"recording"`, but for a drift of the room, which a minute does not show.
      Temperatures are expected at the first reading, others at their value in the twin with the
      spread of their prior.

    **Returns:** the twin; without parameters of a recording, the one that was given.

    **Raises:** `MatchError` where the recording has no temperatures, the part holds fewer times
    with a sample than there are values to take, a value of the twin lies outside its bounds, or the
    twin gives no finite temperatures; `ParameterError` for unknown names; `SimulationError` for a
    recording of another rig.
    """
    table = twin.rig.parameters
    names = [n for n, row in table.items() if row.scope == "recording"] if own is None else [*own]
    if twin.rig.ambient_drift is not None and own is None:
        drifts = [name for name, _ in twin.rig.ambient_drift.powers if name in names]
        twin = twin.with_parameters({name: table[name].value for name in drifts})
        names = [name for name in names if name not in drifts]
    if not names:
        return twin
    (label,) = checked_recordings(twin, [recording])
    early = recording.time < recording.time[0] + warm_up
    count = int(np.count_nonzero(recording.sampled[early].any(axis=1)))
    if count < max(2, len(names)):
        raise MatchError(
            f"{label}: warm_up = {warm_up:g} s: found {count} samples, allowed are at least "
            f"{max(2, len(names))} for {', '.join(names)}"
        )
    part = recording.between(None, recording.time[0] + warm_up)
    first = float(np.nanmean(_first(part)))
    unknowns = choose_unknowns(twin, 1, free=names, per_recording=names)
    unknowns = replace(unknowns, own=tuple(_expected(row, first) for row in unknowns.own))
    error = twin.rig.common_error
    setting = Setting(
        twin=twin,
        experiments=(part,),
        unknowns=unknowns,
        samples=(_weights(part),),
        events=None if error is not None and error.detect else ((),),
        common_error=error,
        robust=None,
    )
    solver = BoundedLevenbergMarquardt(rtol=1e-6)
    knowledge = first_knowledge(setting)
    (attempt,) = descend(
        [make_problem(setting, knowledge)],
        solver,
        [unknowns.start()],
        ITERATIONS,
        setting.box,
        setting.scale,
    )
    # A correction of the camera in this minute must not be taken for a plate that cools. Only
    # their times are learned: a minute is too short to learn the noise from.
    events = learn(setting, knowledge, attempt).events
    if any(events):
        problem = make_problem(setting, replace(knowledge, events=events))
        (attempt,) = descend(
            [problem],
            solver,
            [attempt.vector],
            ITERATIONS,
            setting.box,
            setting.scale,
            [attempt],
        )
    if not np.isfinite(attempt.cost):
        raise MatchError(f"{label}: the twin gives no finite temperatures")
    (values,) = unknowns.values(attempt.vector)
    return twin.with_parameters({name: float(value) for name, value in values.items()})


def _weights(part: Experiment) -> Float[np.ndarray, "times channels"]:
    """Of each sample, 0 to 1: a twin is right to some per cent of what the drive does, so what has
    moved far from the first reading says less about where the recording started."""
    assert part.temperatures is not None
    moved = np.where(part.sampled, part.temperatures - _first(part), np.inf)
    return 1 / (1 + (moved / MOVED) ** 2)


def _first(part: Experiment) -> Float[np.ndarray, " channels"]:
    """The first reading of each channel that is not missing, NaN where all are, degC."""
    assert part.temperatures is not None
    rows = part.sampled.argmax(axis=0)
    return part.temperatures[rows, np.arange(len(rows))]


def _expected(row: Parameter, first: float) -> Parameter:
    """A value of a recording with what is known of it beforehand."""
    if row.offset == 0:
        return replace(row, prior_value=row.value)
    value = float(np.clip(first, row.lower, row.upper))
    return replace(row, value=value, prior_value=value, prior_spread=AT_REST)
