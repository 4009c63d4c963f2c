r"""Places of cells and heaters for the most even plate at a mean temperature.

Places and duty are found together, by steps in the linearised steady state (`PlacedPlate`) that
are best within a trust region (`_evenness_step`), with faces within their bounds and apart
(`_rig_design`). Such a search finds a local optimum, so that several begin at different places.
"""

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any, final

import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number, mapping_of, names_of, whole_number
from ..._name_suggestions import unknown_name
from ..._progress import advanced, announced
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...rig import Place, Placement, Rig, check_has_plate, with_places
from ..controllers._duty_limits import bounds_of, checked_limits
from ..linear._operating_point import OperatingPoint
from ._most_even_point import (
    AbstractUnevenness,
    LinearPlate,
    PlateDeviation,
    PlateRange,
    Region,
)
from ._rig_design import Bounds, FaceGaps, PlacedCells, PlacedPlate, Places, PlateAtRest, RigDesign

WHERE = "design_rig"

# A mean counts as reached within this distance, K.
MEAN_TOLERANCE = 0.01

FIRST_MOVE, LONGEST_MOVE, SHORTEST_MOVE = 0.02, 0.04, 1e-4
"""The largest change of a place in a step: in the first, at most, and at the end of a search, m."""

# The largest change of a duty in a step, relative to that of a place, 1/m.
DUTY_OF_MOVE = 10.0

# The decrease of the cost at which a search ends, K.
COST_TOLERANCE = 1e-4

STEPS = 60

# Of the places that are found, m: a tenth of a millimetre.
DECIMALS = 4


@announced("design of a rig")
def design_rig(
    twin: Twin | Fit,
    temperature: float | int,
    *,
    objective: str = "range",
    moving: Sequence[str] | None = None,
    further_cells: int = 0,
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    clearance: float | int = 0.0,
    limits: Sequence[float | int] = (-1.0, 1.0),
    starts: int = 4,
    seed: int = 0,
) -> RigDesign:
    """Finds the places of cells and heaters with which the plate is most even.

    ```python
    design = jt.design_rig(twin, 40, limits=(0, 1))
    design.before.point.range, design.after.point.range  # K
    design.save("better.toml")
    jt.design_rig(twin, 40, further_cells=1, limits=(0, 1))  # what would a third cell give?
    ```

    The plate is at rest under the most even duty, as in `most_even_point`. Cells keep their contact
    resistance wherever they lie. Only cells and heaters can move whose place is in the rig file
    (`at` and `size`).

    **Arguments:**

    - `twin`: the twin of a rig that was read from a file; or a fit (`Fit.mean_twin`).
    - `temperature`: the mean of all channels, degC.
    - `objective`: `"range"`, the difference between the hottest and the coldest element of the
      plate; or `"standard deviation"`, that of the elements, weighted by their areas.
    - `moving`: the names of the cells and heaters that move; None for all that can.
    - `further_cells`: the number of copies of the first cell with a place that are added; with
      `moving=[]` the others stay where they are.
    - `bounds`: name -> left, right, top and bottom of the part of the plate on which its face lies,
      m; the whole plate for those that are not named. A further cell has the name of the cell that
      it is a copy of, with the next free number.
    - `clearance`: the smallest gap between two faces, m.
    - `limits`: lowest and highest duty.
    - `starts`: the number of searches. The first begins at the present places, the others at random
      ones, which `seed` determines.

    **Raises:** `ControlError` if the arguments do not fit the rig or each other, there is no room
    for the cells, or none of the places that were found holds the mean; `RigError` for a rig that
    was not read from a file.
    """
    plant = nominal_twin(f"{WHERE}: twin", twin, ControlError)
    check_has_plate(WHERE, plant.rig, ControlError)
    mean = finite_number(f"{WHERE}: temperature", temperature, ControlError)
    unevenness = _unevenness(plant.rig, objective)
    names = _moving(plant.rig, moving)
    copies = _copies(plant.rig, names, further_cells)
    apart = finite_number(f"{WHERE}: clearance", clearance, ControlError, least=0, unit="m")
    searches = whole_number(f"{WHERE}: starts", starts, 1, ControlError)
    random = np.random.default_rng(whole_number(f"{WHERE}: seed", seed, 0, ControlError))
    low, high = bounds_of(checked_limits(WHERE, limits))
    if low.ndim or high.ndim:
        raise ControlError(
            f"{WHERE}: limits: expected two numbers, which hold for cells that are added too, got "
            f"{limits!r}"
        )

    def search(
        twin: Twin, names: Sequence[str], bounds: Mapping[str, Any] | None
    ) -> "_PlacementSearch":
        lowest = np.maximum(low, twin.wiring.lowest_duty)
        duty = lowest, np.full_like(lowest, high)
        return _PlacementSearch(
            twin, _bounds(twin.rig, names, bounds), apart, unevenness, mean, duty
        )

    now = np.array([_place(plant, name) for name in names]).reshape(-1, 2)
    grown = _moved(plant, dict.fromkeys(copies, _middle(plant.rig)), copies)
    wider = search(grown, (*names, *copies), bounds)
    before = search(plant, names, None).best_duty(now)
    result: list[PlateAtRest] = []
    for number in range(searches):
        start = wider.places_near(now if number == 0 else now[:0], random)
        if start is not None:
            result.append(wider.optimum(start))
            advanced(number + 1, searches, f"{min(map(wider.cost, result)):.3g} K")
    if not result:
        raise ControlError(
            f"{WHERE}: expected room on the plate for {len(names) + len(copies)} faces that do not "
            "overlap, found none; use fewer cells, wider bounds or a smaller clearance"
        )
    # Of equal optima the first one, so that cells do not swap their places.
    nearest = min(result, key=lambda at: round(wider.cost(at), 3))
    best = wider.best_duty(wider.rounded(wider.places(nearest)))
    if abs(best.mean - mean) > MEAN_TOLERANCE:
        raise ControlError(
            f"{WHERE}: temperature: expected a mean that duty cycles from {low:g} to {high:g} "
            f"reach, got {mean:g} degC; the nearest found was {best.mean:.4g} degC"
        )

    def placed(twin: Twin, at: PlateAtRest, names: Sequence[str], places: Places) -> PlacedCells:
        point = _point(twin, at)
        return PlacedCells(_named(names, places), twin, point, unevenness.value(at.elements))

    places = wider.places(best)
    designed = _moved(plant, _named((*names, *copies), places), copies)
    return RigDesign(
        mean,
        objective,
        placed(plant, before, names, now),
        placed(designed, best, (*names, *copies), places),
        tuple(sorted(map(wider.cost, result))),
    )


