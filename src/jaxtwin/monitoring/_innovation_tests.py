"""Tests of the innovations of each channel: cumulative sums, likelihood ratio, energy."""

from dataclasses import replace
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._cumulative import ENERGY_SAMPLES, CumulativeSums, Window, energy_after
from ._evidence import Evidence, Seen

CLIP = 4.0
"""The largest standardised innovation that counts."""

HELD = 10.0
"""After an innovation that is larger than `CLIP`, those of all channels say nothing for this time,
s. If it is over then, as after a correction of a camera, an outlier or a jump of the command, it is
forgotten; a fault lasts, and all of it counts."""

REARMED = 60.0
"""They are held only once in this time, s: no fault hides behind them."""

LASTS = 2.0
"""A mean of the innovations in the second half of this time that is larger lasts."""


class Statistics(eqx.Module):
    """The statistics, and the last innovations."""

    sums: CumulativeSums
    window: Window
    energy: Float[Array, " channels"]
    last: Float[Array, " channels"]


@final
class InnovationState(eqx.Module):
    """Where the tests are between two samples.

    - `statistics`: what they are. `before`: what they were when innovations were held last.
    - `since_held`: the time since then, s.
    - `late`, `count`: the sum of the innovations in the second half of it, and their number.
    """

    statistics: Statistics
    before: Statistics
    since_held: Float[Array, ""]
    late: Float[Array, " channels"]
    count: Float[Array, " channels"]


@final
class InnovationTests(eqx.Module):
    """The tests of the innovations.

    - `scales`, `memory`: the usual spread of the innovations of each channel, and the correlation
      of two that follow each other.
    - `thresholds`: of the sum, the ratio and the energy. `ceiling`: the largest sum.
    """

    scales: Float[np.ndarray | Array, " channels"]
    memory: Float[np.ndarray | Array, " channels"]
    thresholds: Float[np.ndarray | Array, "3"]
    ceiling: Float[np.ndarray | Array, ""]

    def init(self) -> InnovationState:
        """The state before the first sample."""
        channels = len(self.scales)
        none = jnp.zeros(channels)
        begin = Statistics(
            CumulativeSums.zero(channels), Window.zero(channels), jnp.ones(channels), none
        )
        return InnovationState(begin, begin, jnp.full((), REARMED), none, none)

    def step(
        self, state: InnovationState, seen: Seen, dt: Float[Array, ""], settled: Bool[Array, ""]
    ) -> tuple[InnovationState, tuple[Evidence, Evidence, Evidence]]:
        """The state after a sample, and what sum, ratio and energy say."""
        scaled = jnp.asarray(seen.whitened) / self.scales
        there = jnp.isfinite(jnp.asarray(seen.readings))
        was_held = state.since_held < HELD
        since_held = state.since_held + dt
        begins = (jnp.abs(scaled) > CLIP).any() & (since_held >= REARMED)
        since_held = jnp.where(begins, 0.0, since_held)
        is_held = since_held < HELD
        lasts = (jnp.abs(state.late) >= LASTS * jnp.maximum(state.count, 1.0)).any()
        # Of readings that are rarer than half of the time, nobody knows whether it is over.
        lasts = lasts | (state.count.sum() == 0)
        ends = was_held & ~is_held & ~lasts
        now = _chosen(ends, state.before, state.statistics)
        before = _chosen(begins, now, state.before)
        is_late = is_held & (since_held >= HELD / 2) & there
        late = jnp.where(begins, 0.0, state.late + jnp.where(is_late, scaled.clip(-CLIP, CLIP), 0))
        count = jnp.where(begins, 0.0, state.count + is_late)
        now = self._after(now, seen, scaled, there & settled, dt)
        found = self._evidence(now, dt, settled & ~is_held)
        return InnovationState(now, before, since_held, late, count), found

    def _after(
        self,
        old: Statistics,
        seen: Seen,
        scaled: Float[Array, " channels"],
        used: Bool[Array, " channels"],
        dt: Float[Array, ""],
    ) -> Statistics:
        # Clipped before they are whitened in time: a large one is not spread over those after it.
        clipped = jnp.clip(scaled, -CLIP, CLIP)
        white = (clipped - self.memory * old.last) / jnp.sqrt(1 - self.memory**2)
        x = jnp.clip(white, -CLIP, CLIP)
        innovation = jnp.where(used, jnp.asarray(seen.readings) - seen.expected, 0.0)
        return replace(
            old,
            sums=old.sums.after(x, innovation, used, dt, jnp.asarray(self.ceiling)),
            window=old.window.after(x, innovation, used, dt),
            energy=energy_after(old.energy, x, used),
            last=jnp.where(used, clipped, old.last),
        )

    def _evidence(
        self, now: Statistics, dt: Float[Array, ""], speaks: Bool[Array, ""]
    ) -> tuple[Evidence, Evidence, Evidence]:
        sums = now.sums
        way = jnp.argmax(sums.sums, axis=0)[None]

        def of_way(table: Array) -> Array:
            return jnp.take_along_axis(table, way, axis=0)[0]

        ratio, age, size = now.window.ratio()
        mean = of_way(sums.totals) / jnp.maximum(of_way(sums.counts), 1.0)
        # The energy has no memory of when it rose: it is as old as what it averages.
        averaged = jnp.full_like(now.energy, ENERGY_SAMPLES) * dt
        scores = jnp.stack([of_way(sums.sums), ratio, now.energy])
        scores = scores / jnp.asarray(self.thresholds)[:, None]
        of_sum, of_ratio, of_energy = jnp.where(speaks, scores, 0.0)
        return (
            Evidence(of_sum, of_way(sums.ages), mean),
            Evidence(of_ratio, age, size),
            Evidence(of_energy, averaged, jnp.sqrt(now.energy)),
        )


def _chosen(condition: Bool[Array, ""], yes: Statistics, no: Statistics) -> Statistics:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
