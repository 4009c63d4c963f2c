"""The file of an `MPC`: what it reads of it, and the lines that it writes."""

import json
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._name_suggestions import did_you_mean, unknown_name
from ...rig import Kind
from ._controller import AbstractController
from ._controller_fields import FileContents, Refuse, as_matrix, as_quantity, matrix, quantity
from ._model_file import (
    PER_STATE,
    PLAIN,
    as_celsius,
    field_settings,
    gain_of_error,
    limit_lines,
    model_lines,
    point_lines,
    read_table,
    temperatures_of,
)
from ._mpc_programs import EVENNESS_COSTS, AbstractEvennessCost, EvenPoints

if TYPE_CHECKING:
    from ._mpc import MPC


# The table of a controller file that describes points which are to be even.
#
# ```toml
# [evenness]
# cost = "range"
# energy_price = "0.0 K"
# L = 0.2  # of the filter of the errors of the model at the channels
#
# [evenness.channels]  # that are read, but for those with temperature limits
# names = ["T11", "T12"]
# operating_point = ["43.0 degC", "46.3 degC"]
# C = { unit = "K", rows = [[...], [...]] }
#
# [evenness.points]
# names = ["V11", "V12", "V13"]
# operating_point = ["48.4 degC", "49.1 degC", "48.4 degC"]
# C = { unit = "K", rows = [[...], [...], [...]] }
# by_errors = [[...], [...], [...]]  # limited channels first
# ```

PRICE = Kind("a temperature difference", "K", "0.0 K", least="zero")

_FIELDS = ("cost", "energy_price", "L", "channels", "points")
_ROWS = ("names", "operating_point", "C")


class EvenRows(NamedTuple):
    """Channels that are read, or points that are to be even: their names, their rows of the model,
    and their temperatures at the operating point, degC."""

    names: list[str]
    C: Float[np.ndarray, "rows state"]
    at: Float[np.ndarray, " rows"]


class Evenness(NamedTuple):
    """The table, as in `design_mpc`: the channels without temperature limits that are read, the
    points, how the errors of the channels change these, and the gain of the filter of the errors.
    """

    cost: AbstractEvennessCost
    channels: EvenRows
    points: EvenRows
    point_errors: Float[np.ndarray, "points channels"]
    L: float


def read_evenness(contents: FileContents, states: int) -> Evenness | None:
    """Reads the table; None without one. `states` is the number of states of the model.

    **Raises:** `ControlError` that names the field.
    """
    if "evenness" not in contents.data:
        return None
    refuse = contents.refuse
    table = read_table(contents.data["evenness"], "evenness", refuse, _FIELDS)
    name = table["cost"]
    if not isinstance(name, str) or name not in EVENNESS_COSTS:
        hint = did_you_mean([str(name)], EVENNESS_COSTS)
        refuse("evenness.cost", f"expected one of {', '.join(EVENNESS_COSTS)}, got {name!r}{hint}")
    price = quantity(table["energy_price"], "evenness.energy_price", PRICE, refuse, is_list=False)
    channels, _ = _read_rows(table, "channels", _ROWS, states, refuse)
    for channel in channels.names:
        if channel not in contents.channels:
            unknown = unknown_name("channel", channel, contents.channels)
            refuse("evenness.channels.names", unknown)
    points, values = _read_rows(table, "points", (*_ROWS, "by_errors"), states, refuse)
    where, rows = "evenness.points.by_errors", len(points.names)
    point_errors = matrix(values["by_errors"], where, PLAIN, (rows, None), refuse)
    gain = gain_of_error(table["L"], "evenness.L", refuse)
    if "excess_deviation" not in contents.data:
        refuse("excess_deviation", "expected this field, got none")
    return Evenness(EVENNESS_COSTS[name](price), channels, points, point_errors, gain)


def evenness_lines(mpc: "MPC", cost: AbstractEvennessCost, points: EvenPoints) -> list[str]:
    """Returns the lines of the table."""
    # Channels with limits stand with these.
    limited, watched = len(mpc.temperature_limits), mpc.watched
    C, at = np.asarray(watched.C)[limited:], np.asarray(watched.at)[limited:]
    return [
        "",
        "[evenness]",
        f"cost = {json.dumps(cost.name)}",
        f'energy_price = "{cost.energy_price!r} K"',
        f"L = {float(np.asarray(watched.L)[0])!r}",
        *_row_lines("channels", mpc.read_channels[limited:], C, at),
        *_row_lines("points", mpc.point_names, points.C, points.at),
        f"by_errors = {as_matrix(points.by_errors, PLAIN)}",
    ]


def _row_lines(part: str, names: tuple[str, ...], C: object, at: object) -> list[str]:
    return [
        "",
        f"[evenness.{part}]",
        f"names = {json.dumps(names)}",
        f"operating_point = {as_celsius(at)}",
        f"C = {as_matrix(C, PER_STATE)}",
    ]


def _read_rows(
    table: dict[str, Any], part: str, fields: tuple[str, ...], states: int, refuse: Refuse
) -> tuple[EvenRows, dict[str, Any]]:
    where = f"evenness.{part}"
    values = read_table(table[part], where, refuse, fields)
    names = values["names"]
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not is_list or len(set(names)) < len(names):
        refuse(f"{where}.names", f"expected names, each once, got {names!r}")
    at = temperatures_of(values["operating_point"], f"{where}.operating_point", len(names), refuse)
    C = matrix(values["C"], f"{where}.C", PER_STATE, (len(names), states), refuse)
    return EvenRows(names, C, np.array(at)), values


def mpc_settings(controller: type[AbstractController], contents: FileContents) -> dict[str, Any]:
    """Reads the settings of an `MPC` that are no part of its model.

    **Raises:** `ControlError` that names the field.
    """
    preview = contents.data.get("preview", False)
    if not isinstance(preview, bool):
        contents.refuse("preview", f"expected true or false, got {preview!r}")
    return {
        **field_settings(controller, contents),
        "horizon": contents.data["horizon"],
        "control_horizon": contents.data.get("control_horizon"),
        "preview": preview,
    }


def mpc_lines(mpc: "MPC") -> list[str]:
    """Returns the lines of the operating point, the settings, the limits, and the model."""
    values = {name: getattr(mpc, name) for name, field in mpc.fields.items() if not field.is_own}
    # Each channel with limits states its own.
    values["excess_deviation"] = None if mpc.points is None else mpc.excess_deviation[-1]
    tables: list[str] = []
    for row, (name, limit) in enumerate(mpc.temperature_limits):
        C, at, gain = (np.asarray(part)[row] for part in mpc.watched[:3])
        tables += limit_lines(name, limit, float(at), C, float(gain))
    if mpc.points is not None and mpc.evenness is not None:
        tables += evenness_lines(mpc, mpc.evenness, mpc.points)
    return [
        *point_lines(mpc.model.operating_point),
        f"horizon = {mpc.horizon}",
        f"control_horizon = {mpc.control_horizon}",
        f"preview = {json.dumps(mpc.preview)}",
        *(
            f"{name} = {as_quantity(value, mpc.fields[name].quantity)}"
            for name, value in values.items()
            if value is not None
        ),
        *tables,
        *model_lines(mpc.model, mpc.kalman),
    ]
