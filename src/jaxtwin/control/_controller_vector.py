"""Some parameters of a controller in a row, as an optimiser has them."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from .._errors import ControlError
from ..rig._problems import unknown
from ._controller import AbstractController, parameter_names, with_parameters


class ControllerVector(NamedTuple):
    """Which parameters, in which shapes.

    - `controller`: whose other parameters hold.
    - `shapes`: name and shape of each parameter that may change.
    """

    controller: AbstractController
    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, where: str, controller: AbstractController, names: Iterable[str]) -> Any:
        """**Raises:** `ControlError` where there is no such parameter, or none at all."""
        known = parameter_names(controller)
        shapes = []
        for name in names:
            if name not in known:
                raise ControlError(f"{where}: {unknown('parameter', name, known)}")
            shapes.append((name, np.shape(getattr(controller, name))))
        if not shapes:
            raise ControlError(f"{where}: expected names of parameters, got none")
        return cls(controller, tuple(shapes))

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the entries: `Kp`, or `Kp[0]` and `Kp[1]` where each cell has its own."""
        return tuple(
            name if not shape else f"{name}[{', '.join(map(str, place))}]"
            for name, shape in self.shapes
            for place in np.ndindex(*shape)
        )

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """What they are."""
        parts = [np.ravel(np.asarray(getattr(self.controller, name))) for name, _ in self.shapes]
        return np.concatenate(parts).astype(float)

    def spread(self, of_names: dict[str, float]) -> Float[np.ndarray, " parameters"]:
        """A number for each name as one for each entry."""
        return np.concatenate(
            [np.full(int(np.prod(shape)), of_names[name]) for name, shape in self.shapes]
        )

    def apply(self, values: Float[Array | np.ndarray, " parameters"]) -> Any:
        """The controller with other values."""
        parts, begin = {}, 0
        for name, shape in self.shapes:
            end = begin + int(np.prod(shape))
            parts[name] = values[begin:end].reshape(shape)
            begin = end
        return with_parameters(self.controller, parts)
