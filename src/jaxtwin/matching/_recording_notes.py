"""What a match should say of its recordings: gaps, channels at the end of their range, readings
that no part of the rig can have, and readings that hold much of the misfit."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from .._celsius import ZERO_CELSIUS
from ..errors import JaxtwinError
from ..io import Experiment, gap_sentences
from ..physics import Twin
from ..simulation import simulate
from ._start import hidden_parameters, plate_parameters

# A single reading that holds a larger share of the sum of squared residuals is named.
INFLUENTIAL_SHARE = 0.1

# Its square must also be this multiple of the mean one.
INFLUENTIAL_MEANS = 20.0

# So many samples in a row at the highest or lowest value of all, or more, may be the end of a
# sensor's range.
MAX_STAY = 10

# A channel at the end of its range has this many times as many samples there as at the value beside
# it. A temperature that settles is slow before, so that both have many.
STANDS = 20


# Temperatures that need no look at the rig, degC.
ORDINARY_RANGE_DEGC = (-60.0, 150.0)

# A reading is beyond what a rig reaches if it is this many times as far from the room as any part
# of the rig at rest under full duty; its values are not known yet.
BEYOND_REACH = 3.0

# For what else warms or cools a rig, K.
ALLOWANCE = 20.0


def recording_notes(experiment: Experiment, twin: Twin) -> list[str]:
    """What is assumed of the gaps of a recording, which channels stand at one value, and which
    readings no part of the rig can have, in sentences.

    **Arguments:**

    - `twin`: the twin with the values before the match.
    """
    notes = gap_sentences(experiment) + _beyond_reach(experiment, twin)
    if experiment.temperatures is None:
        return notes
    for name, readings in zip(experiment.channels, experiment.temperatures.T, strict=True):
        there = ~np.isnan(readings)
        for word, sign in (("highest", 1.0), ("lowest", -1.0)):
            at_end = _at_end_of_range(sign * readings[there])
            if at_end.any():
                value = readings[there][at_end][0]
                first = experiment.time[there][at_end][0]
                notes.append(
                    f"{experiment.name or 'the recording'}: {name} stands at its {word} value, "
                    f"{value:.6g} degC, in {at_end.sum()} of {there.sum()} samples, first at "
                    f"{first:.10g} s, as at the end of a sensor's range: these readings are bounds "
                    "and not temperatures; make them missing (NaN), or masks=... leaves them out"
                )
    return notes


def influential_readings(
    experiments: Sequence[Experiment], simulated: Sequence[Float[np.ndarray, "_times _channels"]]
) -> list[str]:
    """A sentence for each reading that holds a large share of the misfit of all recordings."""
    squares = [
        (experiment, np.nan_to_num(reading - np.asarray(experiment.temperatures)) ** 2)
        for experiment, reading in zip(experiments, simulated, strict=True)
    ]
    total = sum(float(square.sum()) for _, square in squares)
    count = sum(int(experiment.sampled.sum()) for experiment, _ in squares)
    lines: list[str] = []
    for experiment, square in squares:
        shares = square / max(total, 1e-300)
        # Of a few readings each holds much.
        for row, column in np.argwhere(shares > max(INFLUENTIAL_SHARE, INFLUENTIAL_MEANS / count)):
            assert experiment.temperatures is not None
            lines.append(
                f"{experiment.name}: one reading of {experiment.channels[column]}, "
                f"{experiment.temperatures[row, column]:.4g} degC at {experiment.time[row]:g} s, "
                f"holds {100 * shares[row, column]:.0f} % of the misfit of all readings; if it is "
                "no temperature of the rig, leave it out (jaxtwin import --mask-glitches, "
                "Experiment.without_glitches()), or match with loss=Huber()"
            )
    return lines


def _beyond_reach(experiment: Experiment, twin: Twin) -> list[str]:
    temperatures = experiment.temperatures
    if temperatures is None:
        return []
    if (
        np.nanmin(temperatures) >= ORDINARY_RANGE_DEGC[0]
        and np.nanmax(temperatures) <= ORDINARY_RANGE_DEGC[1]
    ):
        return []
    lowest, highest = _reach(twin)
    if experiment.ambient is not None:
        room = float(twin.rig.ambient_temperature.evaluate(twin.numbers_si)) - ZERO_CELSIUS
        lowest += min(0.0, float(np.min(experiment.ambient)) - room)
        highest += max(0.0, float(np.max(experiment.ambient)) - room)
    notes = []
    for name, readings in zip(experiment.channels, temperatures.T, strict=True):
        (rows,) = np.nonzero((readings < lowest) | (readings > highest))
        if len(rows):
            first = rows[0]
            notes.append(
                f"{experiment.name or 'the recording'}: {name}: {len(rows)} readings, the first "
                f"{readings[first]:.6g} degC at {experiment.time[first]:.10g} s, are beyond "
                f"{lowest:.0f} to {highest:.0f} degC, what any part of the rig can reach; make "
                "them missing (NaN), or masks=... leaves them out"
            )
    return notes


def _reach(twin: Twin) -> tuple[float, float]:
    """The lowest and the highest temperature that any part of a rig can have, degC."""
    rig = twin.rig
    room = float(rig.ambient_temperature.evaluate(twin.numbers_si)) - ZERO_CELSIUS
    result = [room]
    for duty in ((1.0,) * len(rig.driven), rig.lowest_duty):
        held = Experiment([0.0, 1.0], [duty, duty])
        try:
            result += simulate(twin, held, initial="steady").states[0].tolist()
        except JaxtwinError:  # a cell that runs away has no rest
            return -ZERO_CELSIUS, np.inf
    starts = plate_parameters(rig) | hidden_parameters(rig)
    bounds = [
        row.to_si(bound) - ZERO_CELSIUS
        for name, row in rig.parameters.items()
        if name in starts and row.offset
        for bound in (row.lower, row.upper)
    ]
    lowest = room - BEYOND_REACH * (room - min(result)) - ALLOWANCE
    highest = room + BEYOND_REACH * (max(result) - room) + ALLOWANCE
    return min([lowest, *bounds]), max([highest, *bounds])


def _at_end_of_range(readings: Float[np.ndarray, " samples"]) -> Bool[np.ndarray, " samples"]:
    """The samples at the highest value, if a channel came to stand there; none otherwise."""
    none = np.zeros(len(readings), bool)
    values, counts = np.unique(readings, return_counts=True)
    if len(values) < 3 or counts[-1] < STANDS * counts[-2]:
        return none
    at_end = readings == values[-1]
    edges = np.flatnonzero(np.diff(np.append(np.insert(at_end.astype(int), 0, 0), 0)))
    begins, ends = edges[::2], edges[1::2]
    # A recording may begin at rest, in which a coarse sensor shows a single value.
    stays = (ends - begins)[begins > 0]
    return at_end if len(stays) and stays.max() >= MAX_STAY else none
