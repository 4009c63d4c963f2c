"""Tests of the innovations of each channel: cumulative sums, likelihood ratio,
energy; and of all channels together."""

from dataclasses import replace
from functools import partial
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..observers import is_due
from ._cumulative import (
    ENERGY_SAMPLES,
    CumulativeSums,
    LikelihoodWindow,
    energy_after,
    joint_ratio,
    picked,
)
from ._evidence import Evidence, ObservedSample

# The largest standardised innovation that counts. With a larger one, single innovations make up the
# tail of the likelihood ratio where it is measured, and what is extrapolated is passed far too
# often (`benchmarks/monitor.py`).
CLIP = 3.0

# The standardised innovation of a jump.
JUMP = 4.0

# After a jump of several channels at once, and when a camera is due to correct itself, all of them
# say nothing for this time, s. If it is over then, as after a correction of a camera, an outlier or
# a jump of the command, it is forgotten; a fault lasts, and all of it counts.
MASK_SECONDS_AFTER_JUMP = 10.0

# The tests are masked at most once in this time, s, so that masks cannot hide a fault.
MIN_SECONDS_BETWEEN_MASKS = 60.0

# A jump lasts if the innovations in the second half of this time are unlike noise: if the sum of
# their squared means, a chi-squared variable, is above its mean by this number of standard
# deviations.
PERSISTENCE_SIGMAS = 5.0

# At this multiple of its threshold a likelihood ratio begins again, and a sum grows no more. It
# decides how soon a finding clears.
RESET_SCORE = 1.5


