"""The file of an `MPC`: what it reads of it, and the lines that it writes."""

import json
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._name_suggestions import did_you_mean, unknown_name
from ...rig import Kind
from ._controller import AbstractController
from ._controller_fields import FileContents, Refuse, as_matrix, as_quantity, matrix, quantity
from ._file_model import (
    NOT_EVEN,
    PER_STATE,
    PLAIN,
    FileEvenness,
    FileModel,
    as_celsius,
    gain_of_error,
    limit_lines,
    model_lines,
    model_settings,
    point_lines,
    read_model,
    read_table,
    temperature_limits,
    temperatures_of,
)
from ._mpc_programs import EVENNESS_COSTS, AbstractEvennessCost, Deviations, WatchedChannels
from ._plant import Temperatures

if TYPE_CHECKING:
    from ._mpc import MPC


# The table of a controller file that describes points which are to be even.
#
# ```toml [evenness] cost = "range" energy_price = "0.0 K" L = 0.2 # of the filter of the errors
# of the model at the channels
#
# [evenness.channels] # that are read, but for those with temperature limits names = ["T11",
# "T12"] operating_point = ["43.0 degC", "46.3 degC"] C = { unit = "K", rows = [[...], [...]] }
#
# [evenness.points] names = ["V11", "V12", "V13"] operating_point = ["48.4 degC", "49.1 degC",
# "48.4 degC"] C = { unit = "K", rows = [[...], [...], [...]] } by_errors = [[...], [...],
# [...]] # limited channels first ```

PRICE = Kind("a temperature difference", "K", "0.0 K", least="zero")

_FIELDS = ("cost", "energy_price", "L", "channels", "points")
_ROWS = ("names", "operating_point", "C")


class EvennessTable(NamedTuple):
    """The table: the arguments of an `MPC`, and the rows of its model."""

    arguments: dict[str, Any]
    rows: FileEvenness


def read_evenness(contents: FileContents) -> EvennessTable:
    """Reads the table; without one, there are no arguments and no rows.

    **Raises:** `ControlError` that names the field.
    """
    if "evenness" not in contents.data:
        return EvennessTable({}, NOT_EVEN)
    refuse = contents.refuse
    table = read_table(contents.data["evenness"], "evenness", refuse, _FIELDS)
    name = table["cost"]
    if not isinstance(name, str) or name not in EVENNESS_COSTS:
        hint = did_you_mean([str(name)], EVENNESS_COSTS)
        refuse("evenness.cost", f"expected one of {', '.join(EVENNESS_COSTS)}, got {name!r}{hint}")
    price = quantity(table["energy_price"], "evenness.energy_price", PRICE, refuse, is_list=False)
    channels, of_channels, _ = _read_rows(table, "channels", _ROWS, refuse)
    for channel in channels:
        if channel not in contents.channels:
            unknown = unknown_name("channel", channel, contents.channels)
            refuse("evenness.channels.names", unknown)
    points, of_points, values = _read_rows(table, "points", (*_ROWS, "by_errors"), refuse)
    shares = matrix(
        values["by_errors"], "evenness.points.by_errors", PLAIN, (len(points), None), refuse
    )
    gain = gain_of_error(table["L"], "evenness.L", refuse)
    arguments = {
        "evenness": EVENNESS_COSTS[name](price),
        "points": points,
        "point_errors": shares,
    }
    return EvennessTable(arguments, FileEvenness(of_channels, of_points, gain))


def evenness_lines(
    cost: AbstractEvennessCost,
    watched: WatchedChannels,
    channels: tuple[str, ...],
    limited: int,
    points: Temperatures,
    names: tuple[str, ...],
    by_errors: Float[np.ndarray, "points channels"],
) -> list[str]:
    """Returns the lines of the table.

    **Arguments:**

    - `watched`, `channels`: the channels that are read, of which the first `limited` have limits
      and stand with these.
    - `points`, `names`, `by_errors`: the points that are to be even.
    """
    temperatures = Temperatures(np.asarray(watched.C)[limited:], np.asarray(watched.at)[limited:])
    return [
        "",
        "[evenness]",
        f"cost = {json.dumps(cost.name)}",
        f'energy_price = "{cost.energy_price!r} K"',
        f"L = {float(np.asarray(watched.L)[0])!r}",
        *_row_lines("channels", channels[limited:], temperatures),
        *_row_lines("points", names, points),
        f"by_errors = {as_matrix(by_errors, PLAIN)}",
    ]


def _row_lines(part: str, names: tuple[str, ...], rows: Temperatures) -> list[str]:
    return [
        "",
        f"[evenness.{part}]",
        f"names = {json.dumps(names)}",
        f"operating_point = {as_celsius(rows.at)}",
        f"C = {as_matrix(rows.C, PER_STATE)}",
    ]


def _read_rows(
    table: dict[str, Any], part: str, fields: tuple[str, ...], refuse: Refuse
) -> tuple[list[str], Temperatures, dict[str, Any]]:
    where = f"evenness.{part}"
    values = read_table(table[part], where, refuse, fields)
    names = values["names"]
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not is_list or len(set(names)) < len(names):
        refuse(f"{where}.names", f"expected names, each once, got {names!r}")
    at = temperatures_of(values["operating_point"], f"{where}.operating_point", len(names), refuse)
    C = matrix(values["C"], f"{where}.C", PER_STATE, (len(names), None), refuse)
    return names, Temperatures(C, np.array(at)), values


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
