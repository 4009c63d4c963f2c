r"""A twin as C: the steps of `Stepper`, in the modes of the network, with nonlinear Peltier terms
and losses.

In `twin.c` the decay of the modes in a step, $(e^{-\lambda h} - 1) z$, is computed and added: these
factors keep all digits of a `float` even if a slow mode decays by a thousandth.
"""

from collections.abc import Sequence

import numpy as np

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..rig import Parameter
from ..simulation import Stepper
from ._input_tables import input_lines, input_numbers, input_tables
from ._sources import Code, Parts, code_of, defines, type_of_numbers, whole_numbers
from ._stepper_tables import COMMENTS, StepperSizes, stepper_constants, stepper_tables
from ._text import comment_block


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
