"""The vector of a controller's parameters that an optimiser changes."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..._errors import ControlError
from ..._name_suggestions import unknown_name
from ._controller import AbstractController, parameter_names, with_values


class ControllerVector(NamedTuple):
    """The map between a vector and some parameters of a controller.

    - `controller`: the controller that provides the other parameters.
    - `shapes`: the name and the shape of each parameter in the vector.
    """

    controller: AbstractController
    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, where: str, controller: AbstractController, names: Iterable[str]) -> Any:
        """Makes the map for parameters by their names.

        **Raises:** `ControlError` for an unknown name, and for no name at all.
        """
        known = parameter_names(controller)
        shapes = []
        for name in names:
            if name not in known:
                raise ControlError(f"{where}: {unknown_name('parameter', name, known)}")
            shapes.append((name, np.shape(getattr(controller, name))))
        if not shapes:
            raise ControlError(f"{where}: expected names of parameters, got none")
        return cls(controller, tuple(shapes))

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the entries: `Kp`, or `Kp[0]` and `Kp[1]` if each cell has a value."""
        return tuple(
            name if not shape else f"{name}[{', '.join(map(str, place))}]"
            for name, shape in self.shapes
            for place in np.ndindex(*shape)
        )

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """The parameters of the controller as a vector."""
        parts = [np.ravel(np.asarray(getattr(self.controller, name))) for name, _ in self.shapes]
        return np.concatenate(parts).astype(float)

    def apply(self, values: Float[Array | np.ndarray, " parameters"]) -> Any:
        """Returns the controller with the parameters of a vector."""
        parts, begin = {}, 0
        for name, shape in self.shapes:
            end = begin + int(np.prod(shape))
            parts[name] = values[begin:end].reshape(shape)
            begin = end
        return with_values(self.controller, parts)
