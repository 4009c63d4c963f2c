"""The table of a controller file that describes points which are to be even.

```toml
[evenness]
cost = "range"
energy_price = "0.0 K"
L = 0.2            # of the filter of the errors of the model at the channels

[evenness.channels]   # that are read, but for those with temperature limits
names = ["T11", "T12"]
operating_point = ["43.0 degC", "46.3 degC"]
C = { unit = "K", rows = [[...], [...]] }

[evenness.points]
names = ["V11", "V12", "V13"]
operating_point = ["48.4 degC", "49.1 degC", "48.4 degC"]
C = { unit = "K", rows = [[...], [...], [...]] }
by_errors = [[...], [...], [...]]   # limited channels first
```
"""

import json
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._name_suggestions import did_you_mean, unknown_name
from ...rig._units import Kind
from ._condensed_program import WatchedChannels
from ._controller_fields import FileContents, Refuse, as_matrix, matrix, quantity
from ._evenness import EVENNESS_COSTS, AbstractEvennessCost
from ._file_model import (
    NOT_EVEN,
    PER_STATE,
    PLAIN,
    FileEvenness,
    as_celsius,
    gain_of_error,
    read_table,
    temperatures_of,
)
from ._plant import Temperatures

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
    own = Temperatures(np.asarray(watched.C)[limited:], np.asarray(watched.at)[limited:])
    return [
        "",
        "[evenness]",
        f"cost = {json.dumps(cost.name)}",
        f'energy_price = "{cost.energy_price!r} K"',
        f"L = {float(np.asarray(watched.L)[0])!r}",
        *_row_lines("channels", channels[limited:], own),
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
