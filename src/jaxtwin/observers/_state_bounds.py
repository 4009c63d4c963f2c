"""What a state of a rig cannot be: bounds of heats, the room and the temperatures of nodes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Array, Float

from .._arguments import of_kind
from .._celsius import ZERO_CELSIUS
from .._name_suggestions import unknown_name
from ..errors import ObserverError
from ._augmented_model import AugmentedModel

# The lowest and the highest value; None for any.
Bound = Sequence[float | int | None]


@final
@dataclass(frozen=True)
class StateBounds:
    """Bounds of what a `MovingHorizonEstimator` estimates. Each is a pair of the lowest and the
    highest value, of which one may be None.

    **Arguments:**

    - `room`: of the room, degC.
    - `heat`: of the heat into the node that each cell heats which the twin does not explain, W: a
      pair for all cells, or cell -> pair. `(0, None)` says that something may heat the plate, such
      as a hand, and that nothing cools it.
    - `nodes`: node -> pair, degC.
    """

    room: Bound | None = None
    heat: Bound | Mapping[str, Bound] | None = None
    nodes: Mapping[str, Bound] = field(default_factory=dict)


class BoundRows(NamedTuple):
    """Bounds of linear functions of the state.

    - `matrix`: the functions.
    - `lowest`, `highest`: their bounds; infinite for none.
    """

    matrix: Float[Array | np.ndarray, "bounds state"]
    lowest: Float[Array | np.ndarray, " bounds"]
    highest: Float[Array | np.ndarray, " bounds"]


def bound_rows(where: str, model: AugmentedModel, bounds: StateBounds | None) -> BoundRows:
    """Makes rows of bounds.

    **Raises:** `ObserverError` for something that is not bounds, an unknown cell or node, or a pair
    that is not a lowest value and a higher one.
    """
    if bounds is None:
        bounds = StateBounds()
    of_kind(f"{where}: bounds", bounds, StateBounds, "a StateBounds", ObserverError)
    layout, rig = model.layout, model.twin.rig
    unit = np.eye(layout.size)
    rows, pairs = [], []
    if bounds.room is not None:
        rows.append(unit[layout.of("room").start])
        pairs.append(_pair(f"{where}: bounds: room", bounds.room) - _zero(model))
    heats = bounds.heat
    if heats is not None and not isinstance(heats, Mapping):
        heats = dict.fromkeys(rig.driven, heats)
    for cell, pair in (heats or {}).items():
        place = _place(where, "cell", cell, rig.driven)
        rows.append(unit[layout.of("heats")][place])
        pairs.append(_pair(f"{where}: bounds: heat {cell}", pair))
    nodes = tuple(node.name for node in model.twin.netlist.nodes)
    shapes = np.asarray(model.shapes)
    for name, pair in bounds.nodes.items():
        place = _place(where, "node", name, nodes)
        rows.append(shapes[place] @ unit[layout.of("modes")])
        pairs.append(_pair(f"{where}: bounds: nodes {name}", pair) - _zero(model))
    matrix = np.array(rows).reshape(-1, layout.size)
    lowest, highest = np.array(pairs).reshape(-1, 2).T
    return BoundRows(matrix, lowest, highest)


def _zero(model: AugmentedModel) -> float:
    """The reference of the state, degC."""
    return float(model.stepper.reference) - ZERO_CELSIUS


def _place(where: str, kind: str, name: str, known: Sequence[str]) -> int:
    if name not in known:
        raise ObserverError(f"{where}: bounds: {unknown_name(kind, name, known)}")
    return list(known).index(name)


def _pair(where: str, pair: Any) -> Float[np.ndarray, " 2"]:
    expected = "expected the lowest and a higher value, or None for any"
    try:
        lowest, highest = pair
        low = -math.inf if lowest is None else float(lowest)
        high = math.inf if highest is None else float(highest)
    except (TypeError, ValueError):
        raise ObserverError(f"{where}: {expected}, got {pair!r}") from None
    if not low < high:  # also for a number that is none
        raise ObserverError(f"{where}: {expected}, got {pair!r}")
    return np.array([low, high])
