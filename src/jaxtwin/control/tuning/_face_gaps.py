"""The gaps between rectangular faces on a plate, and random places without overlap."""

from collections.abc import Sequence
from typing import final

import numpy as np
from jaxtyping import Float

from ...rig import Placement

# Random places that are tried for all faces together.
TRIES = 2000

# x and y of the middle of each face, m.
Places = Float[np.ndarray, "faces 2"]


@final
class FaceGaps:
    """The gaps between each two faces of which at least one moves.

    A turned face counts as the rectangle along the edges of the plate that it lies in.

    **Arguments:**

    - `moving`: the faces that move. `fixed`: the others, at their places.
    - `fixed_places`: x and y of the middle of each of those, m.
    - `clearance`: the smallest gap, m.
    """

    def __init__(
        self,
        moving: Sequence[Placement],
        fixed: Sequence[Placement],
        fixed_places: Places,
        clearance: float,
    ):
        self._fixed = fixed_places.reshape(-1, 2)
        boxes = np.array([one.box for one in (*moving, *fixed)])
        first, second = np.triu_indices(len(boxes), 1)
        does_move = first < len(moving)
        self._pairs = first[does_move], second[does_move]
        self._moving = len(moving)
        self._least = (boxes[self._pairs[0]] + boxes[self._pairs[1]]) / 2 + clearance

    def smallest(self, places: Places) -> float:
        """Computes the smallest gap less the clearance, m; below 0 for faces that are too near."""
        gaps = self._along_axes(places)[1].max(axis=1)
        return float(gaps.min(initial=np.inf))

    def linear(
        self, places: Places
    ) -> tuple[Float[np.ndarray, "pairs places"], Float[np.ndarray, " pairs"]]:
        """Linear inequalities `rows @ change <= room` for a change of the places after which no
        faces are too near: each two stay apart along the axis along which they are farther
        apart."""
        between, gaps = self._along_axes(places)
        pairs = np.arange(len(gaps))
        axis = gaps.argmax(axis=1)
        sign = np.where(between[pairs, axis] < 0, -1.0, 1.0)
        rows = np.zeros((len(gaps), self._moving + len(self._fixed), 2))
        first, second = self._pairs
        rows[pairs, first, axis] = sign
        rows[pairs, second, axis] = -sign
        rows = rows[:, : self._moving].reshape(len(gaps), 2 * self._moving)
        return rows, gaps[pairs, axis]

    def random(
        self,
        lowest: Places,
        highest: Places,
        held: Float[np.ndarray, "held 2"],
        random: np.random.Generator,
    ) -> Places | None:
        """Draws places that are not too near, with the first ones held; None if none are found."""
        for _ in range(TRIES):
            places = random.uniform(lowest, highest)
            places[: len(held)] = held
            if self.smallest(places) >= 0:
                return places
        return None

    def _along_axes(
        self, places: Places
    ) -> tuple[Float[np.ndarray, "pairs 2"], Float[np.ndarray, "pairs 2"]]:
        """From the first to the second of each pair along both axes, and the gaps, m."""
        everything = np.concatenate([places, self._fixed])
        between = everything[self._pairs[1]] - everything[self._pairs[0]]
        return between, np.abs(between) - self._least
