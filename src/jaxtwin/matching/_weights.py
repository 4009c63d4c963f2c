"""How much each sample of a recording counts, and which common errors of the camera it allows."""

from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..simulation import padded

Array_ = np.ndarray | Array


@final
class Weights(eqx.Module):
    r"""Weights of one recording, or of several with a leading axis.

    - `channel`: $\sqrt{w_{tc}} / \sigma_i$. `share`: $w_{tc} / \sum_c w_{tc}$.
    - `common_mode`: $\sqrt{w_t} / \sigma_m$.
    - `shapes`: $\Phi$ of the camera's common error; `solve`: the matrix that gives their sizes $b$
      for a common residual; `size_weight`: $1 / s_j$.
    """

    channel: Float[Array_, "*recordings times channels"]
    share: Float[Array_, "*recordings times channels"]
    common_mode: Float[Array_, "*recordings times"]
    shapes: Float[Array_, "*recordings times shapes"]
    solve: Float[Array_, "*recordings shapes times"]
    size_weight: Float[Array_, "*recordings shapes"]

    def padded(self) -> "Weights":
        """Those of one recording, and zeros for samples that fill up their number."""
        channel, share, common_mode, shapes = (
            padded(np.asarray(part), 0.0)
            for part in (self.channel, self.share, self.common_mode, self.shapes)
        )
        solve = padded(np.asarray(self.solve).T, 0.0).T
        return Weights(channel, share, common_mode, shapes, solve, self.size_weight)

    def split(
        self, difference: Float[Array, "times channels"]
    ) -> tuple[Float[Array, "times channels"], Float[Array, " times"], Float[Array, " shapes"]]:
        """Channels without the common mode, the common mode less the camera's error, and the sizes
        of that error's shapes, K."""
        shared = jnp.sum(self.share * difference, axis=1)
        sizes = jnp.asarray(self.solve) @ shared
        return difference - shared[:, None], shared - jnp.asarray(self.shapes) @ sizes, sizes

    def weigh(
        self,
        channel: Float[Array, "times channels"],
        common_mode: Float[Array, " times"],
        sizes: Float[Array, " shapes"],
    ) -> tuple[Float[Array, "times channels"], Float[Array, " times"], Float[Array, " shapes"]]:
        """The three of them as residuals."""
        return (
            jnp.asarray(self.channel) * channel,
            jnp.asarray(self.common_mode) * common_mode,
            jnp.asarray(self.size_weight) * sizes,
        )


def make_weights(
    samples: Float[np.ndarray, "times channels"],
    moments: Float[np.ndarray, " times"],
    channel: float,
    common_mode: float,
    shapes: Float[np.ndarray, "times shapes"],
    spreads: Float[np.ndarray, " shapes"],
) -> Weights:
    """The weights of one recording.

    **Arguments:**

    - `samples`: $w_{tc}$, 0 to 1. `moments`: factor on the common mode at each time, 0 to 1.
    - `channel`, `common_mode`: standard deviations of a channel without the common mode, and of the
      common mode times the root of the number of channels, K. Equal ones weigh all samples alike.
    - `shapes`, `spreads`: of the camera's common error.
    """
    total = samples.sum(axis=1, keepdims=True)
    share = np.divide(samples, total, out=np.zeros_like(samples), where=total > 0)
    weight = moments * total[:, 0] / common_mode**2
    weighted = shapes.T * weight
    normal = weighted @ shapes + np.diag(1 / spreads**2)
    return Weights(
        channel=np.sqrt(samples) / channel,
        share=share,
        common_mode=np.sqrt(weight),
        shapes=shapes,
        solve=np.linalg.solve(normal, weighted),
        size_weight=1 / spreads,
    )


def stacked(weights: Sequence[Weights]) -> Weights:
    """Several recordings' weights with a leading axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *weights)
