"""Whether a recording can be one of the rig: units that were taken for others, first of all."""

from collections.abc import Iterable

import numpy as np

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter, Rig, Value
from ._first_sample import first_sample
from ._starting_parameters import ABSOLUTE_ZERO, room_temperature

FIRST_SAMPLES = 50
"""The number of samples at the start that are looked at, of all channels together."""

NEAR_KELVIN = 60.0
"""How far from the room the first reading of a recording in kelvin is at most, K: a warm rig."""

BEYOND_BOUNDS = 5.0
"""How far the first reading may lie outside the bounds of the plate's temperature at the start, K:
sensors err, and a plate may be uneven."""


def check_units(twin: Twin, name: str, experiment: Experiment) -> None:
    """Refuses a recording in kelvin that says degC: its first readings are 273 K above a room.

    **Raises:** `MatchError` that names the recording and its first reading.
    """
    assert experiment.temperatures is not None, "named_recordings has checked it"
    # A median, because the first sample of all may be a wrong one.
    first = float(np.median(experiment.temperatures[experiment.sampled][:FIRST_SAMPLES]))
    recorded = first_sample(experiment).ambient
    start = room_temperature(twin.rig, twin.numbers_si, recorded)
    celsius = first + ABSOLUTE_ZERO
    if abs(celsius - start) < NEAR_KELVIN and abs(first - start) > NEAR_KELVIN:
        raise MatchError(
            f"{name}: temperatures: expected degC, got {first:.1f} degC at the start in a room of "
            f"{start:.0f} degC; are they in K, {celsius:.1f} degC? A column of kelvin is called "
            "NAME_K"
        )


def check_without_gap(name: str, experiment: Experiment) -> None:
    """Refuses a recording with lost samples.

    **Raises:** `MatchError` that names the recording and the gap.
    """
    if len(experiment.gaps):
        start, end = experiment.gaps[0]
        raise MatchError(
            f"{name}: expected no gap in the times, got one from {start:g} s to {end:g} s; "
            "Experiment.parts are the parts between gaps"
        )


def check_start(rig: Rig, free: Iterable[Parameter], name: str, experiment: Experiment) -> None:
    """Refuses a recording that begins where the bounds do not let the twin begin.

    A free parameter that is by itself the temperature of the plate at the start, such as `T_start`
    of the bundled rigs, is checked.

    **Raises:** `MatchError` that names the recording, the parameter and its bounds.
    """
    first = first_sample(experiment).reading
    for row in free:
        if rig.initial_temperature != Value(1.0, ((row.name, 1.0),)):
            continue
        lower, upper = (row.to_si(bound) + ABSOLUTE_ZERO for bound in (row.lower, row.upper))
        if not lower - BEYOND_BOUNDS <= first <= upper + BEYOND_BOUNDS:
            raise MatchError(
                f"{name}: temperatures: expected a start within the bounds of {row.name}, "
                f"{lower:g} to {upper:g} degC, got {first:.1f} degC; other bounds are given by "
                f'bounds={{"{row.name}": (lowest, highest)}}'
            )
