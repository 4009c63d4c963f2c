"""The file of an `MPC`: what it reads of it, and the lines that it writes."""

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ._condensed_program import Deviations
from ._controller import AbstractController
from ._controller_fields import FileContents, as_quantity
from ._evenness_file import evenness_lines, read_evenness
from ._file_model import (
    FileModel,
    limit_lines,
    model_lines,
    model_settings,
    point_lines,
    read_model,
    temperature_limits,
)
from ._plant import Temperatures

if TYPE_CHECKING:
    from ._mpc import MPC


def mpc_contents(
    controller: type[AbstractController], contents: FileContents
) -> tuple[FileModel, dict[str, Any]]:
    """Reads the model, and the arguments beside it.

    **Raises:** `ControlError` that names the field.
    """
    even = read_evenness(contents)
    model = read_model(contents, controller.kind, even.rows)
    settings = model_settings(controller, contents) | even.arguments
    limits = temperature_limits(contents)
    if even.arguments and "excess_deviation" not in contents.data:
        contents.refuse("excess_deviation", "expected this field, got none")
    preview = contents.data.get("preview", False)
    if not isinstance(preview, bool):
        contents.refuse("preview", f"expected true or false, got {preview!r}")
    settings |= {
        "horizon": contents.data["horizon"],
        "control_horizon": contents.data.get("control_horizon"),
        "preview": preview,
        "temperature_limits": limits,
    }
    return model, settings


def mpc_lines(mpc: "MPC") -> list[str]:
    """Returns the lines of the operating point, the deviations, the limits, and the model."""
    of_fields = dict(zip(Deviations._fields, mpc.deviations, strict=True))
    values: dict[str, Any] = {f"{name}_deviation": value for name, value in of_fields.items()}
    values["duty_change_deviation"] = values.pop("change_deviation")
    tables: list[str] = []
    if mpc.rate_limit is not None:
        values["rate_limit"] = mpc.rate_limit
    if mpc.points is not None:
        values["excess_deviation"] = mpc.excess_deviation[-1]
    for row, (name, limit) in enumerate(mpc.temperature_limits):
        C, at, gain = (np.asarray(part)[row] for part in mpc.watched[:3])
        tables += limit_lines(name, limit, float(at), C, float(gain))
    C = None
    if mpc.points is not None and mpc.evenness is not None:
        C = np.asarray(mpc.of_channels) @ np.asarray(mpc.watched.C)
        tables += evenness_lines(
            mpc.evenness,
            mpc.watched,
            mpc.read_channels,
            len(mpc.temperature_limits),
            Temperatures(np.asarray(mpc.points.C), np.asarray(mpc.points.at)),
            mpc.point_names,
            np.asarray(mpc.points.by_errors),
        )
    return [
        *point_lines(mpc.duty, mpc.outputs),
        f"horizon = {mpc.horizon}",
        f"control_horizon = {mpc.control_horizon}",
        f"preview = {json.dumps(mpc.preview)}",
        *(
            f"{name} = {as_quantity(value, mpc.fields[name].quantity)}"
            for name, value in values.items()
        ),
        *tables,
        *model_lines(mpc.kalman, C),
    ]