@final
class _PlacementSearch:
    """Searches for places and duty.

    **Arguments:**

    - `bounds`: name of each cell or heater that moves -> the part of the plate where its face lies.
    - `clearance`: the smallest gap between two faces, m.
    - `unevenness`: what is to be small. `mean`: the mean of the channels, degC.
    - `duty`: lowest and highest duty of each cell.
    """

    def __init__(
        self,
        twin: Twin,
        bounds: Mapping[str, Bounds],
        clearance: float,
        unevenness: AbstractUnevenness,
        mean: float,
        duty: tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]],
    ):
        self._plate = PlacedPlate(twin, bounds)
        self._unevenness, self._mean = unevenness, mean
        self._lowest = np.concatenate([self._plate.lowest, duty[0]])
        self._highest = np.concatenate([self._plate.highest, duty[1]])
        self._count = len(bounds)
        placements = {placement.name: placement for placement in twin.rig.placements}
        fixed = [placement for placement in twin.rig.placements if placement.name not in bounds]
        self._gaps = FaceGaps(
            [placements[name] for name in bounds],
            fixed,
            np.array([_place(twin, placement.name) for placement in fixed]).reshape(-1, 2),
            clearance,
        )

    def places(self, at: PlateAtRest) -> Places:
        """Returns the places of a state."""
        return at.unknowns[: 2 * self._count].reshape(-1, 2)

    def cost(self, at: PlateAtRest) -> float:
        """Computes the unevenness with the error of the mean in it, K."""
        return self._unevenness.cost(self._linear(at))

    def places_near(
        self, held: Float[np.ndarray, "held 2"], random: np.random.Generator
    ) -> Places | None:
        """Draws places without overlap, of which the first are held; None if none are found."""
        lowest, highest = (
            corner.reshape(-1, 2) for corner in (self._plate.lowest, self._plate.highest)
        )
        held = np.clip(held, lowest[: len(held)], highest[: len(held)])
        return self._gaps.random(lowest, highest, held, random)

    def rounded(self, places: Places) -> Places:
        """Rounds places within their bounds."""
        rounded = places.round(DECIMALS).ravel()
        return np.clip(rounded, self._plate.lowest, self._plate.highest).reshape(-1, 2)

    def best_duty(self, places: Places) -> PlateAtRest:
        """Finds the best duty for places that do not move."""
        return self._descended(self._start(places), 0.0)

    def optimum(self, places: Places) -> PlateAtRest:
        """Finds places and duty, from given places on."""
        return self._descended(self._start(places), FIRST_MOVE)

    def _start(self, places: Places) -> PlateAtRest:
        """The places under equal duty cycles that bring the mean near to what it should be."""
        middle = (self._lowest + self._highest) / 2
        at = self._plate.at(np.concatenate([places.ravel(), middle[2 * self._count :]]))
        for _ in range(3):
            at = self._with_mean(at)
        return at

    def _with_mean(self, at: PlateAtRest) -> PlateAtRest:
        """The state with the duty of all cells changed alike, so that the mean is nearer to what it
        should be. Without it, the curved way along which the mean is held would allow small steps
        only."""
        if abs(at.mean - self._mean) < MEAN_TOLERANCE / 2:
            return at
        cells = slice(2 * self._count, None)
        unknowns = at.unknowns.copy()
        unknowns[cells] += (self._mean - at.mean) / at.mean_by[cells].sum()
        return self._plate.at(np.clip(unknowns, self._lowest, self._highest))

    def _descended(self, at: PlateAtRest, reach: float) -> PlateAtRest:
        """The end of a descent whose first step moves places by up to `reach`; 0 for the duty
        alone."""
        places = np.arange(len(at.unknowns)) < 2 * self._count
        does_move = reach > 0
        reach = FIRST_MOVE
        for _ in range(STEPS):
            width = np.where(places, reach if does_move else 0.0, DUTY_OF_MOVE * reach)
            step = self._unevenness.step(self._linear(at), self._region(at, width))
            if step is None:
                break
            moved = np.clip(at.unknowns + step, self._lowest, self._highest)
            result = self._with_mean(self._plate.at(moved))
            decrease = self.cost(at) - self.cost(result)
            if decrease > 0:
                at, reach = result, min(2 * reach, LONGEST_MOVE)
            else:
                reach /= 3
            if reach < SHORTEST_MOVE or 0 <= decrease < COST_TOLERANCE:
                break
        return at

    def _region(self, at: PlateAtRest, width: Float[np.ndarray, " unknowns"]) -> Region:
        rows, room = self._gaps.linear(self.places(at))
        cells = len(at.unknowns) - rows.shape[1]
        return Region(
            np.maximum(self._lowest - at.unknowns, -width),
            np.minimum(self._highest - at.unknowns, width),
            np.hstack([rows, np.zeros((len(rows), cells))]),
            np.maximum(room, 0.0),
        )

    def _linear(self, at: PlateAtRest) -> LinearPlate:
        return LinearPlate(at.elements, at.elements_by, at.mean - self._mean, at.mean_by)


