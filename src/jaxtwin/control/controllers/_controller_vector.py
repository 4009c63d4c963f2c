"""The vector of a controller's parameters that an optimiser changes."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ._controller import AbstractController, parameter_names, with_values


class Line(NamedTuple):
    """The numbers of a controller, and how they change with the parameters of a vector.

    - `numbers`: those from which the `numbers` of the vector make the controller.
    - `slopes`: their derivatives.
    """

    numbers: Float[np.ndarray, " numbers"]
    slopes: Float[np.ndarray, "parameters numbers"]


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
        return labels_of(self.shapes)

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """The parameters of the controller as a vector."""
        parts = [np.ravel(np.asarray(getattr(self.controller, name))) for name, _ in self.shapes]
        return np.concatenate(parts).astype(float)

    def apply(self, values: Float[Array | np.ndarray, " parameters"]) -> Any:
        """Returns the controller with the parameters of a vector."""
        parts = split(values, [shape for _, shape in self.shapes])
        names = (name for name, _ in self.shapes)
        return with_values(self.controller, dict(zip(names, parts, strict=True)))

    def with_controller(self, controller: AbstractController) -> "ControllerVector":
        """The same vector of another controller."""
        return self._replace(controller=controller)

    @property
    def numbers(self) -> "ControllerVector":
        """The map from a line's numbers to the controller: its parameters are these numbers."""
        return self

    def controller_at(self, values: Float[np.ndarray, " parameters"]) -> AbstractController:
        """Returns the controller with the parameters of a vector."""
        return self.apply(values)

    def line(self, values: Float[np.ndarray, " parameters"]) -> Line:
        """Returns the parameters, and their derivatives with respect to themselves."""
        return Line(np.asarray(values, float), np.eye(len(values)))


def labels_of(shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> tuple[str, ...]:
    """The labels of the entries of a vector: `Kp`, or `Kp[0]` and `Kp[1]` for an array."""
    return tuple(
        name if not shape else f"{name}[{', '.join(map(str, place))}]"
        for name, shape in shapes
        for place in np.ndindex(*shape)
    )


def split(vector: Any, shapes: Sequence[tuple[int, ...]]) -> list[Any]:
    """Returns the arrays that lie one after the other in a vector."""
    parts, begin = [], 0
    for shape in shapes:
        end = begin + int(np.prod(shape))
        parts.append(vector[begin:end].reshape(shape))
        begin = end
    return parts
