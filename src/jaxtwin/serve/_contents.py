"""The contents of frames: what was measured, what is estimated and what was found, for JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from .._json_values import json_value
from .._normal_distribution import QUANTILE_975
from ..observers._estimates import Estimate
from ..observers._moments import Moment
from ._outlook import Outlook

DIGITS = 3


def sample_content(
    time: float,
    measured: Float[np.ndarray, " channels"],
    expected: Float[np.ndarray, " channels"],
    band: Float[np.ndarray, " channels"],
    duty: Float[np.ndarray, " cells"],
    ambient: float | None,
) -> dict[str, Any]:
    """A reading beside what was expected of it. `time` is in s since 1970, `band` in K, all others
    in degC."""
    return {
        "t": round(time, DIGITS),
        "measured": rounded(measured),
        "expected": rounded(expected),
        "band": rounded(band),
        "duty": rounded(duty),
        "ambient": ambient,
    }


def outlook_content(
    found: Outlook,
    elements: int,
    time: float,
    times: Sequence[float],
    energy: float,
    parameters: Estimate,
) -> dict[str, Any]:
    """What a twin says of the rig, each estimate with half of its 95 % band.

    **Arguments:**

    - `found`: the estimates and the forecast.
    - `elements`: the number of nodes that are elements of the plate, which are the first ones.
    - `time`, `times`: now, and the times of the forecast, s since 1970.
    - `energy`: what the cells have drawn since the server began, J.
    - `parameters`: the uncertain parameters of the twin, in the units of the rig's table.
    """
    now, later = found.now, found.later
    heats, heats_band = _both(now.heats)
    room, room_band = _both(now.room)
    nodes, nodes_band = _both(now.nodes)
    forecast, forecast_band = _both(found.readings)
    nodes_later = rounded(later.nodes.mean)
    return {
        "t": round(time, DIGITS),
        "elements": nodes[:elements],
        "elements_later": nodes_later[:elements],
        "nodes": nodes[elements:],
        "nodes_band": nodes_band[elements:],
        "nodes_later": nodes_later[elements:],
        "channels": rounded(now.channels.mean),
        "channels_later": rounded(later.channels.mean),
        "times": [round(one, DIGITS) for one in times],
        "forecast": forecast,
        "forecast_band": forecast_band,
        "room": room[0],
        "room_band": room_band[0],
        "heats": heats,
        "heats_band": heats_band,
        "power": rounded(found.power),
        "energy": round(energy, 1),
        "parameter": significant(parameters.mean),
        "parameter_lower": significant(parameters.lower),
        "parameter_upper": significant(parameters.upper),
    }


def rounded(values: Any) -> Any:
    """Numbers as lists, None where one is missing."""
    return json_value(np.round(np.asarray(values, float), DIGITS))


def significant(values: Any) -> Any:
    """The same with five digits, whatever the unit is."""
    numbers = np.asarray(values, float)
    sizes = np.abs(np.where(np.isfinite(numbers) & (numbers != 0), numbers, 1.0))
    unit = 10.0 ** (np.floor(np.log10(sizes)) - 4)
    # Divided by a whole power of ten, a number is written with as many digits as it has.
    whole = np.round(numbers / unit)
    return json_value(np.where(unit < 1, whole / np.round(1 / np.minimum(unit, 1.0)), whole * unit))


def _both(moment: Moment) -> tuple[list[Any], list[Any]]:
    return rounded(moment.mean), rounded(QUANTILE_975 * moment.spread)