@final
class Statistics(eqx.Module):
    """The statistics, and the last innovations."""

    sums: CumulativeSums
    window: LikelihoodWindow
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

    - `scales`, `lag_one_correlation`: the usual spread of the innovations of each channel, and the
      correlation of two that follow each other.
    - `thresholds`: of the sum, the ratio, the joint ratio and the energy.
    - `reset_score`: the score at which a ratio begins again, and of a sum the largest one; infinite
      for statistics as they are.
    - `interval`: the time between two corrections of the camera, s; None if it is not known.
    """

    scales: Float[np.ndarray | Array, " channels"]
    lag_one_correlation: Float[np.ndarray | Array, " channels"]
    thresholds: Float[np.ndarray | Array, "4"]
    reset_score: Float[np.ndarray | Array, ""]
    interval: float | None = eqx.field(static=True, default=None)

    def init(self) -> InnovationState:
        """The state before the first sample."""
        channels = len(self.scales)
        none = jnp.zeros(channels)
        begin = Statistics(
            CumulativeSums.zero(channels), LikelihoodWindow.zero(channels), jnp.ones(channels), none
        )
        return InnovationState(begin, begin, jnp.full((), MIN_SECONDS_BETWEEN_MASKS), none, none)

    def step(
        self,
        state: InnovationState,
        sample: ObservedSample,
        dt: Float[Array, ""],
        settled: Bool[Array, ""],
    ) -> tuple[InnovationState, tuple[Evidence, Evidence, Evidence, Evidence]]:
        """The state after a sample, and what sum, ratio, joint ratio and energy say."""
        scaled = jnp.asarray(sample.whitened) / self.scales
        there = jnp.isfinite(jnp.asarray(sample.readings))
        was_held = state.since_held < MASK_SECONDS_AFTER_JUMP
        since_held = state.since_held + dt
        is_found = (state.statistics.sums.sums >= self._least).any()
        due = is_due(self.interval, jnp.asarray(sample.since_correction))
        begins = (
            (_jumped(scaled, there) | due) & (since_held >= MIN_SECONDS_BETWEEN_MASKS) & ~is_found
        )
        # The time counts from the last sample at which the camera was due.
        since_held = jnp.where(begins | (due & was_held), 0.0, since_held)
        is_held = since_held < MASK_SECONDS_AFTER_JUMP
        square = (state.late**2 / jnp.maximum(state.count, 1.0)).sum()
        read = jnp.maximum((state.count > 0).sum(), 1)
        lasts = square >= read + PERSISTENCE_SIGMAS * jnp.sqrt(2.0 * read)
        # Without a reading in the second half of the mask, the jump is assumed to last.
        lasts = lasts | (state.count.sum() == 0)
        ends = was_held & ~is_held & ~lasts
        now = _chosen(ends, state.before, state.statistics)
        before = _chosen(begins, now, state.before)
        is_late = is_held & (since_held >= MASK_SECONDS_AFTER_JUMP / 2) & there
        late = jnp.where(begins, 0.0, state.late + jnp.where(is_late, scaled.clip(-CLIP, CLIP), 0))
        count = jnp.where(begins, 0.0, state.count + is_late)
        now = self._after(now, sample, scaled, there & settled, dt)
        result = self._evidence(now, dt, settled & ~is_held)
        # The window of a change that is found begins again: it then shows whether it is over.
        reset_score = jnp.asarray(self.reset_score)
        is_full = (result[1].score >= reset_score) | (result[2].score >= reset_score).any()
        window = jax.tree.map(lambda leaf: jnp.where(is_full, 0.0, leaf), now.window)
        now = replace(now, window=window)
        return InnovationState(now, before, since_held, late, count), result

    @property
    def _least(self) -> Float[Array, ""]:
        """The sum of a change that is found; infinite for statistics as they are."""
        return jnp.where(
            jnp.isfinite(jnp.asarray(self.reset_score)), jnp.asarray(self.thresholds)[0], jnp.inf
        )

    def _after(
        self,
        old: Statistics,
        sample: ObservedSample,
        scaled: Float[Array, " channels"],
        used: Bool[Array, " channels"],
        dt: Float[Array, ""],
    ) -> Statistics:
        # Clipped before they are whitened in time: a large one is not spread over those after it.
        clipped = jnp.clip(scaled, -CLIP, CLIP)
        white = (clipped - self.lag_one_correlation * old.last) / jnp.sqrt(
            1 - self.lag_one_correlation**2
        )
        x = jnp.clip(white, -CLIP, CLIP)
        innovation = jnp.where(used, jnp.asarray(sample.readings) - sample.expected, 0.0)
        return replace(
            old,
            sums=old.sums.after(
                x,
                innovation,
                used,
                dt,
                jnp.asarray(self.reset_score) * jnp.asarray(self.thresholds)[0],
            ),
            window=old.window.after(x, innovation, used, dt),
            energy=energy_after(old.energy, x, used),
            last=jnp.where(used, clipped, old.last),
        )

    def _evidence(
        self, now: Statistics, dt: Float[Array, ""], speaks: Bool[Array, ""]
    ) -> tuple[Evidence, Evidence, Evidence, Evidence]:
        sums = now.sums
        of_way = partial(picked, row=jnp.argmax(sums.sums, axis=0))
        ratio, age, size = now.window.ratio()
        joint = tuple(jnp.reshape(value, 1) for value in joint_ratio(now.window))
        if len(self.scales) == 1:  # that of the channel says it all
            joint = tuple(value[:0] for value in joint)
        mean = of_way(sums.totals) / jnp.maximum(of_way(sums.counts), 1.0)
        # The energy has no memory of when it rose: it is as old as what it averages.
        averaged = jnp.full_like(now.energy, ENERGY_SAMPLES) * dt
        limits = jnp.asarray(self.thresholds)

        def evidence(limit: Array, score: Array, age: Array, size: Array) -> Evidence:
            return Evidence(jnp.where(speaks, score / limit, 0.0), age, size)

        return (
            evidence(limits[0], of_way(sums.sums), of_way(sums.ages), mean),
            evidence(limits[1], ratio, age, size),
            evidence(limits[2], *joint),
            evidence(limits[3], now.energy, averaged, jnp.sqrt(now.energy)),
        )


def _jumped(scaled: Float[Array, " channels"], there: Bool[Array, " channels"]) -> Bool[Array, ""]:
    """Whether several channels jump at once, as at a correction of a camera, which need not be the
    same for all of them: half of them by half of what one of them does."""
    sizes = jnp.where(there, jnp.abs(scaled), 0.0)
    return (sizes.max() > JUMP) & (2 * (sizes > JUMP / 2).sum() >= there.sum())


def _chosen(condition: Bool[Array, ""], yes: Statistics, no: Statistics) -> Statistics:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
