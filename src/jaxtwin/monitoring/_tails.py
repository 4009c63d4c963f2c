r"""The tail of a statistic of healthy rigs: from what is seen in hours to once in months.

Peaks over a level $u$ that few blocks of a minute pass have an exponential tail, for cumulative
sums exactly so in the limit (their run length grows by $e^{2kh}$): the logarithm of the mean time
between two passages of $h$ is linear in $h$. The scale is the mean excess. The level is as high as
leaves enough peaks, at least that of a fifth of the blocks: healthy rigs differ, and of many hours
the last peaks are those of the rigs that differ most. How far the rate at a threshold may be off is
found by drawing recordings, and in each the blocks, again.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ._thresholds import DAY, FAMILIES, Tail

BLOCK = 60.0
"""The length of a block, s, of which the largest value counts."""

PASSING = 0.2
"""The largest part of the blocks that passes the level of a tail."""

PEAKS = 100
"""So many blocks pass it if they are no larger part: the scale is then known to a tenth."""

REDRAWN = 200
"""How often recordings are drawn again."""

LEAST_BLOCKS = 25
"""The smallest number of blocks from which a tail is estimated."""


def block_maxima(
    time: Float[np.ndarray, " times"], statistic: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " blocks"]:
    """The largest values of the whole blocks of a recording."""
    number = ((time - time[0]) / BLOCK).astype(int)
    count = int((time[-1] - time[0]) / BLOCK)
    found = np.full(count + 1, -np.inf)
    np.maximum.at(found, np.minimum(number, count), statistic)
    return found[:count][np.isfinite(found[:count])]


def tail_of(
    maxima: Sequence[Float[np.ndarray, " blocks"]], source: str, month: float = 30 * DAY
) -> Tail | None:
    """The tail of a statistic from its block maxima in several recordings; None if there are too
    few blocks."""
    several = [one for one in maxima if len(one)]
    if sum(map(len, several)) < LEAST_BLOCKS:
        return None
    hours = sum(map(len, several)) * BLOCK / 3600
    found = Tail(*_tail(np.concatenate(several)), source, hours)
    seconds = month * len(FAMILIES)
    at = found.threshold(seconds)
    random = np.random.default_rng(0)
    logs = []
    for _ in range(REDRAWN):
        drawn = [several[n] for n in random.integers(len(several), size=len(several))]
        again = np.concatenate([one[random.integers(len(one), size=len(one))] for one in drawn])
        logs.append(math.log(Tail(*_tail(again)).seconds(at)))
    return found._replace(spread=float(np.std(logs)))


def _tail(maxima: Float[np.ndarray, " blocks"]) -> tuple[float, float, float]:
    """The level, its rate and the scale."""
    passing = min(PASSING, PEAKS / len(maxima))
    level = float(np.quantile(maxima, 1 - passing))
    over = maxima[maxima > level] - level
    scale = max(float(over.mean()) if len(over) else 0.0, 1e-3 * max(abs(level), 1e-3))
    return level, passing / BLOCK, scale
