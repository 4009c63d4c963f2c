r"""A twin as C: the steps of `Stepper`, in the modes of the network, with nonlinear Peltier terms
and losses.

In `twin.c` the decay of the modes in a step, $(e^{-\lambda h} - 1) z$, is computed and added: these
factors keep all digits of a `float` even if a slow mode decays by a thousandth.
"""

from collections.abc import Sequence
from typing import final

import numpy as np

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..control import LawTable
from ..physics import STEFAN_BOLTZMANN
from ..rig import Parameter
from ..simulation import Stepper
from ._input_tables import input_constants, input_lines, input_numbers, input_tables
from ._sources import Code, Parts, code_of, comment_block, defines, type_of_numbers, whole_numbers

# The numbers of a twin's step in C: the sizes of its arrays, their values, and the constants.


@final
class StepperSizes:
    """The sizes of all arrays, and the terms of the equations."""

    def __init__(self, stepper: Stepper):
        system = stepper.system
        self.nodes, self.modes = np.shape(stepper.field.modes.shapes)
        self.cells = len(system.wiring.cold)
        self.channels = len(system.wiring.channels)
        self.parts = len(stepper.sizes)
        self.has_delay, self.has_lag = system.delay is not None, system.lag is not None
        paths = system.wiring.loss_paths
        self.has_loss = paths is not None
        self.has_far_ends = paths is not None and not paths.is_of_plate
        self.plate_losses = 0 if paths is None else paths.elements
        self.loss_from: list[int] = [] if paths is None else paths.near.tolist()
        # Beyond the nodes are the surroundings, then the bodies of given temperatures.
        self.loss_to = (
            []
            if paths is None
            else np.where(paths.far >= 0, paths.far, self.nodes - 1 - paths.far).tolist()
        )
        self.has_reservoirs = system.reservoirs is not None
        self.queue = int(stepper.delay_steps) + self.parts - 1 if self.has_delay else 0
        self.sides = [*system.wiring.cold.tolist(), *system.wiring.hot.tolist()]


