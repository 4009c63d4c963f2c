"""Simulates a closed loop: checks the arguments, and labels the signals."""

from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from ..._jax_settings import own_settings
from ..._waiting import announced
from ...errors import ControlError, SimulationError
from ...matching import Fit
from ...matching._nominal_twin import nominal_twin
from ...physics import Twin
from ...simulation import Stepper
from ...simulation._check_values import check_values
from ..controllers._controller import AbstractController
from ..controllers._function_controller import ControlFunction, as_controller
from ._closed_loop import run_loop
from ._closed_loop_run import ClosedLoopRun
from ._scenario import scenario


@announced("closed loop")
def simulate_closed_loop(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    **settings: Any,
) -> ClosedLoopRun:
    """Simulates a controller on a twin. `simulate_closed_loops` does it for many draws.

    ```python
    pid = jaxtwin.control.PID(Kp=0.1, Ki=0.001)
    run = jt.simulate_closed_loop(twin, pid, "0:35,600:45", duration=1800)
    run.measures()
    ```

    The controller reads the channels at its sample time, with the noise that the rig file states.
    The commanded duty is rounded to the driver's counts. The plant is solved in the steps of
    `Stepper`, with the driver's delay and lag. If a reading is lost or NaN, the controller receives
    the last one again. After `silence` without a reading, the cells are off for the rest of the
    run, as `jaxtwin control` switches a rig off; `switched_off` of the result says from when on.

    **Arguments:**

    - `twin`: the twin; or a fit, whose recordings' own values are averaged (`Fit.mean_twin`), as in
      `linearize`.
    - `controller`: a controller; or a function `(time_s, reference, measurement) -> duty` in
      `jax.numpy`, whose outputs are all channels.
    - `references`: the references of the outputs, degC: a number; text such as `"0:35,600:45"`,
      `"0:35/37"`, or with changes that take time `"0:16,ramp 600:40"` and the smooth
      `"0:16,curve 600:40"`; or an array `(outputs,)` or `(samples, outputs)`.
    - `duration`: the duration, s, a multiple of the controller's sample time.
    - `settings`: the further keywords of `jaxtwin.control.scenario`: disturbances, noise, faults,
      delays.

    **Returns:** a `ClosedLoopRun`.

    **Raises:** `ControlError` if twin, controller, references and settings do not fit each other,
    or if a reference is out of reach; `ParameterError` for an invalid parameter of the twin;
    `SimulationError` if the temperatures or the duty do not stay finite.
    """
    where = "simulate_closed_loop"
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    check_values(plant)
    sample_time = settings.pop("sample_time_s", None)
    chosen = as_controller(f"{where}: controller", controller, plant.rig, sample_time)
    conditions = scenario(plant, chosen, references, duration=duration, **settings)
    with own_settings():
        stepper = Stepper(plant, conditions.step, longest_delay=conditions.longest_delay)
        loop = jax.tree.map(np.asarray, run_loop(stepper, chosen, conditions))
    if not (np.isfinite(loop.nodes).all() and np.isfinite(loop.duty).all()):
        raise SimulationError(
            f"{plant.rig.name}: closed loop: the temperatures or the duty do not stay finite; look "
            "at the controller's parameters"
        )
    ambient = np.asarray(conditions.ambient).reshape(-1)[: len(loop.time)]
    names = chosen.output_names(plant.channels)
    limits, off = chosen.channel_limits(), conditions.switched_off
    return ClosedLoopRun.of(plant, loop, names, ambient, limits, off, is_linear=chosen.is_linear)
