"""Disturbances of a plate under control: draughts, and heat such as that of a hand."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number, of_kind
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...physics import Twin
from ...rig import check_has_plate


@final
@dataclass(frozen=True)
class Draught:
    """A draught over some elements of the plate.

    **Arguments:**

    - `elements`: elements of the plate, such as `("V11", "V12")`.
    - `start`, `end`: start and end, s.
    - `film_coefficient`: the increase of the film coefficient of the upper face, W/(m^2 K).
    """

    elements: tuple[str, ...]
    start: float | int
    end: float | int
    film_coefficient: float | int


@final
@dataclass(frozen=True)
class HeatInput:
    """Heat into some elements of the plate or bodies, for example from a hand.

    **Arguments:**

    - `elements`: elements of the plate and bodies, which share the heat equally.
    - `start`, `end`: start and end, s.
    - `heat`: the heat flow, W, negative for cooling.
    """

    elements: tuple[str, ...]
    start: float | int
    end: float | int
    heat: float | int


Disturbance: TypeAlias = Draught | HeatInput


def disturbance_tables(
    where: str,
    twin: Twin,
    disturbances: Iterable[Disturbance],
    times: Float[np.ndarray, " times"],
) -> tuple[Float[np.ndarray, "times nodes"], Float[np.ndarray, "times nodes"]]:
    """The heat into each node, W, and its additional conductance to the surroundings, W/K, at given
    times.

    **Raises:** `ControlError` for an element that the plate does not have, and for values that are
    not numbers.
    """
    plate = twin.rig.plate
    columns = {node.name: number for number, node in enumerate(twin.netlist.nodes)}
    heat = np.zeros((len(times), len(columns)))
    conductance = np.zeros_like(heat)
    for number, disturbance in enumerate(disturbances):
        at = f"{where}: disturbances[{number}]"
        if not isinstance(disturbance, HeatInput):
            of_kind(at, disturbance, Draught, "a Draught or a HeatInput", ControlError)
        known = plate.element_names
        if isinstance(disturbance, HeatInput):
            free = [body.name for body in twin.rig.bodies if body.temperature is None]
            known = (*known, *free)
        else:
            check_has_plate(at, twin.rig, ControlError)
        elements = _checked_elements(at, disturbance.elements, known)
        start, end = (
            finite_number(f"{at}.{name}", getattr(disturbance, name), ControlError)
            for name in ("start", "end")
        )
        if not start < end:
            raise ControlError(
                f"{at}.end: expected a time after the start at {start:g} s, got {end:g} s"
            )
        # A disturbance acts during a step if it acts at the sample at which the step begins.
        during = (times >= start - 1e-9) & (times < end - 1e-9)
        if not during.any():
            raise ControlError(
                f"{at}: expected a time within the run, whose samples go from {times[0]:g} to "
                f"{times[-1]:g} s, got {start:g} to {end:g} s"
            )
        for element in elements:
            if isinstance(disturbance, HeatInput):
                q = finite_number(f"{at}.heat", disturbance.heat, ControlError)
                heat[during, columns[element]] += q / len(elements)
            else:
                film = finite_number(
                    f"{at}.film_coefficient", disturbance.film_coefficient, ControlError, least=0
                )
                left, right, top, bottom = plate.extent(element)
                area = (right - left) * (bottom - top)
                conductance[during, columns[element]] += film * area
    return heat, conductance


def _checked_elements(at: str, elements: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    names = (elements,) if isinstance(elements, str) else tuple(elements)
    if not names:
        raise ControlError(f"{at}.elements: expected elements of the plate, got none")
    for name in names:
        if name not in known:
            raise ControlError(f"{at}.elements: {unknown_name('element', name, known)}")
    return names