def stepper_tables(stepper: Stepper, sizes: StepperSizes) -> dict[str, LawTable]:
    """The arrays: name -> values and comment."""
    system, field = stepper.system, stepper.field
    modes, shapes = field.modes, np.asarray(field.modes.shapes, float)
    by_nodes, by_ambient = system.output_matrices()
    module = system.module
    rates, h = np.asarray(modes.rates, float), np.asarray(stepper.sizes, float)
    factors = {
        "half": "stage 2, by the force at the start",
        "half_start": "stage 3, by the force at the start",
        "half_middle": "stage 3, by that of stage 2",
        "whole_start": "stage 4, by the force at the start",
        "whole_middle": "stage 4, by that of stage 3",
        "first": "result, by the force at the start",
        "middle": "result, by those of stages 2 and 3",
        "last": "result, by that of stage 4",
    }
    tables = {
        "shape": (shapes, "temperatures of the nodes by the modes, K"),
        "by_modes": (np.asarray(by_nodes, float) @ shapes, "readings of the channels, K"),
        "by_ambient": (np.asarray(by_ambient, float), "and by the ambient"),
        "capacitance": (np.asarray(modes.capacitance, float), "of the nodes, J/K"),
        "surroundings": (np.asarray(field.surroundings, float), "forces by the ambient"),
        **(
            {}
            if field.reservoir_force is None
            else {
                "reservoirs": (
                    np.asarray(field.reservoir_force, float),
                    "forces by coolant and the like",
                )
            }
        ),
        "linearised_conductance": (
            np.asarray(modes.linearised_conductance, float),
            "heat flows out of the sides of the cells that are in the modes, W/K",
        ),
        **_powers(stepper),
        "alpha": (np.asarray(module.seebeck_coefficient, float), "Seebeck, V/K"),
        "R": (np.asarray(module.electrical_resistance, float), "of the cells, ohm"),
        "half_decay": (np.expm1(-rates * h[:, None] / 2), "less 1, of each part of a step"),
        "decay": (np.expm1(-rates * h[:, None]), "less 1, of each part of a step"),
        **{
            key: (np.asarray(getattr(stepper.factors, key), float), text)
            for key, text in factors.items()
        },
    }
    if sizes.has_lag:
        lag = float(system.lag)  # pyright: ignore[reportArgumentType]
        tables["lag"] = (
            np.exp(-h[:, None] * np.array([0.5, 1.0]) / lag),
            "how much is left of a difference to the command in the middle and at the end",
        )
    if sizes.has_loss:
        loss = system.loss
        assert loss is not None
        begin = np.cumsum(h) - h
        stages = begin[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
        tables |= {
            "at": (stages / h.sum() * 2, "start, middle and end of a part, in half steps"),
            "to_half_decay": (np.asarray(stepper.half_decay, float) - 1, "to the middle"),
            "to_half": (np.asarray(stepper.half, float), "and by the force"),
            "film": (np.asarray(loss.film, float), "of the paths of losses, W/K"),
            "half_exponent": (np.asarray(loss.exponent, float) / 2, "of the films"),
            "radiating": (
                STEFAN_BOLTZMANN * np.asarray(loss.radiating, float),
                "of the paths, W/K^4",
            ),
            "linearised_loss": (
                np.asarray(modes.linearised_loss, float),
                "losses of the paths that are in the modes, W/K",
            ),
        }
        far = system.far_ends(stepper.reference)
        if far is not None and loss.linear is not None:
            tables |= {
                "linear_radiation": (
                    np.asarray(loss.linear, float),
                    "of the paths, in the network, K^3",
                ),
                "loss_held": (np.asarray(far.held, float), "bodies at the ends of the paths, K"),
            }
    return {key: (np.asarray(value, float), text) for key, (value, text) in tables.items()}


def _powers(stepper: Stepper) -> dict[str, LawTable]:
    """The powers of the heaters that have a supply of their own."""
    bridge = stepper.system.bridge
    if not bridge.own_supply:
        return {}
    power = bridge.own_voltage**2 / np.asarray(stepper.system.module.electrical_resistance, float)
    result: dict[str, LawTable] = {
        "power": (np.where(bridge.own_supply, power, 0.0), "of heaters at full duty, W; else 0")
    }
    if bridge.drive_exponent is not None:
        law = np.asarray(bridge.drive_exponent, float)
        result["drive_exponent"] = law, "of the duty, to which the heat is proportional"
    return result


def stepper_constants(stepper: Stepper, sizes: StepperSizes) -> dict[str, int | float]:
    """The macros of the numbers: those of the driver and the losses, and the terms of the equations
    that this twin has."""
    bridge = stepper.system.bridge
    result: dict[str, int | float] = {
        "PARTS": sizes.parts,
        "T0": float(stepper.reference),
        "ZERO_CELSIUS": ZERO_CELSIUS,
        "VS": float(np.asarray(bridge.supply_voltage)),
        "RS": float(np.asarray(bridge.supply_resistance)),
        "RON": float(np.asarray(bridge.on_resistance)),
    }
    if bridge.averaging == "voltage":
        result["MEAN_VOLTAGE"] = 1
    elif bridge.off_phase == "brake":
        result["BRAKES"] = 1
    if bridge.current_limit is not None:
        result["IMAX"] = float(np.asarray(bridge.current_limit))
    if bridge.own_supply:
        result["HAS_POWERS"] = 1
    if bridge.drive_exponent is not None:
        result["HAS_DRIVE_LAW"] = 1
    if sizes.has_lag:
        result["HAS_LAG"] = 1
    if sizes.has_reservoirs:
        result["HAS_RESERVOIRS"] = 1
    if sizes.has_loss:
        result["LOSSES"] = len(sizes.loss_from)
    if sizes.has_far_ends:
        result |= {"HAS_FAR_ENDS": 1, "PLATE_LOSSES": sizes.plate_losses}
    return result | input_constants(stepper)


# Macro -> its meaning and its unit.
COMMENTS = {
    "PARTS": "of a step, between which a command arrives",
    "T0": "what deviations are counted from, K",
    "VS": "of the supply, V",
    "RS": "of the supply, ohm",
    "RON": "of the switches, ohm",
    "IMAX": "through a connected cell, A",
    "LOSSES": "paths of losses that are not linear",
    "PLATE_LOSSES": "of the plate, the first of them",
    "EFFECTS": "of the inputs, those of BODIES and LINKS and of the supply",
    "SHARES": "of states, and the inputs",
    "PARAMETERS": "that can be set",
}


def stepper_c(stepper: Stepper, name: str, precision: str, origin: str) -> Code:
    """Returns header, source and numbers.

    **Raises:** `ControlError` if a number of the twin is not finite in this precision.
    """
    with own_settings():
        sizes = StepperSizes(stepper)
        tables = stepper_tables(stepper, sizes)
        numbers = defines(name, stepper_constants(stepper, sizes), precision, COMMENTS)
        numbers += "\n/* Nodes of the cold sides of the cells, and of the hot ones. */\n"
        numbers += whole_numbers(name, "side", sizes.sides) + path_ends(name, sizes)
        inputs = stepper.system.wiring.inputs
        if inputs:
            tables |= input_tables(stepper)
            numbers += "\n/* Inputs and shares of their states, which have a number. */\n"
            for key, result in input_numbers(inputs).items():
                numbers += whole_numbers(name, key, result)
        parts = Parts(
            about_twin(stepper, sizes, name, precision, origin),
            twin_sizes(stepper, sizes, name, precision),
            numbers,
            tables,
            sizes.modes + sizes.cells * (1 + sizes.queue) + len(inputs),
        )
        return code_of("twin", name, precision, parts)


def path_ends(name: str, sizes: StepperSizes) -> str:
    """The C of the ends of the paths of losses; none for those of the plate alone."""
    if not sizes.has_far_ends:
        return ""
    about = "ends of the paths of losses; beyond the nodes the room, then bodies"
    return whole_numbers(name, "loss_from", sizes.loss_from, about) + whole_numbers(
        name, "loss_to", sizes.loss_to, about
    )


def twin_sizes(stepper: Stepper, sizes: StepperSizes, name: str, precision: str) -> str:
    """The C in the header that says which numbers a twin has, and how many."""
    constants: dict[str, int | float] = {
        "SAMPLE_TIME_S": float(np.asarray(stepper.sizes).sum()),
        "AMBIENT": float(stepper.reference) - ZERO_CELSIUS,
        "CELLS": sizes.cells,
        "CHANNELS": sizes.channels,
        "NODES": sizes.nodes,
        "MODES": sizes.modes,
        "QUEUE": sizes.queue,
        "INPUTS": len(stepper.system.wiring.inputs),
    }
    comments = {
        "AMBIENT": "of the rig, degC",
        "QUEUE": "commands that can be on their way",
        "INPUTS": "besides duty and ambient",
    }
    return type_of_numbers(name, precision) + defines(name, constants, precision, comments)


def about_twin(
    stepper: Stepper,
    sizes: StepperSizes,
    name: str,
    real: str,
    origin: str,
    parameters: Sequence[Parameter] = (),
) -> str:
    """The comment at the beginning of the header; `parameters` are those that can be set."""
    wiring = stepper.system.wiring
    step = float(np.asarray(stepper.sizes).sum())
    kept = f"{sizes.modes} modes"
    if sizes.modes < sizes.nodes:
        kept += f", of a network of {sizes.nodes} nodes reduced to them,"
    return comment_block(
        [
            f"{name}: a twin of a thermoelectric rig, written by jaxtwin.",
            f"Parameters: {origin}" if origin else "Parameters: those of a jaxtwin.Twin",
            "",
            f"Sample time: {step!r} s. Numbers: {real}.",
            f"Its {kept} are exact; Peltier and Joule heat and losses are nonlinear.",
            "Duty cycles from -1 to 1, positive heats, of the cells:",
            *(
                f"  {n}: {cell.name}{', a heater: 0 to 1' if cell.is_heater else ''}"
                for n, cell in enumerate(wiring.netlist.cells)
            ),
            *input_lines(wiring.inputs),
            *(["Parameters, in their units:"] if parameters else []),
            *(
                f"  {n}: {row.name}{row.unit and f', {row.unit}'}"
                for n, row in enumerate(parameters)
            ),
            "Readings, degC, of the channels:",
            *(f"  {n}: {channel}" for n, channel in enumerate(wiring.channels)),
            "Nodes, degC:",
            *(f"  {n}: {node.name}" for n, node in enumerate(wiring.netlist.nodes)),
        ]
    )
