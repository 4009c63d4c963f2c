"""The quantities that follow from the places of cells and heaters on the plate.

Where parameters move a cell, its contact with each element that it may touch has the conductance of
the whole face times the share of the face there, and the film and radiation of an element act on
the part of its faces that nothing covers. These shares and parts have names, like parameters, so
that a resistance that depends on them is a product like any other (`Value`). They are computed
where parameters have numbers.
"""

from collections.abc import Mapping
from typing import Any

from ..rig import Placement, Rig, Value
from ..rig._placement import bare_name

# The smallest part of an element's faces that is left bare, so that its film has a resistance.
MIN_BARE = 1e-6


# The share of a face beside the elements that it may touch which is taken as a rounding error.
SHARE_TOLERANCE = 1e-6


def all_values(rig: Rig, values_si: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the parameters, of the inputs where none is stated, and of the quantities that
    follow from places.

    **Arguments:**

    - `values_si`: the values of all parameters in SI units: numbers, or arrays of one shape.
    """
    return {**values_si, **rig.nominal_inputs, **_placed(rig, values_si)}


def placed_names(rig: Rig) -> tuple[str, ...]:
    """The names of the quantities that follow from places that parameters determine."""
    moving = [placement for placement in rig.placements if not placement.is_fixed]
    shares = [p.share_name(element) for p in moving for element in p.elements(rig.plate)]
    bare = [bare_name(element) for element in _movably_covered(rig)]
    return (*shares, *bare, *on_plate_names(rig))


def on_plate_names(rig: Rig) -> tuple[str, ...]:
    """The names of quantities that are above 0 if the whole face of a cell or heater whose place is
    a parameter lies on elements that it may touch."""
    return tuple(_on_plate(placement) for placement in rig.placements if not placement.is_fixed)


def bare_faces(rig: Rig) -> dict[str, Value]:
    """The part of the two faces of each element that no cell and no placed heater covers; 1 for
    elements that are left out."""
    bare = {name: Value(1 - covered) for name, covered in _covered_faces(rig).items()}
    return bare | {name: Value(1.0, ((bare_name(name), 1.0),)) for name in _movably_covered(rig)}


def _placed(rig: Rig, values_si: Mapping[str, Any]) -> dict[str, Any]:
    plate = rig.plate
    moving = [placement for placement in rig.placements if not placement.is_fixed]
    if not moving:
        return {}
    result: dict[str, Any] = {}
    fixed = _covered_faces(rig)
    covered: dict[str, Any] = {name: fixed.get(name, 0.0) for name in _movably_covered(rig)}
    for placement in moving:
        areas = placement.overlaps(plate, values_si)
        for number, element in enumerate(placement.elements(plate)):
            area = areas[..., number]
            result[placement.share_name(element)] = area / placement.area
            covered[element] = covered[element] + area / (2 * plate.area(element))
        result[_on_plate(placement)] = areas.sum(axis=-1) / placement.area - 1 + SHARE_TOLERANCE
    for element, part in covered.items():
        result[bare_name(element)] = (1 - part).clip(MIN_BARE)
    return result


def _on_plate(placement: Placement) -> str:
    return placement.share_name("plate")


def _movably_covered(rig: Rig) -> tuple[str, ...]:
    """The elements that a cell or heater whose place is a parameter may touch."""
    moving = [placement for placement in rig.placements if not placement.is_fixed]
    return tuple(dict.fromkeys(name for p in moving for name in p.elements(rig.plate)))


def _covered_faces(rig: Rig) -> dict[str, float]:
    """Returns the part of the two faces of each element that cells and heaters cover whose places
    no parameter moves.

    A cell whose contacts are listed covers the same part of all elements that it touches. If the
    rig does not state its area, it is taken to be as large as one element ("the area of these
    elements is selected to be equal or proportional to the Peltier device area", section 3.2.1 of
    the paper).
    """
    plate, covered = rig.plate, {}
    for cell in rig.cells:
        if cell.placement is not None:
            continue
        elements = [node for node, _ in cell.contacts if node in plate.element_names]
        for element in elements:
            share = 1 / len(elements)
            if cell.area is not None:
                share = cell.area / sum(plate.area(touched) for touched in elements)
            covered[element] = min(1.0, covered.get(element, 0.0) + share / 2)
    for placement in rig.placements:
        if placement.is_fixed:
            for element, share in placement.shares(plate).items():
                part = share.factor * placement.area / (2 * plate.area(element))
                covered[element] = min(1.0, covered.get(element, 0.0) + part)
    return covered
