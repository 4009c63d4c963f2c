r"""The steady state of a plate whose cells and heaters may be anywhere on it, with its derivatives.

The rig gets two parameters for the place of each cell that moves. The heat that flows into the
nodes, $f(x, u, g)$, depends on the places $p$ only through the conductances $g$ of contacts and
bare faces. At rest $f = 0$, and so

$$\frac{dx}{dp} = -\left(\frac{\partial f}{\partial x}\right)^{-1}
\frac{\partial f}{\partial g} \frac{dg}{dp}$$

The area that a face and an element have in common is linear in x and in y until an edge of the face
crosses a line of the grid. Its derivative is therefore the difference over a micrometre, without an
error of truncation (of a turned face, of 1e-5 of it).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit
from ..._jax_settings import own_settings
from ..._lapack import solve
from ...physics import System, Twin
from ...physics._placed import all_values
from ...physics._wiring import Wiring
from ...rig import Rig
from ...rig._build import build_rig
from ...rig._toml import parse_toml
from ...rig._variants import with_places
from ..linear._operating_point import slopes

MICROMETRE = 1e-6

NEWTON_STEPS = 15

# The largest heat that may flow into a node at rest, W.
LEFT_OVER = 1e-9

# Left, right, top and bottom of the part of the plate on which a face may lie, m.
Bounds = tuple[float, float, float, float]


class PlateAtRest(NamedTuple):
    """A steady state, with its derivatives by the places, 1/m, and then by the duty.

    - `unknowns`: x and y of the middle of each face that moves, m, then the duty of all cells.
    - `elements`: the temperatures of the elements, degC, and `elements_by`, their derivatives.
    - `mean`: the mean of the channels, degC, and `mean_by`, its derivatives.
    - `nodes`, `outputs`: the temperatures of all nodes and the readings of all channels, degC.
    - `ambient`: the temperature of the surroundings, degC.
    """

    unknowns: Float[np.ndarray, " unknowns"]
    elements: Float[np.ndarray, " elements"]
    elements_by: Float[np.ndarray, "elements unknowns"]
    mean: float
    mean_by: Float[np.ndarray, " unknowns"]
    nodes: Float[np.ndarray, " nodes"]
    outputs: Float[np.ndarray, " channels"]
    ambient: float


class _Moved(NamedTuple):
    """Values for the places, and their derivatives by them, 1/m."""

    value: Float[Array | np.ndarray, " n"]
    by_place: Float[Array | np.ndarray, "n places"]


@final
class PlacedPlate:
    """A plate on which cells and heaters move.

    **Arguments:**

    - `twin`: the twin, with the values of its parameters. Its rig was read from a file.
    - `bounds`: name of each cell or heater that moves -> the part of the plate on which its face
      lies.
    """

    def __init__(self, twin: Twin, bounds: Mapping[str, Bounds]):
        rig, self._coordinates = _with_parameters(twin.rig, bounds)
        self._rig, self._wiring = rig, Twin(rig).wiring
        table = rig.parameters
        values = {name: twin.values.get(name, table[name].value) for name in table}
        self._values = {
            name: float(table[name].to_si(np.float64(value))) for name, value in values.items()
        }
        lowest = np.array([table[name].lower for name in self._coordinates])
        highest = np.array([table[name].upper for name in self._coordinates])
        self.lowest, self.highest = lowest, highest
        self._nodes = np.zeros(len(self._wiring.netlist.nodes))

    def at(self, unknowns: Float[np.ndarray, " unknowns"]) -> PlateAtRest:
        """Computes the steady state at these places under this duty."""
        wiring, places = self._wiring, unknowns[: len(self._coordinates)]
        # Towards the middle, so that no face leaves the plate.
        steps = np.where(places < (self.lowest + self.highest) / 2, MICROMETRE, -MICROMETRE)
        moved = places[:, None] + np.hstack([np.zeros((len(places), 1)), np.diag(steps)])
        fixed = {k: v for k, v in self._values.items() if k not in self._coordinates}
        values = all_values(self._rig, fixed | dict(zip(self._coordinates, moved, strict=True)))

        def parts(found: Float[np.ndarray, "n *moves"]) -> _Moved:
            if found.ndim == 1:  # no place acts on it
                found = np.repeat(found[:, None], 1 + len(steps), axis=1)
            return _Moved(found[:, 0], (found[:, 1:] - found[:, :1]) / steps)

        # What follows from places is in the conductances, or above 0 inside the bounds.
        plain = {**fixed, **self._rig.nominal_inputs, **dict.fromkeys(wiring.on_plate, 1.0)}
        plain |= dict(zip(self._coordinates, places.tolist(), strict=True))
        radiating = wiring.radiating
        with own_settings():
            found = _at_rest(
                wiring,
                {name: jnp.asarray(value) for name, value in plain.items()},
                parts(wiring.conductance_numbers(values)),
                None if radiating is None else parts(radiating.numbers(values)),
                jnp.asarray(unknowns[len(places) :]),
                jnp.asarray(self._nodes),
            )
            nodes, nodes_by, outputs, outputs_by, ambient = map(np.asarray, found)
        # The next places are near.
        self._nodes = nodes if np.isfinite(nodes).all() else np.zeros_like(nodes)
        celsius, elements = float(ambient), wiring.elements
        return PlateAtRest(
            unknowns,
            nodes[:elements] + celsius,
            nodes_by[:elements],
            float(outputs.mean()) + celsius,
            outputs_by.mean(axis=0),
            nodes + celsius,
            outputs + celsius,
            celsius,
        )


@persistent_jit
def _at_rest(
    wiring: Wiring,
    values_si: dict[str, Float[Array, ""]],
    conductances: _Moved,
    radiating: _Moved | None,
    duty: Float[Array, " cells"],
    start: Float[Array, " nodes"],
) -> tuple[Array, Array, Array, Array, Array]:
    """Computes the deviations of nodes and channels from the surroundings, each with its slopes
    by places and duty, and the temperature of the surroundings, degC."""

    def assembled(conductances: Array, radiating: Array | None) -> System:
        return System.assemble(wiring, values_si, conductances, radiating)

    def heat(conductances: Array, radiating: Array | None) -> Array:
        return assembled(conductances, radiating).heat_into_nodes(nodes, duty, reference)

    value = (
        jnp.asarray(conductances.value),
        None if radiating is None else jnp.asarray(radiating.value),
    )
    system = assembled(*value)
    reference = jnp.asarray(system.ambient_temperature)

    def is_open(state: tuple[Array, Array, Array]) -> Array:
        steps, _, left_over = state
        return (steps < NEWTON_STEPS) & ~(jnp.abs(left_over).max() < LEFT_OVER)

    def newton(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        steps, nodes, left_over = state
        by_nodes = jax.jacfwd(lambda x: system.heat_into_nodes(x, duty, reference))(nodes)
        nodes = nodes - solve(by_nodes, left_over)
        return steps + 1, nodes, system.heat_into_nodes(nodes, duty, reference)

    first = jnp.zeros((), int), start, system.heat_into_nodes(start, duty, reference)
    _, nodes, _ = jax.lax.while_loop(is_open, newton, first)
    by_nodes, by_duty = slopes(system, nodes, duty, reference)
    change = conductances.by_place.T, None if radiating is None else radiating.by_place.T
    by_place = jax.vmap(lambda *moved: jax.jvp(heat, value, moved)[1], out_axes=1)(*change)
    nodes_by = solve(-by_nodes, jnp.concatenate([by_place, by_duty], axis=1))
    read, read_by = jax.vmap(
        lambda moved: jax.jvp(system.channel_temperatures, (nodes,), (moved,)),
        in_axes=1,
        out_axes=(None, 1),
    )(nodes_by)
    return nodes, nodes_by, read, read_by, reference - ZERO_CELSIUS


def _with_parameters(rig: Rig, bounds: Mapping[str, Bounds]) -> tuple[Rig, tuple[str, ...]]:
    """The rig with parameters for the places of the cells and heaters that move, and their names: x
    and y of each."""
    # Places that are parameters become numbers first, because no parameter may be without use.
    middle = (rig.plate.width / 2, rig.plate.height / 2)
    text = with_places(rig, dict.fromkeys(bounds, middle), {}).text
    data: dict[str, Any] = parse_toml(text.encode(), rig.source)
    parameters = data.setdefault("parameters", {})
    boxes = {placement.name: placement.box for placement in rig.placements}
    names: list[str] = []
    for number, (name, (left, right, top, bottom)) in enumerate(bounds.items(), 1):
        width, height = boxes[name]
        table = next(
            one for one in (*data.get("cells", ()), *data.get("heaters", ())) if one["name"] == name
        )
        table["at"] = []
        for axis, (low, high), side in (
            ("x", (left, right), width),
            ("y", (top, bottom), height),
        ):
            parameter = f"{axis}_of_place_{number}"
            low, high = low + side / 2, high - side / 2
            parameters[parameter] = {"value": (low + high) / 2, "unit": "m", "bounds": [low, high]}
            table["at"].append(parameter)
            names.append(parameter)
    return build_rig(data, rig.source), tuple(names)
