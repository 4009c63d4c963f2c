"""The state of a run at a time, about which a twin is linearised."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import finite_number
from ..._celsius import ZERO_CELSIUS
from ...errors import ControlError
from ...physics import Twin
from ...simulation import Run
from ...simulation._delay import lagged_duty
from ...simulation._input_levels import input_levels
from ...simulation._stepper import assembled


@runtime_checkable
class HasRun(Protocol):
    """A result that holds a run of the twin, such as a `ClosedLoopRun`."""

    @property
    def run(self) -> Run:
        """The run."""
        ...


class PointOfRun(NamedTuple):
    """A state of a rig, not at rest.

    - `nodes`: the temperatures of the nodes, degC.
    - `duty`: the duty that reaches the cells, -1 to 1.
    - `ambient`: the temperature of the surroundings, degC.
    - `levels`: the rig's other inputs, as numbers (`input_levels`); None for a rig without any.
    """

    nodes: Float[Array | np.ndarray, " nodes"]
    duty: Float[Array | np.ndarray, " cells"]
    ambient: Float[Array | np.ndarray, ""]
    levels: Float[Array | np.ndarray, " inputs"] | None


def point_of_run(twin: Twin, run: Run, time: Any, ambient: float | int | None) -> PointOfRun:
    """The state of a run at a time, s.

    **Arguments:**

    - `ambient`: the ambient temperature, degC; None for that of the run.

    **Raises:** `ControlError` if the run has other nodes than the twin, or the time is outside
    of it.
    """
    names = tuple(node.name for node in twin.netlist.nodes)
    if run.nodes != names:
        raise ControlError(
            f"linearize: run: expected a run of {twin.rig.name}, whose nodes begin with "
            f"{', '.join(names[:3])}, got one of {run.rig}"
        )
    at = finite_number("linearize: time", time, ControlError)
    times = run.time
    if not times[0] <= at <= times[-1]:
        raise ControlError(
            f"linearize: time: expected {times[0]:g} to {times[-1]:g} s, the times of the run, got "
            f"{at:g} s"
        )
    experiment, system = run.experiment, assembled(twin)
    now = int(np.searchsorted(times, at, side="right")) - 1
    recorded = experiment.ambient
    if ambient is not None:
        room = float(ambient)
    elif recorded is not None:
        room = float(np.broadcast_to(np.asarray(recorded, float), times.shape)[now])
    else:
        drift = 0.0 if system.ambient_drift is None else float(system.ambient_drift)
        room = float(system.ambient_temperature) - ZERO_CELSIUS + drift * (at - float(times[0]))
    duty = np.asarray(experiment.duty, float)[now]
    if system.lag is not None:
        duty = lagged_duty(
            system.lag,
            system.delay,
            jnp.asarray(times),
            jnp.asarray(experiment.duty),
            jnp.asarray([at]),
            run.is_steady_start,
        )[0]
    nodes = np.array([np.interp(at, times, column) for column in run.states.T])
    levels = input_levels(experiment, twin.rig.inputs)
    return PointOfRun(nodes, duty, np.asarray(room), None if levels is None else levels[now])
