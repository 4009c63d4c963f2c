"""Simulates many closed loops: checks the draws and the measures that are kept."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..._arguments import mapping_of, names_of, whole_number
from ..._jax_settings import own_settings
from ..._name_suggestions import unknown_name
from ..._waiting import announced
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...rig import Rig, check_has_plate
from ...simulation import Precision, Reductions, checked_draws, checked_precision
from ..controllers._controller import AbstractController, parameter_names, with_values
from ..controllers._function_controller import ControlFunction, as_controller
from ._many_loops import longest_delay, simulate_many_loops, twin_at_medians
from ._measures import MEASURES, OF_PLATE, Measure, measures_of
from ._scenario import scenario

# The function, in messages.
WHERE = "simulate_closed_loops"


@announced("closed loops")
def simulate_closed_loops(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    draws: Mapping[str, ArrayLike] | None = None,
    controller_draws: Mapping[str, ArrayLike] | None = None,
    measures: Iterable[str] | Mapping[str, Measure] | None = None,
    precision: Precision = "float64",
    workers: int | None = None,
    **settings: Any,
) -> Reductions:
    """Simulates the loop of `simulate_closed_loop` for many draws of the twin, of the controller,
    or of both, and keeps measures of each loop.

    ```python
    pid = jaxtwin.control.PID(Kp=0.1, Ki=0.001)
    loops = jt.simulate_closed_loops(twin, pid, 35, duration=600, draws={"R_E": [1.9, 2.0, 2.1]})
    loops["settling_time"]
    ```

    **Arguments:**

    - `twin`, `controller`, `references`, `duration`: as in `simulate_closed_loop`.
    - `draws`: parameter of the twin -> values `(draws,)` in the unit of the rig's table.
    - `controller_draws`: parameter of the controller, such as `"Kp"` -> values `(draws, ...)`.
    - `measures`: names of `jaxtwin.control.MEASURES`, or name -> a pure JAX function of a
      `ClosedLoop`. None for all of `MEASURES`.
    - `precision`: the precision of the loops. Nonlinear losses of the plate are always computed in
      float32, with an error below a microkelvin.
    - `workers`: the number of threads, None for one for each core.
    - `settings`: the further keywords of `jaxtwin.control.scenario`, the same for all loops.

    **Returns:** `Reductions` with the measures, those of `MEASURES` with their units. A loop that
    does not stay finite, whose draw no rig can have, or whose cells are switched off for want of
    readings, is marked in `failed`.

    **Raises:** `ControlError` if nothing is drawn, or if twin, controller, references, draws and
    settings do not fit each other; `ParameterError` if no draw of the twin is valid.
    """
    plant = nominal_twin(f"{WHERE}: twin", twin, ControlError)
    sample_time = settings.pop("sample_time_s", None)
    chosen = as_controller(f"{WHERE}: controller", controller, plant.rig, sample_time)
    plant_draws = checked_draws(plant, draws) if draws else {}
    drawn = _checked_controller_draws(chosen, controller_draws)
    count = _count(plant_draws, drawn)
    if workers is not None:
        whole_number(f"{WHERE}: workers", workers, 1, ControlError)
    median_twin = twin_at_medians(plant, plant_draws)
    first = _first_drawn(chosen, drawn) if drawn else chosen
    conditions = scenario(median_twin, first, references, duration=duration, **settings)
    with own_settings():
        longest = longest_delay(median_twin, plant_draws)
        return simulate_many_loops(
            median_twin,
            chosen,
            replace(conditions, longest_delay=longest),
            draws=plant_draws,
            controller_draws=drawn,
            count=count,
            measures=_checked_measures(measures, plant.rig),
            precision=checked_precision(precision, ControlError),
            workers=workers,
        )


def _checked_controller_draws(
    controller: AbstractController, draws: Mapping[str, ArrayLike] | None
) -> dict[str, Float[np.ndarray, "..."]]:
    """Checks the draws of the controller's parameters, each `(draws, ...)`; empty if none are
    drawn."""
    if draws is None:
        return {}
    where = f"{WHERE}: controller_draws"
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
) -> int:
    """Returns the number of loops."""
    lengths = {name: len(values) for name, values in (*draws.items(), *controller_draws.items())}
    if not lengths:
        raise ControlError(
            f"{WHERE}: expected draws or controller_draws, name -> values, got none; "
            "simulate_closed_loop simulates a single loop"
        )
    if len(set(lengths.values())) > 1:
        result = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ControlError(
            f"{WHERE}: draws: expected the same number of draws for each, got {result}"
        )
    return next(iter(lengths.values()))


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
            raise ControlError(f"{WHERE}: controller_draws: draw {number}: {problem}") from None
    return with_values(controller, {name: np.asarray(v[0]) for name, v in draws.items()})


def _checked_measures(
    measures: Iterable[str] | Mapping[str, Measure] | None, rig: Rig
) -> dict[str, Measure]:
    if measures is None:
        elements = len(rig.plate.element_names)
        return {name: function for name, (function, _) in measures_of(elements).items()}
    where = f"{WHERE}: measures"
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
        if name in OF_PLATE:
            check_has_plate(f"{where}: {name}", rig, ControlError)
    return {name: MEASURES[name][0] for name in names}
