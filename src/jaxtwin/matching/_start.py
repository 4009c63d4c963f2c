"""How a recording begins: its first sample, the parameters that say so, and the start of a run.

- `FirstSample`: the first readings and the recorded ambient temperature.
- `room_parameters`, `plate_parameters`, `hidden_parameters`: the parameters that are temperatures
  at the start, of the room, of the plate, and of what no reading shows.
- `RunStart`: the temperatures with which the runs of a match begin, for compiled code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._celsius import ZERO_CELSIUS
from ..io import Experiment
from ..physics import System, Twin
from ..rig import Rig, Value
from ..simulation import CheckedInitial, Drive, TimeGrid, initial_temperatures, keeps_symmetry


@final
@dataclass(frozen=True)
class FirstSample:
    """The temperatures with which a recording begins, degC.

    - `reading`: the mean over the channels of the first reading of each.
    - `ambient`: the recorded ambient temperature; None if the recording has none.
    """

    reading: float
    ambient: float | None = None


def first_sample(experiment: Experiment) -> FirstSample:
    """The first sample of a recording that has temperatures."""
    ambient = experiment.ambient
    return FirstSample(
        reading=float(np.nanmean(first_readings(experiment))),
        ambient=None if ambient is None else float(np.ravel(ambient)[0]),
    )


def first_readings(experiment: Experiment) -> Float[np.ndarray, " channels"]:
    """The first reading of each channel that is not missing, degC; NaN if all are missing.

    A glitch is not taken for the temperature at the start, from which everything would follow.
    """
    readings = experiment.without_glitches()
    assert readings.temperatures is not None
    rows = readings.sampled.argmax(axis=0)
    return readings.temperatures[rows, np.arange(len(rows))]


def names_in(*values: Value | None) -> frozenset[str]:
    """Names of the parameters on which some values depend."""
    return frozenset(name for value in values if value is not None for name, _ in value.powers)


def room_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the room temperature at the start, if a recording
    holds none."""
    return names_in(rig.ambient_temperature)


def plate_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the plate's temperature at the start, unless they are
    those of the room."""
    return names_in(rig.initial_temperature) - room_parameters(rig)


def hidden_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the temperatures of sinks, bodies and cells at the
    start; not those of room or plate."""
    starts = [
        value for c in rig.cells for value in (c.initial_temperature, c.sink_initial_temperature)
    ]
    starts += [body.initial_temperature for body in rig.bodies]
    starts += [value for _, value in rig.initial_nodes]
    return names_in(*starts) - room_parameters(rig) - plate_parameters(rig)


def starts_without_effect(twin: Twin, initial: CheckedInitial) -> frozenset[str]:
    """Names of the parameters of temperatures at the start that have no effect, because these
    temperatures are given."""
    starts = plate_parameters(twin.rig) | hidden_parameters(twin.rig)
    if initial is None:
        return frozenset()
    if isinstance(initial, str):
        return starts
    given = np.broadcast_to(~np.isnan(np.asarray(initial)), len(twin.netlist.nodes))
    others = [
        node.initial_temperature
        for node, is_given in zip(twin.netlist.nodes, given, strict=True)
        if not is_given
    ]
    return starts - names_in(*others)


def replaced_by_recorded_room(rig: Rig) -> frozenset[str]:
    """Names of the parameters that have no effect on a recording that holds an ambient
    temperature."""
    own = names_in(rig.ambient_temperature, rig.ambient_drift)
    others = [rig.initial_temperature]
    for cell in rig.cells:
        others += [cell.initial_temperature, cell.sink_initial_temperature]
    for body in rig.bodies:
        others += [body.initial_temperature, body.temperature]
    others += [value for _, value in rig.initial_nodes]
    return own - names_in(*others)


def room_temperature(rig: Rig, values_si: Mapping[str, float], recorded: float | None) -> float:
    """The room temperature at the start, degC: the recorded one, or that of the twin."""
    if recorded is not None:
        return recorded
    return float(rig.ambient_temperature.evaluate(values_si)) - ZERO_CELSIUS


@final
class RunStart(eqx.Module):
    """The start of all runs: that of the rig by default.

    - `temperatures`: a temperature for each node or a single one, K; None for none.
    - `is_steady`: whether runs begin in the steady state under the first input.
    """

    temperatures: Float[np.ndarray | Array, "*descents starts"] | None
    is_steady: bool = eqx.field(static=True)

    @classmethod
    def of(cls, initial: CheckedInitial) -> "RunStart":
        """The start that `checked_initial` found."""
        if isinstance(initial, str):
            return cls(None, is_steady=True)
        return cls(None if initial is None else np.asarray(initial), is_steady=False)

    @property
    def is_lumped(self) -> bool:
        """Whether equal nodes begin alike, so that a lumped system is sufficient."""
        return keeps_symmetry(self._initial)

    def node_temperatures(self, system: System, grid: TimeGrid) -> Float[Array, " nodes"]:
        """The absolute temperatures of the nodes at the start, K."""
        if self._initial is None:
            return system.initial_temperature
        reference = Drive.of(system, grid).reference
        return initial_temperatures(system, self._initial, grid.summary().first, reference)

    @property
    def _initial(self) -> CheckedInitial:
        return "steady" if self.is_steady else self.temperatures


OF_THE_RIG = RunStart(None, is_steady=False)
