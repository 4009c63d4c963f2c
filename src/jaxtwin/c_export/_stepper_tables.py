"""The numbers of a twin's step in C: the sizes of its arrays, their values, and the constants."""

from typing import final

import numpy as np

from .._errors import ControlError
from ..physics._heat_loss import STEFAN_BOLTZMANN
from ..simulation import Stepper
from ._text import number


@final
class StepperSizes:
    """The sizes of all arrays, and the terms of the equations."""

    def __init__(self, stepper: Stepper):
        system = stepper.system
        self.nodes, self.modes = np.shape(stepper.field.modes.shapes)
        self.cells = len(system.wiring.cold)
        self.channels = len(system.wiring.channels)
        self.elements = system.wiring.elements
        self.parts = len(stepper.sizes)
        self.has_delay, self.has_lag = system.delay is not None, system.lag is not None
        self.has_loss = stepper.plate is not None
        self.has_reservoirs = system.reservoirs is not None
        self.averaging, self.off_phase = system.bridge.averaging, system.bridge.off_phase
        self.is_limited = system.bridge.current_limit is not None
        self.queue = int(stepper.delay_steps) + self.parts - 1 if self.has_delay else 0
        self.sides = [*system.wiring.cold.tolist(), *system.wiring.hot.tolist()]


def stepper_tables(
    stepper: Stepper, sizes: StepperSizes, name: str
) -> dict[str, tuple[np.ndarray, str]]:
    system, field = stepper.system, stepper.field
    modes, shapes = field.modes, np.asarray(field.modes.shapes, float)
    gain = np.asarray(system.gain, float)
    weights = np.asarray(system.channel_weights, float)
    on_plate = np.broadcast_to(np.asarray(system.on_plate, float), gain.shape)
    module = system.module
    rates, h = np.asarray(modes.rates, float), np.asarray(stepper.sizes, float)
    factors = {
        "half": "by the force at the start, half a step",
        "half_start": "the second try",
        "half_middle": "and by the force in the middle",
        "whole_start": "by the force at the start, the whole step",
        "whole_middle": "and by that in the middle",
        "first": "by the force at the start, in the end",
        "middle": "those in the middle",
        "last": "and that at the end",
    }
    tables = {
        f"{name}_shape": (shapes, "temperatures of the nodes by the modes, K"),
        f"{name}_by_modes": (gain[:, None] * (weights @ shapes), "readings of the channels, K"),
        f"{name}_by_ambient": (1 - gain * on_plate, "and by the ambient"),
        f"{name}_capacitance": (np.asarray(modes.capacitance, float), "of the nodes, J/K"),
        f"{name}_surroundings": (np.asarray(field.surroundings, float), "forces by the ambient"),
        **(
            {}
            if field.reservoir_force is None
            else {
                f"{name}_reservoirs": (
                    np.asarray(field.reservoir_force, float),
                    "forces by coolant and the like",
                )
            }
        ),
        f"{name}_linearised_conductance": (
            np.asarray(modes.linearised_conductance, float),
            "heat flows out of the sides of the cells that are in the modes, W/K",
        ),
        f"{name}_alpha": (np.asarray(module.seebeck_coefficient, float), "Seebeck, V/K"),
        f"{name}_R": (np.asarray(module.electrical_resistance, float), "of the cells, ohm"),
        f"{name}_half_decay": (np.expm1(-rates * h[:, None] / 2), "less 1, of each part of a step"),
        f"{name}_decay": (np.expm1(-rates * h[:, None]), "less 1, of each part of a step"),
        **{
            f"{name}_{key}": (np.asarray(getattr(stepper.factors, key), float), text)
            for key, text in factors.items()
        },
    }
    if sizes.has_lag:
        lag = float(system.lag)  # pyright: ignore[reportArgumentType]
        tables[f"{name}_lag"] = (
            np.exp(-h[:, None] * np.array([0.5, 1.0]) / lag),
            "how much is left of a difference to the command in the middle and at the end",
        )
    if sizes.has_loss:
        loss = system.loss
        assert loss is not None
        begin = np.cumsum(h) - h
        stages = begin[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
        tables |= {
            f"{name}_at": (stages / h.sum() * 2, "start, middle and end of a part, in half steps"),
            f"{name}_to_half_decay": (np.asarray(stepper.half_decay, float) - 1, "to the middle"),
            f"{name}_to_half": (np.asarray(stepper.half, float), "and by the force"),
            f"{name}_film": (np.asarray(loss.film, float), "of the elements, W/K"),
            f"{name}_radiating": (
                STEFAN_BOLTZMANN * np.asarray(loss.radiating, float),
                "of the elements, W/K^4",
            ),
            f"{name}_linearised_loss": (
                np.asarray(modes.linearised_loss, float),
                "losses of the elements that are in the modes, W/K",
            ),
        }
    return {key: (np.asarray(value, float), text) for key, (value, text) in tables.items()}


def stepper_scalars(stepper: Stepper, name: str, real: str) -> tuple[str, int]:
    """The scalar constants as C, and their number.

    **Raises:** `ControlError` if one is not finite.
    """
    bridge, loss = stepper.system.bridge, stepper.system.loss
    values = {
        "T0": (stepper.reference, "what deviations are counted from, K"),
        "Vs": (bridge.supply_voltage, "V"),
        "Rs": (bridge.supply_resistance, "of the supply, ohm"),
        "Ron": (bridge.on_resistance, "of the switches, ohm"),
    }
    if bridge.current_limit is not None:
        values["Imax"] = (bridge.current_limit, "through a connected cell, A")
    if stepper.plate is not None and loss is not None:
        values["half_exponent"] = (float(np.asarray(loss.exponent)) / 2, "of the film")
    lines = []
    for key, (value, unit) in values.items():
        if not np.isfinite(np.asarray(value)):
            raise ControlError(f"export_c: {name}_{key}: expected a finite number, got {value}")
        constant = number(float(value), real)
        lines.append(f"static const {real} {name}_{key} = {constant}; /* {unit} */\n")
    return "".join(lines), len(values)
