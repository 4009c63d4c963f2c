"""The bounds of the optimiser's vector, and the transform that removes them."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Vector = Float[np.ndarray | Array, "*descents unknowns"]

WALL = 1e-6
"""A start at a bound is moved inside by this part of the range, because the derivative of the
transform is 0 at a bound."""


@final
class SearchSpace(eqx.Module):
    """Bounds of the optimiser's vector, and the distances that its entries are expected to move.

    - `lower`, `upper`: bounds, infinite if there are none.
    - `scale`: the reciprocal of the distance that each entry is expected to move; None if that is
      not known.
    - `difference_steps`: the steps of central differences, for `BoundedLevenbergMarquardt`; None
      for exact derivatives. Differences take less time to compile.
    """

    lower: Vector
    upper: Vector
    scale: Vector | None = None
    difference_steps: Vector | None = None

    def clip(self, vector: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The nearest vector inside the bounds."""
        return jnp.clip(vector, self.lower, self.upper)

    def to_unbounded(
        self, vector: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, " unknowns"]:
        r"""Transforms a vector to the variables of an optimiser without bounds.

        An entry between two bounds becomes the angle $z$ of MINUIT (James and Roos, Computer
        Physics Communications 10 (1975) 343-367),

        $$u = l + \frac{h - l}{2} (1 + \sin z),$$

        which can reach its bounds, unlike a logistic curve. Any other entry is only scaled, and
        clipped at its bound.
        """
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        walled = np.isfinite(lower) & np.isfinite(upper)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((vector - lower) / (upper - lower), WALL, 1 - WALL)
        angle = np.arcsin(2 * np.where(walled, share, 0.5) - 1)
        return np.where(walled, angle, vector * self._plain_scale())

    def from_unbounded(self, variables: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The vector that belongs to such variables."""
        lower, upper = jnp.asarray(self.lower), jnp.asarray(self.upper)
        walled = jnp.isfinite(lower) & jnp.isfinite(upper)
        low, high = jnp.where(walled, lower, 0.0), jnp.where(walled, upper, 1.0)
        inside = low + (high - low) * 0.5 * (1 + jnp.sin(variables))
        return self.clip(jnp.where(walled, inside, variables / self._plain_scale()))

    def _plain_scale(self) -> Vector:
        return np.ones(np.shape(self.lower)) if self.scale is None else self.scale
