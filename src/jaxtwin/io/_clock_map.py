r"""Maps device time to host time, by the offset, drift and jitter of a device's clock.

A stamp $d$ of the device arrives at host time $a = m(d) + w$ after a wait $w$ that is never below
the shortest one and has a long tail (buffers, scheduling). The fastest arrivals therefore show the
clock, and the others the wait: $m$ passes through the earliest arrival of each block of time. The
shortest wait itself cannot be determined from one side. It remains in $m$ and is well below a
millisecond on USB and loopback.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

BLOCKS = 8

# Limits of the length of a block, s. A block is an eighth of the recording within these limits, as
# the drift of a crystal changes within the hour.
SHORTEST_BLOCK, LONGEST_BLOCK = 10.0, 600.0


@final
@dataclass(frozen=True, eq=False)
class ClockMap:
    """A device's clock as seen from the host.

    **Arguments:**

    - `rate`: the nominal seconds of device time in a second of host time.
    - `device`, `offset`: knots `(knots,)`, s: host time is `device / rate + offset` there, and
        linear in between.
    - `drift`: the relative amount by which the device's clock is too fast, 1e-6 (ppm).
    - `wait`: the delay of the stamps after the mapped time: median, 99th percentile and maximum, s.
      This is the jitter.
    """

    rate: float
    device: Float[np.ndarray, " knots"]
    offset: Float[np.ndarray, " knots"]
    drift: float
    wait: tuple[float, float, float]

    @classmethod
    def fit(
        cls, device_us: Int[np.ndarray, " stamps"], arrival: Int[np.ndarray, " stamps"], rate: float
    ) -> "ClockMap":
        """Fits the map to stamps of one start of a device.

        **Arguments:**

        - `device_us`: device time, microseconds.
        - `arrival`: host time of the same messages, ns, in order.
        - `rate`: nominal seconds of device time in a second.
        """
        device = device_us * 1e-6
        # Differences of nanosecond integers first: float64 cannot hold 1e18 ns.
        start = int(arrival[0])
        host = (arrival - start) * 1e-9
        offset = host - device / rate
        span = float(host[-1]) or 1.0
        length = np.clip(span / BLOCKS, SHORTEST_BLOCK, LONGEST_BLOCK)
        # All blocks have the full length: a short one at the end may contain no fast arrival.
        blocks = max(1, int(span / length))
        block = np.minimum((host / span * blocks).astype(np.int64), blocks - 1)

        knots = _earliest(block, offset)
        slope = _slope(device[knots], offset[knots])
        # Within a block the drift itself moves the offset: the earliest is looked for without it.
        knots = _earliest(block, offset - slope * device)
        knots_device, knots_offset = device[knots], offset[knots]
        late = offset - _offsets(device, knots_device, knots_offset, slope)
        late -= late.min()
        wait = (float(np.median(late)), float(np.quantile(late, 0.99)), float(late.max()))
        drift = -slope * rate * 1e6
        return cls(rate, knots_device, knots_offset + start * 1e-9, drift, wait)

    def host_seconds(self, device_us: Int[np.ndarray, " stamps"]) -> Float[np.ndarray, " stamps"]:
        """Host time of device stamps, s since 1970 (float64 resolves 0.3 microseconds)."""
        device = device_us * 1e-6
        slope = -self.drift * 1e-6 / self.rate
        return device / self.rate + _offsets(device, self.device, self.offset, slope)


def _earliest(block: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Index of the smallest offset in each block, in order."""
    order = np.lexsort((offset, block))
    return np.sort(order[np.unique(block[order], return_index=True)[1]])


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """The Theil-Sen slope, the median over pairs of knots: blocks without a fast arrival hardly
    change it. Knots are thinned out to fewer than 400."""
    step = max(1, len(x) // 200)
    x, y = x[::step], y[::step]
    dx = x[:, None] - x[None, :]
    far = dx > 0
    if not far.any():
        return 0.0
    return float(np.median((y[:, None] - y[None, :])[far] / dx[far]))


def _offsets(
    device: np.ndarray, knots: np.ndarray, offsets: np.ndarray, slope: float
) -> np.ndarray:
    """Interpolates linearly between the knots, and extrapolates with the mean slope."""
    beyond = device - np.clip(device, knots[0], knots[-1])
    return np.interp(device, knots, offsets) + slope * beyond
