"""The public function for closed loops: it checks its arguments, and labels the results."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, overload

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..._arguments import mapping_of, names_of, whole_number
from ..._errors import ControlError, SimulationError
from ..._jax_settings import own_settings
from ..._name_suggestions import unknown_name
from ..._waiting import announced
from ...matching import Fit
from ...matching._nominal_twin import nominal_twin
from ...physics import Twin
from ...simulation import Precision, Reductions, Stepper
from ...simulation._simulate_batch import checked_draws, checked_precision
from ..controllers._controller import AbstractController, parameter_names, with_values
from ..controllers._function_controller import ControlFunction, as_controller
from ._closed_loop import run_loop
from ._closed_loop_run import ClosedLoopRun
from ._many_loops import longest_delay, simulate_many_loops, twin_at_medians
from ._measures import MEASURES, Measure
from ._scenario import scenario


@overload
def simulate_closed_loop(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration_s: float | int,
    draws: None = None,
    controller_draws: None = None,
    **settings: Any,
) -> ClosedLoopRun: ...


@overload
def simulate_closed_loop(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration_s: float | int,
    draws: Mapping[str, ArrayLike] | None = None,
    controller_draws: Mapping[str, ArrayLike] | None = None,
    measures: Iterable[str] | Mapping[str, Measure] | None = None,
    precision: Precision = "float64",
    workers: int | None = None,
    **settings: Any,
) -> Reductions: ...


@announced("closed loop")
def simulate_closed_loop(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration_s: float | int,
    draws: Mapping[str, ArrayLike] | None = None,
    controller_draws: Mapping[str, ArrayLike] | None = None,
    measures: Iterable[str] | Mapping[str, Measure] | None = None,
    precision: Precision = "float64",
    workers: int | None = None,
    **settings: Any,
) -> ClosedLoopRun | Reductions:
    """Simulates a controller on a twin.

    ```python
    pid = jaxtwin.control.PID(Kp=0.1, Ki=0.001)
    run = jt.simulate_closed_loop(twin, pid, "0:35,600:45", duration_s=1800)
    run.measures()
    ```

    The controller reads the channels at its sample time, with the noise that the rig file states.
    The commanded duty is rounded to the driver's counts. The plant is solved in the steps of
    `Stepper`, with the driver's delay and lag. If a reading is lost or NaN, the controller receives
    the last one again. After `silence_s` without a reading, the cells are off for the rest of the
    run, as `jaxtwin control` switches a rig off.

    **Arguments:**

    - `twin`: the twin; or a fit, whose recordings' own values are averaged (`Fit.mean_twin`), as in
      `linearize`.
    - `controller`: a controller; or a function `(time_s, reference, measurement) -> duty` in
      `jax.numpy`, whose outputs are all channels.
    - `references`: the references of the outputs, degC: a number, text such as `"0:35,600:45"` or
      `"0:35/37"`, or an array `(outputs,)` or `(samples, outputs)`.
    - `duration_s`: the duration, s, a multiple of the controller's sample time.
    - `draws`: for many loops, parameter of the twin -> values `(draws,)` in the unit of the rig's
      table.
    - `controller_draws`: for many loops, parameter of the controller, such as `"Kp"` -> values
      `(draws, ...)`.
    - `measures`: the measures that are kept of many loops: names of `jaxtwin.control.MEASURES`, or
      name -> a pure JAX function of a `ClosedLoop`. None for all of `MEASURES`.
    - `precision`: the precision of many loops. Nonlinear losses of the plate are always computed in
      float32, with an error below a microkelvin.
    - `workers`: the number of threads for many loops, None for one for each core.
    - `settings`: the further keywords of `jaxtwin.control.scenario`: disturbances, noise, faults,
      delays.

    **Returns:** a `ClosedLoopRun`; or, for many loops, `Reductions` with the measures, those of
    `MEASURES` with their units.

    **Raises:** `ControlError` if twin, controller, references and settings do not fit each other,
    or if a reference is out of reach; `ParameterError` for an invalid parameter of the twin;
    `SimulationError` if the temperatures or the duty of a single loop do not stay finite.
    """
    plant = nominal_twin("simulate_closed_loop: twin", twin, ControlError)
    chosen = as_controller(
        "simulate_closed_loop: controller", controller, settings.pop("sample_time_s", None)
    )
    plant_draws = _checked_plant_draws(plant, draws, controller_draws)
    drawn = _checked_controller_draws(chosen, controller_draws)
    count = _count(plant_draws, drawn)
    if workers is not None:
        whole_number("simulate_closed_loop: workers", workers, 1, ControlError)
    median_twin = twin_at_medians(plant, plant_draws)
    first = _first_drawn(chosen, drawn) if drawn else chosen
    conditions = scenario(median_twin, first, references, duration_s=duration_s, **settings)
    with own_settings():
        if count is not None:
            conditions = replace(
                conditions, longest_delay_s=longest_delay(median_twin, plant_draws)
            )
            return simulate_many_loops(
                median_twin,
                chosen,
                conditions,
                draws=plant_draws,
                controller_draws=drawn,
                count=count,
                measures=_checked_measures(measures),
                precision=checked_precision(precision, ControlError),
                workers=workers,
            )
        for name, value in (("measures", measures), ("workers", workers)):
            if value is not None:
                raise ControlError(
                    f"simulate_closed_loop: {name}: expected only beside draws or "
                    f"controller_draws, got {value!r}"
                )
        stepper = Stepper(median_twin, conditions.step_s, longest_delay=conditions.longest_delay_s)
        loop = jax.tree.map(np.asarray, run_loop(stepper, chosen, conditions))
    if not (np.isfinite(loop.nodes).all() and np.isfinite(loop.duty).all()):
        raise SimulationError(
            f"{plant.rig.name}: closed loop: the temperatures or the duty do not stay finite; look "
            "at the controller's parameters"
        )
    weights = np.asarray(conditions.output_weights)
    ambient = np.asarray(conditions.ambient).reshape(-1)[: len(loop.time)]
    return ClosedLoopRun.of(plant, loop, _output_names(weights, plant.channels), ambient)


def _output_names(
    weights: Float[np.ndarray, "outputs channels"], channels: Sequence[str]
) -> tuple[str, ...]:
    names = []
    for row in weights:
        counted = [channel for channel, weight in zip(channels, row, strict=True) if weight]
        everything = len(counted) == len(channels) > 1
        names.append("mean of all" if everything else " ".join(counted))
    return tuple(names)


def _checked_plant_draws(
    twin: Twin,
    draws: Mapping[str, ArrayLike] | None,
    controller_draws: Mapping[str, ArrayLike] | None,
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Checks the draws of the twin's parameters; empty if none are drawn."""
    if draws is not None and not draws and not controller_draws:
        raise ControlError("simulate_closed_loop: draws: expected name -> values, got none")
    return checked_draws(twin, draws) if draws else {}


