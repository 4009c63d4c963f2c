"""The box in which the optimiser's vector may lie, and the transform that removes its walls."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Vector = Float[np.ndarray | Array, "*descents unknowns"]

WALL = 1e-6
"""Of the range between two bounds: a start is moved this far inside, as the transform does not
move at a wall."""


@final
class SearchSpace(eqx.Module):
    """Bounds of the optimiser's vector, and how far its entries are expected to move.

    - `lower`, `upper`: bounds, infinite where there are none.
    - `scale`: one over how far each entry is expected to move; None where that is not known.
    """

    lower: Vector
    upper: Vector
    scale: Vector | None = None

    def clip(self, vector: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The nearest vector inside the bounds."""
        return jnp.clip(vector, self.lower, self.upper)

    def to_unbounded(
        self, vector: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, " unknowns"]:
        r"""The variables of an optimiser that knows no bounds.

        An entry between two bounds becomes the angle $z$ of MINUIT (James and Roos, Computer
        Physics Communications 10 (1975) 343-367),

        $$u = l + \frac{h - l}{2} (1 + \sin z),$$

        which reaches its bounds, as a logistic curve would not. Any other entry is only scaled, and
        cut off at its bound.
        """
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        walled = np.isfinite(lower) & np.isfinite(upper)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((vector - lower) / (upper - lower), WALL, 1 - WALL)
        angle = np.arcsin(2 * np.where(walled, share, 0.5) - 1)
        return np.where(walled, angle, vector * self._plain_scale())

    def from_unbounded(self, variables: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """The vector of such variables."""
        lower, upper = jnp.asarray(self.lower), jnp.asarray(self.upper)
        walled = jnp.isfinite(lower) & jnp.isfinite(upper)
        low, high = jnp.where(walled, lower, 0.0), jnp.where(walled, upper, 1.0)
        inside = low + (high - low) * 0.5 * (1 + jnp.sin(variables))
        return self.clip(jnp.where(walled, inside, variables / self._plain_scale()))

    def _plain_scale(self) -> Vector:
        return np.ones(np.shape(self.lower)) if self.scale is None else self.scale
