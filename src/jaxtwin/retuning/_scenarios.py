"""The situations in which a candidate is tried on the twin before anything reaches the rig."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..control import MAX_STEP, AbstractController, Disturbance, Draught, HeatInput
from ..diagnosis import suspects
from ..io import Experiment
from ..physics import FAULT_MODELS, Fault, System, Twin
from ..simulation import assembled, simulate

# How much warmer or colder than in the rig file the room is, K.
ROOM_CHANGE = 8.0

# The increase of the film coefficient in the draught of an open door, W/(m^2 K).
DOOR = 20.0

# The heat of a hand on the plate, as a part of what the cells draw at full duty.
HAND = 0.15

# The change of the loop's gain.
GAIN = 0.3

# The voltage of a supply that saturates, as a part of what it was.
SAGGED = 0.6

# The models of faults that are tried, each at the usual size of a diagnosis and at the first part
# that it applies to. Left out are those that no controller could survive, such as a swapped
# polarity, and the delay of commands, which has a scenario of its own.
TRIED = ("loosen", "age", "fade", "block", "leak", "load", "gain", "offset")


@final
@dataclass(frozen=True)
class TrialScenario:
    """A situation in which controllers are tried. In all of them the references are the same.

    **Arguments:**

    - `name`: its name in some words.
    - `description`: what happens, in words.
    - `settings`: further keywords of `jaxtwin.control.scenario`, such as `ambient`.
    - `faults`: what has changed in the rig: each a model of `jaxtwin.physics.FAULT_MODELS`, a part,
      and a size.
    """

    name: str
    description: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[tuple[str, str, float], ...] = ()

    def fault(self, twin: Twin) -> Fault:
        """The change of the rig. Without a fault it changes no number, and gives the equations the
        same form as those of all other faults, so that they share their programs."""
        usual = (("weaken", "supply", 1.0), ("offset", twin.channels[0], 0.0))
        faults = [
            FAULT_MODELS[model](twin, part, np.float64(size))
            for model, part, size in (*usual, *self.faults)
        ]

        def changed(system: System) -> System:
            for fault in faults:
                system = fault(system)
            return system

        return changed


def usual_scenarios(
    twin: Twin, controller: AbstractController, duration: float
) -> tuple[TrialScenario, ...]:
    """Returns the scenarios in which every candidate is tried.

    **Arguments:**

    - `twin`: the twin. `controller`: the controller, whose sensor may be lost.
    - `duration`: the time of each scenario, s. What happens once begins at half of it.
    """
    rig, middle = twin.rig, duration / 2
    with own_settings():
        system = assembled(twin)
        room = float(system.ambient_temperature) - ZERO_CELSIUS
        delay = 0.0 if system.delay is None else float(system.delay)
    gains = {
        sign: tuple(
            # The heat of a heater grows with the square of the voltage, that of a cell with it.
            ("weaken", name, (1 + sign * GAIN) ** (1.0 if number < len(rig.cells) else 0.5))
            for number, name in enumerate(rig.driven)
        )
        for sign in (-1, 1)
    }
    result = [
        TrialScenario("steps", "the references, in the room of the rig file"),
        *(
            TrialScenario(
                f"{word} room",
                f"a room of {room + change:.0f} degC",
                {"ambient": room + change, "initial": room + change},
            )
            for word, change in (("warm", ROOM_CHANGE), ("cold", -ROOM_CHANGE))
        ),
        *_disturbed(twin, middle, duration),
        TrialScenario(
            "twice the delay",
            f"readings that are {_late(controller, delay):g} s late",
            {"sensor_delay": _late(controller, delay)},
        ),
        TrialScenario("gain -30 %", "cells and heaters that give 30 % less", faults=gains[-1]),
        TrialScenario("gain +30 %", "cells and heaters that give 30 % more", faults=gains[1]),
        TrialScenario(
            "saturated supply",
            f"{100 * SAGGED:.0f} % of the voltage of the supply",
            faults=(("weaken", "supply", SAGGED),),
        ),
    ]
    weights = np.asarray(controller.output_weights(twin.channels), float)
    used = np.flatnonzero(np.abs(weights).sum(axis=0))
    read = [twin.channels[number] for number in used]
    if len(read) > 1:
        result.append(
            TrialScenario(
                "sensor lost",
                f"{read[0]} gives no reading from {middle:g} s on",
                {"failed_channels": {read[0]: middle}},
            )
        )
    return (*result, *_faulty(twin))


def _late(controller: AbstractController, delay: float) -> float:
    """The delay of readings that doubles that of the loop, in whole steps of the plant, s: at least
    half a sample, by which a held duty is late anyway."""
    interval = controller.sample_time_s
    step = interval / max(1, math.ceil(interval / MAX_STEP * (1 - 1e-9)))
    return step * max(1, round(max(delay, interval / 2) / step))


def _disturbed(twin: Twin, begin: float, duration: float) -> list[TrialScenario]:
    """A door that opens, and a hand, for a tenth of the time."""
    end = begin + duration / 10
    plate = tuple(twin.rig.plate.element_names)
    free = tuple(body.name for body in twin.rig.bodies if body.temperature is None)
    if not (plate or free):
        return []
    full = Experiment([0.0, duration], np.ones((2, len(twin.rig.driven))))
    power = float(simulate(twin, full).energy[-1]) / duration
    hand = HAND * power
    disturbed: list[tuple[str, str, Sequence[Disturbance]]] = [
        ("hand", f"a hand of {hand:.2g} W", [HeatInput(plate or free, begin, end, hand)])
    ]
    if plate:
        door = Draught(plate, begin, end, DOOR)
        disturbed.append(("door", f"a draught of {DOOR:g} W/(m^2 K) over the plate", [door]))
    return [
        TrialScenario(name, f"{text} from {begin:g} to {end:g} s", {"disturbances": disturbances})
        for name, text, disturbances in disturbed
    ]


def _faulty(twin: Twin) -> list[TrialScenario]:
    result, seen = [], set[str]()
    for name, suspect in suspects(twin).items():
        model, _, part = name.partition(" ")
        is_model = suspect.fault is not None and model in TRIED and part in _parts(twin)
        if is_model and model not in seen:
            seen.add(model)
            size = suspect.size if suspect.unit != "W/K" else suspect.size / suspect.none
            unit = f" {suspect.unit}" if suspect.unit == "K" else ""
            text = f"the fault {name}, of a size of {size:.3g}{unit}"
            result.append(TrialScenario(name, text, faults=((model, part, size),)))
    return result


def _parts(twin: Twin) -> frozenset[str]:
    """The parts by which `FAULT_MODELS` knows what suspects name; not the links of a parameter."""
    return frozenset({*twin.rig.driven, *twin.channels, *twin.netlist.index, "plate", "supply"})