def _checked_controller_draws(
    controller: AbstractController, draws: Mapping[str, ArrayLike] | None
) -> dict[str, Float[np.ndarray, "..."]]:
    """Checks the draws of the controller's parameters, each `(draws, ...)`; empty if none are
    drawn."""
    if draws is None:
        return {}
    where = "simulate_closed_loop: controller_draws"
    mapping_of(where, draws, "name -> values", ControlError)
    known, checked = parameter_names(controller), {}
    for name, values in draws.items():
        if name not in known:
            raise ControlError(f"{where}: {unknown_name('parameter', name, known)}")
        array = np.asarray(values)
        is_number = array.dtype.kind in "iuf" and np.isfinite(array).all()
        if array.ndim == 0 or array.size == 0 or not is_number:
            raise ControlError(
                f"{where}: {name}: expected finite numbers (draws, ...), got {values!r}"
            )
        checked[name] = array.astype(float)
    return checked


def _count(
    draws: Mapping[str, Float[np.ndarray, "..."]],
    controller_draws: Mapping[str, Float[np.ndarray, "..."]],
) -> int | None:
    """Returns the number of loops; None for a single one without draws."""
    lengths = {name: len(values) for name, values in (*draws.items(), *controller_draws.items())}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ControlError(
            f"simulate_closed_loop: draws: expected the same number of draws for each, got {found}"
        )
    return next(iter(lengths.values()), None)


def _first_drawn(
    controller: AbstractController, draws: Mapping[str, Float[np.ndarray, "draws ..."]]
) -> AbstractController:
    """Checks the parameters of the controller in each draw, and returns the controller with those
    of the first.

    **Raises:** `ControlError` that names the draw by its number, counted from 0.
    """
    for number in range(len(next(iter(draws.values())))):
        try:
            controller.check_parameters(
                **{name: values[number].tolist() for name, values in draws.items()}
            )
        except ControlError as problem:
            raise ControlError(
                f"simulate_closed_loop: controller_draws: draw {number}: {problem}"
            ) from None
    return with_values(controller, {name: np.asarray(v[0]) for name, v in draws.items()})


def _checked_measures(
    measures: Iterable[str] | Mapping[str, Measure] | None,
) -> dict[str, Measure]:
    if measures is None:
        return {name: function for name, (function, _) in MEASURES.items()}
    where = "simulate_closed_loop: measures"
    if isinstance(measures, Mapping):
        for name, function in measures.items():
            if not callable(function) or name == "failed":
                raise ControlError(
                    f"{where}: {name}: expected a JAX function of a ClosedLoop, got {function!r}"
                )
        return dict(measures)
    names = names_of(where, measures, ControlError)
    for name in names:
        if name not in MEASURES:
            raise ControlError(f"{where}: {unknown_name('measure', name, MEASURES)}")
    return {name: MEASURES[name][0] for name in names}
