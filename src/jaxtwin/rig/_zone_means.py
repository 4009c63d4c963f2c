"""Means of the plate's temperature over zones.

Between the centres of the elements the temperature is interpolated linearly in each direction;
beyond the outermost centres it is constant, because little heat leaves through the edge of the
plate.
The mean over a zone is the integral of this temperature. It has a continuous derivative as the zone
moves over the plate. With temperatures that are constant in each element, the cost of a match would
have a kink, and often a local minimum, wherever an edge of a zone meets one of an element.

Across the outline of the plate the temperature steps to that of the surroundings. A camera's
picture spreads this step over a width (its blur), so that the mean has a continuous derivative
there as well.
"""

import numpy as np
from jaxtyping import Array, Float


def mean_weights(
    edges: Float[np.ndarray, " edges"],
    low: Float[np.ndarray | Array, "*zones"],
    high: Float[np.ndarray | Array, "*zones"],
    blur: Float[Array, ""] | None = None,
) -> Float[np.ndarray | Array, "*zones elements"]:
    """The weight of each element of one axis in the means over the ranges from low to high.

    The weights of a range on the plate sum to 1. A part of the range beyond the plate counts as a
    temperature of 0. With a blur, every place counts as the plain mean of the temperature over a
    width of this size about it, which lowers the sum of a range that ends near the outline.

    **Arguments:**

    - `edges`: the edges of the elements along the axis, ascending, m.
    - `low`, `high`: the ranges, m; NumPy arrays, or JAX arrays under a transformation.
    - `blur`: the width, m, None for none. It acts only on the step at the outline; elsewhere the
      temperature is nearly linear over a pixel, and a mean does not change it.
    """
    xp = low.__array_namespace__()  # numpy, or jax.numpy
    if blur is None:
        first, last = (xp.clip(x, edges[0], edges[-1])[..., None] for x in (low, high))
    else:
        first, last = (_mean_place(edges, x, blur)[..., None] for x in (low, high))
    # Nothing is joined or cut out here: of many draws, XLA:CPU takes five times as long for that.
    knots = np.concatenate([edges[:1], (edges[:-1] + edges[1:]) / 2, edges[-1:]])
    before, behind = np.diff(knots)[:-1], np.diff(knots)[1:]
    is_first, is_last = np.eye(len(before))[[0, -1]]

    def up_to(place: Float[np.ndarray | Array, "*zones 1"]) -> Float[np.ndarray | Array, "..."]:
        """The integral of each element's share, which rises from 0 to 1 before its centre and falls
        behind it, and is 1 between the outermost centres and the edges of the plate."""
        rising = xp.clip((place - knots[:-2]) / before, 0.0, 1.0)
        falling = xp.clip((place - knots[1:-1]) / behind, 0.0, 1.0)
        risen = before * rising * (is_first + (1 - is_first) * rising / 2)
        return risen + behind * falling * (1 - (1 - is_last) * falling / 2)

    return (up_to(last) - up_to(first)) / (high - low)[..., None]


def point_weights(
    edges: Float[np.ndarray, " edges"], place: float
) -> Float[np.ndarray, " elements"]:
    """The weight of each element of one axis in the temperature at a point: the limit of a range
    that shrinks to it. They sum to 1.

    **Arguments:**

    - `edges`: the edges of the elements along the axis, ascending, m.
    - `place`: the point, m.
    """
    centres = (edges[:-1] + edges[1:]) / 2
    return np.array([np.interp(place, centres, unit) for unit in np.eye(len(centres))])


def _mean_place(
    edges: Float[np.ndarray, " edges"],
    place: Float[np.ndarray | Array, "*zones"],
    blur: Float[Array, ""],
) -> Float[np.ndarray | Array, "*zones"]:
    """The mean, over the width of the blur about a place, of the nearest place on the plate."""
    xp = place.__array_namespace__()

    def mean_excess(
        distance: Float[np.ndarray | Array, "*zones"],
    ) -> Float[np.ndarray | Array, "*zones"]:
        """The mean of max(distance, 0): a parabola across the blur, then a straight line."""
        inside = xp.clip(distance, -blur / 2, blur / 2)
        return (inside + blur / 2) ** 2 / (2 * blur) + xp.maximum(distance - blur / 2, 0.0)

    return edges[0] + mean_excess(place - edges[0]) - mean_excess(place - edges[-1])
