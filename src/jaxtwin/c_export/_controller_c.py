"""A controller as C, which treats missing readings as the closed loop in Python does.

The controllers differ in their `Law`; what they share is in `controller.c`.
"""

import numpy as np

from ..control import AbstractController, Law, bounds_of, check_limits_of_heaters, limits_text
from ..errors import ControlError
from ..rig import Rig
from ._sources import Code, Parts, code_of, comment_block, defines, type_of_numbers

# The time without a reading after which the cells are switched off, s, as in
# `simulate_closed_loop`.
SILENCE_S = 3.0


def controller_c(
    controller: AbstractController, rig: Rig, name: str, precision: str, origin: str
) -> Code:
    """Returns header, source and numbers.

    **Raises:** `ControlError` if the controller is not for the rig or has no law in C, cools with
    heaters, or a number of it is not finite in this precision.
    """
    controller = controller.for_rig(rig)
    channels = [channel.name for channel in rig.channels]
    weights = controller.reading_weights(channels)
    cells, outputs = len(rig.driven), len(controller.output_weights(channels))
    if not controller.fits_outputs(outputs, cells):
        raise ControlError(
            f"export_c: measured: expected an output for each of the {cells} cells of {rig.name}, "
            f"got {outputs}"
        )
    check_limits_of_heaters("export_c", controller.limits, rig)
    law = controller.law(cells)
    state = {**law.state, "seen": len(weights)}
    constants = dict(law.constants)
    if law.integrals:
        state = {"integral": law.integrals, **state}
        constants["INTEGRALS"] = law.integrals
        if precision == "float":
            state["lost"] = law.integrals
    lowest, highest = (np.broadcast_to(bound, (cells,)) for bound in bounds_of(controller.limits))
    limits = {
        "lowest_duty": (lowest, "of each cell and heater"),
        "highest_duty": (highest, "of each cell and heater"),
    }
    parts = Parts(
        _about(controller, rig, weights, outputs, law, name, precision, origin),
        _sizes(controller, law, cells, (outputs, len(weights)), state, name, precision),
        defines(name, constants, precision),
        {**limits, **law.tables},
        sum(state.values()) + 1,
        law.code,
    )
    return code_of("controller", name, precision, parts)


def _about(
    controller: AbstractController,
    rig: Rig,
    weights: np.ndarray,
    outputs: int,
    law: Law,
    name: str,
    real: str,
    origin: str,
) -> str:
    upper = name.upper()
    channels = np.array([channel.name for channel in rig.channels])
    limits = limits_text(controller.limits, rig)
    return comment_block(
        [
            f"{name}: {law.title} for the rig {rig.name}, written by jaxtwin.",
            f"Parameters: {origin}" if origin else "Parameters of a jaxtwin.control controller:",
            *(f"  {line}" for line in law.parameters),
            "",
            f"Sample time: {controller.sample_time_s!r} s. Numbers: {real}.",
            "Measurements, degC, each the mean of these channels:",
            *(f"  {n}: {', '.join(channels[row > 0])}" for n, row in enumerate(weights)),
            f"References, degC: those of the first {outputs}.",
            f"Duty cycles from {limits}, positive heats, of the cells:",
            *(f"  {n}: {name}" for n, name in enumerate(rig.driven)),
            "",
            "A measurement that is no finite number leaves the last ones standing. After",
            f"{upper}_SILENCE_S without any, all duty cycles are 0 until {name}_init is called;",
            "they are at once where a reference or a duty is no finite number. missing_s is above",
            f"{upper}_SILENCE_S then. Whoever calls must switch off where calls stop (a watchdog).",
        ]
    )


def _sizes(
    controller: AbstractController,
    law: Law,
    cells: int,
    outputs_and_readings: tuple[int, int],
    state: dict[str, int],
    name: str,
    precision: str,
) -> str:
    """Sample time, sizes and the struct of the state. The silence can be set by the compiler."""
    outputs, readings = outputs_and_readings
    sizes = {"OUTPUTS": outputs, "READINGS": readings, "CELLS": cells}
    if law.horizon:
        sizes["HORIZON"] = law.horizon
    fields = "".join(f"    {name}_real {field}[{size}];\n" for field, size in state.items())
    return (
        type_of_numbers(name, precision)
        + defines(name, {"SAMPLE_TIME_S": controller.sample_time_s}, precision)
        + f"#ifndef {name.upper()}_SILENCE_S\n"
        + defines(name, {"SILENCE_S": SILENCE_S}, precision)
        + "#endif\n"
        + defines(name, sizes, precision)
        + f"\ntypedef struct {{\n{fields}"
        f"    {name}_real missing_s; /* since the last measurement */\n}} {name}_state;\n"
    )
