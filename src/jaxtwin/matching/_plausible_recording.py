"""Whether a recording can be one of the rig: units that were taken for others, first of all."""

import numpy as np

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin

ZERO_CELSIUS = 273.15
FIRST_SAMPLES = 50
"""The number of samples at the start that are looked at, of all channels together."""

NEAR_KELVIN = 60.0
"""How far from the room the first reading of a recording in kelvin is at most, K: a warm rig."""


def check_units(twin: Twin, name: str, experiment: Experiment) -> None:
    """Refuses a recording in kelvin that says degC: its first readings are 273 K above a room.

    **Raises:** `MatchError` that names the recording and its first reading.
    """
    assert experiment.temperatures is not None, "named_recordings has checked it"
    room = experiment.ambient
    if room is None:
        # Without JAX, which would compile each operation.
        values = {name: float(np.mean(value)) for name, value in twin.values.items()}
        table = twin.rig.parameters
        values_si = {name: table[name].to_si(value) for name, value in values.items()}
        room = float(twin.rig.ambient_temperature.evaluate(values_si)) - ZERO_CELSIUS
    first = float(np.median(experiment.temperatures[experiment.sampled][:FIRST_SAMPLES]))
    start = float(np.asarray(room).flat[0])
    if abs(first - ZERO_CELSIUS - start) < NEAR_KELVIN and abs(first - start) > NEAR_KELVIN:
        raise MatchError(
            f"{name}: temperatures: expected degC, got {first:.1f} degC at the start in a room of "
            f"{start:.0f} degC; are they in K, {first - ZERO_CELSIUS:.1f} degC? A column of kelvin "
            "is called NAME_K"
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
