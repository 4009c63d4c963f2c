"""What says that a simulated loop does not come to rest at its references."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._measures import SETTLING_BAND

# The last part of a run, in which references that do not change should be held.
LAST_PART = 0.25

# An output swings if it crosses its mean so often in the last part.
CROSSINGS = 4

# An error that is below this part of what it was a quarter of the run before becomes smaller.
COMES_NEARER = 0.9


def unsettled(loop: Any, outputs: Sequence[str]) -> tuple[str, ...]:
    """Describes in a sentence each output that swings at the end of a run, stays away from its
    reference, or drifts away from it: gains that are too large, cells that heat the output of
    another, a sample time that is too long, or a duty at its limit.

    A run whose references change in its last half says nothing. Swings of less than twice the
    settling band (0.5 K), and errors of less than twice the band, are none. An output drifts if the
    line through its errors in the last quarter of the run leads away from the reference, by more
    than the band in a time as long as the run, and then is more than twice the band away.

    **Arguments:**

    - `loop`: a `ClosedLoop`.
    - `outputs`: the names of the outputs.
    """
    reference, output = np.asarray(loop.reference), np.asarray(loop.output)
    count = len(reference)
    last, half = count - int(LAST_PART * count), count // 2
    if last <= half or np.ptp(reference[half:], axis=0).any():
        return ()
    said = []
    for name, error in zip(outputs, (output - reference).T, strict=True):
        end, before = error[last:], error[half:last]
        swing = float(np.ptp(end))
        crossings = np.count_nonzero(np.diff(np.sign(end - end.mean())))
        if swing > 2 * SETTLING_BAND and crossings >= CROSSINGS:
            said.append(f"{name} swings by {swing:.1f} K at the end")
        elif min(abs(end)) > 2 * SETTLING_BAND and abs(end[-1]) > COMES_NEARER * abs(before[0]):
            side = "above" if end[-1] > 0 else "below"
            said.append(f"{name} stays {abs(end[-1]):.1f} K {side} its reference")
        else:
            slope, now = np.polyfit(np.arange(len(end)) - len(end) + 1, end, 1)
            moved, later = slope * count, now + slope * count
            # A line towards the reference is an approach.
            is_away = abs(moved) > SETTLING_BAND and moved * now > 0
            if is_away and abs(later) > 2 * SETTLING_BAND:
                side = "above" if later > 0 else "below"
                said.append(
                    f"{name} drifts, now {abs(now):.1f} K {side} its reference and "
                    f"{abs(later):.1f} K after as long again"
                )
    return tuple(said)