def _unevenness(rig: Rig, objective: str) -> AbstractUnevenness:
    if objective == PlateRange.name:
        return PlateRange()
    if objective == PlateDeviation.name:
        areas = np.array([rig.plate.area(name) for name in rig.plate.element_names])
        return PlateDeviation(areas / areas.sum())
    raise ControlError(
        f"{WHERE}: objective: expected {PlateRange.name!r} or {PlateDeviation.name!r}, got "
        f"{objective!r}"
    )


def _moving(rig: Rig, moving: Sequence[str] | None) -> tuple[str, ...]:
    """The cells and heaters that move.

    **Raises:** `ControlError` for names that the rig does not have, or parts without a place.
    """
    known = tuple(placement.name for placement in rig.placements)
    if not known:
        raise ControlError(
            f"{WHERE}: twin: expected a rig whose cells or heaters have a place (at and size), "
            f"which can move, got {rig.name}, whose cells list their contacts"
        )
    if moving is None:
        return known
    names = names_of(f"{WHERE}: moving", moving, ControlError)
    for name in names:
        if name not in known:
            what = "cell or heater with a place"
            raise ControlError(f"{WHERE}: moving: {unknown_name(what, name, known)}")
    return names


def _copies(rig: Rig, names: Sequence[str], further_cells: int) -> dict[str, str]:
    """The names of further cells -> the cell that each is a copy of."""
    number = whole_number(f"{WHERE}: further_cells", further_cells, 0, ControlError)
    if not names and not number:
        raise ControlError(f"{WHERE}: moving: expected a name, or further cells that move")
    cells = [cell.name for cell in rig.cells if cell.placement is not None]
    if number and not cells:
        raise ControlError(
            f"{WHERE}: further_cells: expected a rig with a cell that has a place, whose copies "
            f"they are, got {rig.name}, in which only heaters have one"
        )
    stem = cells[0].rstrip("0123456789") if cells else ""
    free = (name for n in count(1) if (name := f"{stem}{n}") not in rig.driven)
    return {next(free): cells[0] for _ in range(number)}


