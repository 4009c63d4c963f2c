"""Recursive statistics of standardised innovations: cumulative sums, likelihood ratio, energy.

All take one sample of all channels at once, hold arrays of static shapes, and leave the statistic
of a channel without a reading as it was. Innovations are clipped before: a single one, however
large, moves no statistic over its threshold. Corrections of a camera and outliers are single.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

# What the cumulative sums subtract from each innovation: half of a shift of one standard deviation
# (Page 1954).
REFERENCE = 0.5

# The longest window of the likelihood ratio, samples (Lai 1995).
WINDOW_SAMPLES = 128

# The number of samples that the energy averages.
ENERGY_SAMPLES = 32.0


class CumulativeSums(NamedTuple):
    """Page's two sums, each with what has come since it was last zero.

    - `sums`: upwards and downwards. `ages`: the time since each was zero, s.
    - `totals`, `counts`: the sum of the innovations since then, K, and their number.
    """

    sums: Float[Array, "2 channels"]
    ages: Float[Array, "2 channels"]
    totals: Float[Array, "2 channels"]
    counts: Float[Array, "2 channels"]

    @classmethod
    def zero(cls, channels: int) -> "CumulativeSums":
        """The sums of channels of which nothing was read."""
        none = jnp.zeros((2, channels))
        return cls(none, none, none, none)

    def after(
        self,
        x: Float[Array, " channels"],
        innovation: Float[Array, " channels"],
        used: Bool[Array, " channels"],
        dt: Float[Array, ""],
        ceiling: Float[Array, ""],
    ) -> "CumulativeSums":
        """The sums after a sample.

        **Arguments:**

        - `x`: the clipped standardised innovations. `innovation`: the same in K.
        - `used`: which of them were read.
        - `dt`: the time since the sample before, s.
        - `ceiling`: the largest sum; a change that is over is then soon forgotten.
        """
        signed = jnp.stack([x, -x])
        sums = jnp.where(used, jnp.clip(self.sums + signed - REFERENCE, 0.0, ceiling), self.sums)
        there = sums > 0
        return CumulativeSums(
            sums,
            jnp.where(there, self.ages + dt, 0.0),
            jnp.where(there, self.totals + jnp.where(used, innovation, 0.0), 0.0),
            jnp.where(there, self.counts + used, 0.0),
        )


class LikelihoodWindow(NamedTuple):
    """The sums of the last 1, 2, ... innovations of each channel, and the time that each took, s.

    - `sums`: of the clipped standardised innovations. `totals`: of the innovations, K.
    """

    sums: Float[Array, "window channels"]
    totals: Float[Array, "window channels"]
    ages: Float[Array, "window channels"]

    @classmethod
    def zero(cls, channels: int) -> "LikelihoodWindow":
        """The window of channels of which nothing was read."""
        none = jnp.zeros((WINDOW_SAMPLES, channels))
        return cls(none, none, none)

    def after(
        self,
        x: Float[Array, " channels"],
        innovation: Float[Array, " channels"],
        used: Bool[Array, " channels"],
        dt: Float[Array, ""],
    ) -> "LikelihoodWindow":
        """The window after a sample, as for `CumulativeSums.after`."""

        def shifted(old: Array) -> Array:
            return jnp.where(used, jnp.concatenate([jnp.zeros_like(old[:1]), old[:-1]]), old)

        return LikelihoodWindow(
            shifted(self.sums) + jnp.where(used, x, 0.0),
            shifted(self.totals) + jnp.where(used, innovation, 0.0),
            shifted(self.ages) + dt,  # which goes on without a reading, too
        )

    def ratio(
        self,
    ) -> tuple[Float[Array, " channels"], Float[Array, " channels"], Float[Array, " channels"]]:
        """The logarithm of the generalised likelihood ratio of a shift of the mean against none,
        the time since its most likely onset, s, and its most likely size, K."""
        counts = jnp.arange(1, WINDOW_SAMPLES + 1)[:, None]
        ratios = self.sums**2 / (2 * counts)
        best = jnp.argmax(ratios, axis=0)
        tables = ratios, self.ages, self.totals / counts
        ratio, age, size = (picked(table, best) for table in tables)
        return ratio, age, size


def picked(
    table: Float[Array, "rows channels"], row: Int[Array, " channels"]
) -> Float[Array, " channels"]:
    """The entry of a table in one row for each channel."""
    return jnp.take_along_axis(table, row[None], axis=0)[0]


def energy_after(
    energy: Float[Array, " channels"],
    x: Float[Array, " channels"],
    used: Bool[Array, " channels"],
) -> Float[Array, " channels"]:
    """The mean square of about the last `ENERGY_SAMPLES` innovations after one more."""
    return jnp.where(used, energy + (x**2 - energy) / ENERGY_SAMPLES, energy)


def joint_ratio(
    window: LikelihoodWindow,
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """The same for a shift of all channels together, each by an amount of its own: the size is the
    root mean square over the channels.

    Twice the ratio has as many degrees of freedom as there are channels. It is moved to what one
    channel would have to show to be as unlikely (Wilson and Hilferty 1931), so that the threshold
    does not depend on their number.
    """
    counts = jnp.arange(1, WINDOW_SAMPLES + 1)[:, None]
    channels = window.sums.shape[1]
    squares = (window.sums**2 / counts).sum(axis=1)
    part = 2 / (9 * channels)
    normal = ((squares / channels) ** (1 / 3) - (1 - part)) / jnp.sqrt(part)
    best = jnp.argmax(normal)
    ratio = jnp.maximum(normal[best], 0.0) ** 2 / 2
    means = window.totals[best] / (best + 1)
    return ratio, window.ages[best].max(), jnp.sqrt(jnp.mean(means**2))
