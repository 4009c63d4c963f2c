r"""The tail of a statistic of healthy rigs: from what is seen in hours to once in months.

Peaks over a level $u$ that few blocks of a minute pass have an exponential tail, for cumulative
sums exactly so in the limit (their run length grows by $e^{2kh}$): the logarithm of the mean time
between two passages of $h$ is linear in $h$. The scale is the mean excess. Two levels are tried,
which a fifth of the blocks and a hundred of them pass, and the one with the higher threshold
counts: healthy rigs differ, so that the peaks of many hours are those of the rigs that differ most;
and where simulations are calmer than a rig, their last peaks are too. How far the rate at a
threshold may be off is found by drawing recordings, and in each the blocks, again.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ._thresholds import DAY, FAMILIES, Tail

# The length of a block, s, of which the largest value counts.
BLOCK_SECONDS = 60.0

# The part of the blocks that passes the lower level.
TAIL_FRACTION = 0.2

# So many blocks pass the higher one: the scale is then known to a tenth.
PEAKS = 100

# How often recordings are drawn again.
REDRAWN = 200

# The smallest number of blocks from which a tail is estimated.
MIN_BLOCKS = 25


def block_maxima(
    time: Float[np.ndarray, " times"], statistic: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " blocks"]:
    """The largest values of the whole blocks of a recording."""
    number = ((time - time[0]) / BLOCK_SECONDS).astype(int)
    count = int((time[-1] - time[0]) / BLOCK_SECONDS)
    result = np.full(count + 1, -np.inf)
    np.maximum.at(result, np.minimum(number, count), statistic)
    return result[:count][np.isfinite(result[:count])]


def tail_of(
    maxima: Sequence[Float[np.ndarray, " blocks"]], source: str, month: float = 30 * DAY
) -> Tail | None:
    """The tail of a statistic from its block maxima in several recordings; None if there are too
    few blocks."""
    several = [one for one in maxima if len(one)]
    if sum(map(len, several)) < MIN_BLOCKS:
        return None
    blocks, seconds = np.concatenate(several), month * len(FAMILIES)
    tails = {
        passing: Tail(*_tail(blocks, passing), source, len(blocks) * BLOCK_SECONDS / 3600)
        for passing in (TAIL_FRACTION, min(TAIL_FRACTION, PEAKS / len(blocks)))
    }
    passing = max(tails, key=lambda one: tails[one].threshold(seconds))
    at = tails[passing].threshold(seconds)
    random = np.random.default_rng(0)
    logs = []
    for _ in range(REDRAWN):
        drawn = [several[n] for n in random.integers(len(several), size=len(several))]
        again = np.concatenate([one[random.integers(len(one), size=len(one))] for one in drawn])
        logs.append(math.log(Tail(*_tail(again, passing)).seconds(at)))
    return tails[passing]._replace(spread=float(np.std(logs)))


def _tail(maxima: Float[np.ndarray, " blocks"], passing: float) -> tuple[float, float, float]:
    """The level that a part of the blocks passes, its rate and the scale."""
    level = float(np.quantile(maxima, 1 - passing))
    over = maxima[maxima > level] - level
    scale = max(float(over.mean()) if len(over) else 0.0, 1e-3 * max(abs(level), 1e-3))
    return level, passing / BLOCK_SECONDS, scale
