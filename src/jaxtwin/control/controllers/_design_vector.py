"""The vector of the weights of a design that an optimiser changes.

The numbers of a designed controller, such as the gains of an `LQI`, are smooth functions of its
weights: accepted deviations and noises. A search needs their derivatives at one design at a time.
They are central differences of the design, which is a matter of milliseconds; what follows from the
numbers, such as a closed loop, is then differentiated exactly along them.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, final

import jax
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


# The relative change of a weight. The truncation then leaves a relative error of 1e-8, and so does
# the rounding of the Riccati equation's solution.
RELATIVE_STEP = 1e-4


class ControllerNumbers(NamedTuple):
    """All numbers of a controller as a vector."""

    controller: AbstractController

    def apply(self, numbers: Float[Array | np.ndarray, " numbers"]) -> Any:
        """Returns the controller with other numbers."""
        leaves, tree = jax.tree.flatten(self.controller)
        shapes = [np.shape(leaf) if _is_number(leaf) else None for leaf in leaves]
        parts = iter(split(numbers, [shape for shape in shapes if shape is not None]))
        changed = [
            leaf if shape is None else next(parts)
            for leaf, shape in zip(leaves, shapes, strict=True)
        ]
        return jax.tree.unflatten(tree, changed)


class Neighbours(NamedTuple):
    """Designs beside another one, a pair for each entry of the vector: with a larger and with a
    smaller weight, and how far apart these are."""

    controllers: tuple[tuple[AbstractController, AbstractController], ...]
    apart: Float[np.ndarray, " parameters"]


@final
class DesignVector:
    """The map between a vector and some weights of a designed controller.

    **Arguments:**

    - `controller`: the controller that provides the other weights.
    - `names`: the weights in the vector, names of `AbstractController.design_weights`.

    **Raises:** `ControlError` for a name that is no weight of the design.
    """

    def __init__(self, where: str, controller: AbstractController, names: tuple[str, ...]):
        known = controller.design_weights()
        for name in names:
            if name not in known:
                raise ControlError(f"{where}: {unknown_name('weight', name, known)}")
        self.controller = controller
        self.shapes = tuple((name, np.shape(known[name])) for name in names)
        self._found: tuple[bytes, Neighbours] | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the entries."""
        return labels_of(self.shapes)

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """The weights of the controller as a vector."""
        known = self.controller.design_weights()
        return np.concatenate([np.ravel(known[name]) for name, _ in self.shapes]).astype(float)

    def with_controller(self, controller: AbstractController) -> "DesignVector":
        """The same vector of another controller."""
        return DesignVector("DesignVector", controller, tuple(name for name, _ in self.shapes))

    @property
    def numbers(self) -> ControllerNumbers:
        """The map from a line's numbers to the controller, without this vector's."""
        return ControllerNumbers(self.controller)

    def controller_at(self, values: Float[np.ndarray, " parameters"]) -> AbstractController:
        """Designs the controller with the weights of a vector."""
        parts = split(np.asarray(values, float), [shape for _, shape in self.shapes])
        names = (name for name, _ in self.shapes)
        return self.controller.redesigned(dict(zip(names, parts, strict=True)))

    def line(self, values: Float[np.ndarray, " parameters"]) -> Line:
        """The numbers of the design with the weights of a vector, and their derivatives."""
        beside = self.neighbours(values)
        change = [_numbers(more) - _numbers(less) for more, less in beside.controllers]
        slopes = np.stack(change) / beside.apart[:, None]
        return Line(_numbers(self.controller_at(values)), slopes)

    def neighbours(self, values: Float[np.ndarray, " parameters"]) -> Neighbours:
        """The designs beside that with the weights of a vector."""
        key = np.asarray(values, float).tobytes()
        if self._found is None or self._found[0] != key:
            steps = RELATIVE_STEP * np.diag(values)
            pairs = tuple(
                (self.controller_at(values + step), self.controller_at(values - step))
                for step in steps
            )
            self._found = key, Neighbours(pairs, 2 * RELATIVE_STEP * np.asarray(values, float))
        return self._found[1]


def _numbers(controller: AbstractController) -> Float[np.ndarray, " numbers"]:
    leaves = [leaf for leaf in jax.tree.leaves(controller) if _is_number(leaf)]
    return np.concatenate([np.ravel(np.asarray(leaf, float)) for leaf in leaves])


def _is_number(leaf: object) -> bool:
    return isinstance(leaf, np.ndarray | jax.Array) and leaf.dtype.kind == "f"
