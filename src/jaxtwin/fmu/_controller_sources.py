"""The variables and the sources of an FMU of a controller."""

from typing import NamedTuple

import numpy as np

from .._celsius import ZERO_CELSIUS
from ..c_export._controller_c import controller_c
from ..c_export._sources import Code, defines
from ..c_export._text import table
from ..control import AbstractController
from ..physics import Twin
from ..rig import Rig
from ._variables import Variable, names_c


class ControllerParts(NamedTuple):
    """What an FMU of a controller is made of.

    - `variables`: its variables. `code`: the controller as C.
    - `numbers`: the C of `model_fmu.h`, without the token.
    """

    variables: list[Variable]
    code: Code
    numbers: str


def controller_parts(
    controller: AbstractController, rig: Rig, name: str, origin: str
) -> ControllerParts:
    """Makes variables and sources: time, a reference for each output, the channels that it reads,
    the duty of each cell, and the duty that it takes over at the start.

    **Raises:** `ControlError` as `export_c`.
    """
    code = controller_c(controller, rig, name, "double", origin)
    channels = np.array([channel.name for channel in rig.channels])
    weights = np.asarray(controller.for_rig(rig).reading_weights(list(channels)), float)
    read = weights.any(axis=0)
    outputs = controller.output_names(list(channels))
    room = float(rig.ambient_temperature.evaluate(Twin(rig).numbers_si)) - ZERO_CELSIUS
    variables = _variables(outputs, list(channels[read]), rig, room)
    numbers = (
        defines(name, {"CHANNELS": int(read.sum()), "ROOM": room}, "double")
        + table(f"{name}_weights", weights[:, read], "of channels in readings", "double")
        + names_c(name, variables)
    )  # fmt: skip
    return ControllerParts(variables, code, numbers)


def _variables(
    outputs: tuple[str, ...], channels: list[str], rig: Rig, room: float
) -> list[Variable]:
    cells = [
        (name, (lowest, 1.0)) for name, lowest in zip(rig.driven, rig.lowest_duty, strict=True)
    ]
    rows = [
        Variable("time", 0, "independent", "s", None, None, "Time"),
        *(
            Variable(f"reference.{n + 1}", 0, "input", "degC", room, None, f"Reference of {name}")
            for n, name in enumerate(outputs)
        ),
        *(
            Variable(name, 0, "input", "degC", room, None, "Reading of the channel, NaN for none")
            for name in channels
        ),
        *(
            Variable(f"duty.{name}", 0, "output", "", None, full, "Duty cycle, positive heats")
            for name, full in cells
        ),
        *(
            Variable(f"start_duty.{name}", 0, "parameter", "", 0.0, full, "Duty before the start")
            for name, full in cells
        ),
    ]
    return [variable._replace(reference=number) for number, variable in enumerate(rows)]
