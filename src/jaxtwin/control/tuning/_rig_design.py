"""A design of a rig: gaps between faces, a plate whose faces may be anywhere, and the result."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import path_of
from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit
from ..._display import picture
from ..._jax_settings import own_settings
from ..._lapack import solve
from ..._result import AbstractResult, dataset, table
from ..._whole_file import check_ending, write_whole_file
from ...errors import ControlError
from ...physics import System, Twin, Wiring, all_values
from ...rig import Placement, Rig, build_rig, parse_toml, with_places
from ..linear._operating_point import OperatingPoint, slopes

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


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
        boxes = np.array([placement.box for placement in (*moving, *fixed)])
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


# The steady state of a plate whose cells and heaters may be anywhere on it, with its
# derivatives.
#
# The rig gets two parameters for the place of each cell that moves. The heat that flows into
# the nodes, $f(x, u, g)$, depends on the places $p$ only through the conductances $g$ of
# contacts and bare faces. At rest $f = 0$, and so
#
# $$\frac{dx}{dp} = -\left(\frac{\partial f}{\partial x}\right)^{-1}
# \frac{\partial f}{\partial g} \frac{dg}{dp}$$
#
# The area that a face and an element have in common is linear in x and in y until an edge of
# the face crosses a line of the grid. Its derivative is therefore the difference over a
# micrometre, without an error of truncation (of a turned face, of 1e-5 of it).

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

        def parts(numbers: Float[np.ndarray, "n *moves"]) -> _Moved:
            if numbers.ndim == 1:  # no place acts on it
                numbers = np.repeat(numbers[:, None], 1 + len(steps), axis=1)
            return _Moved(numbers[:, 0], (numbers[:, 1:] - numbers[:, :1]) / steps)

        # What follows from places is in the conductances, or above 0 inside the bounds.
        plain = {**fixed, **self._rig.nominal_inputs, **dict.fromkeys(wiring.on_plate, 1.0)}
        plain |= dict(zip(self._coordinates, places.tolist(), strict=True))
        radiating = wiring.radiating
        with own_settings():
            rest = _at_rest(
                wiring,
                {name: jnp.asarray(value) for name, value in plain.items()},
                parts(wiring.conductance_numbers(values)),
                None if radiating is None else parts(radiating.numbers(values)),
                jnp.asarray(unknowns[len(places) :]),
                jnp.asarray(self._nodes),
            )
            nodes, nodes_by, outputs, outputs_by, ambient = map(np.asarray, rest)
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
            table
            for table in (*data.get("cells", ()), *data.get("heaters", ()))
            if table["name"] == name
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


class PlacedCells(NamedTuple):
    """Cells and heaters at places on the plate, and how even it is with them.

    - `places`: name -> x and y of the middle of its face, from the left and from the top edge, m.
    - `twin`: the twin of this rig.
    - `point`: the most even steady state at the mean. If the cells cannot hold the mean, which may
      be so before the design, the nearest one.
    - `unevenness`: the objective in this state, K.
    """

    places: Mapping[str, tuple[float, float]]
    twin: Twin
    point: OperatingPoint
    unevenness: float


@final
@dataclass(frozen=True, repr=False, eq=False)
class RigDesign(AbstractResult):
    """The places of cells and heaters with which the plate of a rig is most even.

    **Arguments:**

    - `temperature`: the mean of all channels, degC.
    - `objective`: what was made small, `"range"` or `"standard deviation"`.
    - `before`, `after`: the cells and heaters that move, and further ones.
    - `optima`: the objective at the end of each search, K, the smallest first. Where several are
      equal, the design is hardly a local optimum.
    """

    temperature: float
    objective: str
    before: PlacedCells
    after: PlacedCells
    optima: tuple[float, ...]

    @property
    def twin(self) -> Twin:
        """The twin of the designed rig."""
        return self.after.twin

    @property
    def rig(self) -> Rig:
        """The designed rig."""
        return self.after.twin.rig

    @property
    def text(self) -> str:
        """The rig file: that of the rig before, with other places and further cells."""
        return self.rig.text

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the rig file, a .toml file that `jaxtwin.Twin` reads.

        **Returns:** the path.

        **Raises:** `ControlError` for another ending, or if it cannot be written.
        """
        check_ending(path, [".toml"], ControlError)
        write_whole_file(path, self.text.encode(), ControlError)
        return path_of("save: path", path, ControlError)

    def plot(self) -> "Figure":
        """Plots the plate before and after: `jaxtwin.plots.plot_rig_design`."""
        return picture("plot_rig_design", self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each cell or heater (its name is the index): x and y, m, and duty,
        before and after; NaN before for further cells."""
        columns = ("cell", "x before", "y before", "duty before", "x", "y", "duty")
        names = self.after.places
        rows = [(name, *_row(self.before, name), *_row(self.after, name)) for name in names]
        return table(rows, "cell", columns=columns)

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset of place (rig, cell, axis) and duty (rig, cell), NaN for cells that are further
        ones, and of the range of the plate (rig); `rig` is before or after."""
        names, both = self.after.places, (self.before, self.after)
        numbers = np.array([[_row(placed, name) for name in names] for placed in both])
        ranges = [placed.point.range for placed in both]
        return dataset(
            {
                "place": ("rig cell axis", numbers[..., :2], "m"),
                "duty": ("rig cell", numbers[..., 2], "1"),
                "plate_range": ("rig", ranges, "K"),
            },
            {"rig_name": self.rig.name, "objective": self.objective, "mean_degC": self.temperature},
            rig=["before", "after"],
            cell=list(names),
            axis=["x", "y"],
        )

    def __repr__(self) -> str:
        places = ", ".join(
            f"{name} at {100 * x:.2f} cm, {100 * y:.2f} cm"
            for name, (x, y) in self.after.places.items()
        )
        return (
            f"<RigDesign of {self.rig.name}: {self.objective} of the plate "
            f"{self.before.unevenness:.2f} -> {self.after.unevenness:.2f} K at a mean of "
            f"{self.temperature:g} degC; {places}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe()
        for place in ("x before", "y before", "x", "y"):
            rows[place] *= 100  # cm, as rig files state places
        return rows.rename(columns=lambda name: name if "duty" in name else f"{name}, cm")


def _row(placed: PlacedCells, name: str) -> tuple[float, float, float]:
    """x, y and duty of a cell; NaN if it is not there."""
    if name not in placed.places:
        return nan, nan, nan
    duty = dict(zip(placed.point.cell_names, placed.point.duty, strict=True))
    return (*placed.places[name], float(duty[name]))