def _bounds(rig: Rig, names: Sequence[str], bounds: Mapping[str, Any] | None) -> dict[str, Bounds]:
    """The part of the plate on which each face lies.

    **Raises:** `ControlError` for a name that does not move, or a part that is not on the plate or
    smaller than the face.
    """
    where = f"{WHERE}: bounds"
    given = mapping_of(where, {} if bounds is None else bounds, "name -> numbers", ControlError)
    for name in given:
        if name not in names:
            raise ControlError(f"{where}: {unknown_name('moving cell', name, names)}")
    whole = (0.0, rig.plate.width, 0.0, rig.plate.height)
    return {
        name: _part(f"{where}: {name}", given.get(name, whole), whole, _placement(rig, name).box)
        for name in names
    }


def _part(where: str, part: Any, whole: Bounds, box: tuple[float, float]) -> Bounds:
    numbers = tuple(part) if isinstance(part, Sequence) and not isinstance(part, str) else ()
    expected = (
        f"{where}: expected left, right, top and bottom of a part of the plate (up to "
        f"{whole[1]:g} m by {whole[3]:g} m) that its face of {box[0]:g} m by {box[1]:g} m fits in"
    )
    if len(numbers) != 4:
        raise ControlError(f"{expected}, got {part!r}")
    left, right, top, bottom = (finite_number(where, number, ControlError) for number in numbers)
    is_on_plate = min(left, top) >= 0 and right <= whole[1] and bottom <= whole[3]
    if not is_on_plate or right - left < box[0] or bottom - top < box[1]:
        raise ControlError(f"{expected}, got {part!r}")
    return left, right, top, bottom


def _placement(rig: Rig, name: str) -> Placement:
    return next(placement for placement in rig.placements if placement.name == name)


def _place(twin: Twin, name: str) -> Place:
    """x and y of the middle of a face, m."""
    placement, values = _placement(twin.rig, name), twin.numbers_si
    return float(placement.x.evaluate(values)), float(placement.y.evaluate(values))


def _named(names: Sequence[str], places: Places) -> dict[str, Place]:
    return {name: (float(x), float(y)) for name, (x, y) in zip(names, places, strict=True)}


def _middle(rig: Rig) -> Place:
    return rig.plate.width / 2, rig.plate.height / 2


def _moved(twin: Twin, places: Mapping[str, Place], copies: Mapping[str, str]) -> Twin:
    """The twin with its cells at these places, and with copies of cells."""
    rig = with_places(twin.rig, places, copies)
    return Twin(rig, {name: value for name, value in twin.values.items() if name in rig.parameters})


def _point(twin: Twin, at: PlateAtRest) -> OperatingPoint:
    cells = tuple(cell.name for cell in twin.netlist.cells)
    return OperatingPoint(
        at.unknowns[-len(cells) :],
        at.nodes,
        at.outputs,
        np.asarray(at.ambient),
        cell_names=cells,
        node_names=tuple(node.name for node in twin.netlist.nodes),
        channel_names=twin.channels,
        rig=twin.rig.name,
        elements=twin.wiring.elements,
    )
