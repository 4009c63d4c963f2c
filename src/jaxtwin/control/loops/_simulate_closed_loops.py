"""Simulates many closed loops in chunks of draws, of which only measures are kept."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..._arguments import mapping_of, names_of, whole_number
from ..._compilation import persistent_jit, persistent_jit_unoptimised
from ..._jax_settings import in_precision, own_settings
from ..._name_suggestions import unknown_name
from ..._progress import announced
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Fault, System, Twin
from ...rig import Rig, check_has_plate
from ...simulation import (
    Precision,
    Reductions,
    Stepper,
    assembled,
    check_draw,
    check_values,
    checked_draws,
    checked_precision,
    is_multiple,
    valid_draws,
    work_in_chunks,
)
from ..controllers._controller import AbstractController, parameter_names, with_values
from ..controllers._function_controller import ControlFunction, as_controller
from ._closed_loop import run_loop
from ._measures import MEASURES, OF_PLATE, ClosedLoop, Measure, measures_of, units_of
from ._scenario import Scenario, scenario

# Simulates many closed loops, in chunks of draws, of which only measures are kept.

# The number of loops that a core computes at a time. With 64, a step of a loop costs twice as much;
# with 512, no less.
MAX_CHUNK = 256

# The memory for the loops that a core computes at a time, before their measures are computed.
CHUNK_BYTES = 2**28


def twin_at_medians(twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]]) -> Twin:
    """Returns the twin with the medians of the drawn parameters over all valid draws, for checks
    before the simulation.

    **Raises:** `ParameterError` if no draw is valid, or without draws if the twin is not.
    """
    if not draws:
        check_values(twin)
        return twin
    is_valid = valid_draws(twin, draws)
    if not is_valid.any():
        check_draw(twin, draws, 0)
    return twin.with_values({name: float(np.median(v[is_valid])) for name, v in draws.items()})


def longest_delay(twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]]) -> float:
    """Returns the longest delay of the driver in all draws, s."""
    own, delay = assembled(twin).delay, twin.wiring.delay
    if own is None or delay is None:
        return 0.0
    if delay.names.isdisjoint(draws):
        return float(own)
    return float(_longest(twin, {name: np.asarray(v, float) for name, v in draws.items()}))


@persistent_jit_unoptimised
def _longest(
    twin: Twin, draws: Mapping[str, Float[Array | np.ndarray, " draws"]]
) -> Float[Array, ""]:
    def delay(values: Mapping[str, Array]) -> Array:
        result = twin.with_values(values).system().delay
        return jnp.zeros(()) if result is None else result

    return jnp.max(jax.vmap(delay)({name: jnp.asarray(v) for name, v in draws.items()}))


def simulate_many_loops(
    twin: Twin,
    controller: AbstractController,
    scenario: Scenario,
    *,
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    controller_draws: Mapping[str, Float[np.ndarray, "draws ..."]],
    count: int,
    measures: Mapping[str, Measure],
    precision: Precision,
    workers: int | None,
    fault: Fault | None = None,
) -> Reductions:
    """Simulates `count` loops, with a draw of the plant, of the controller or of both in each.

    The arguments have been checked by `simulate_closed_loops`; `scenario` allows for the longest
    delay of all draws. A fault changes the equations of each draw, from the start.
    """
    dtype = jnp.float32 if precision == "float32" else jnp.float64
    whole = is_whole_delay(twin, draws, scenario.step)
    if not draws:
        # Loops that share a plant also get a copy each: products with a matrix for each draw take
        # three quarters of the time of products with a single matrix.
        name, value = next(iter(twin.values.items()))
        draws = {name: np.full(count, float(value))}
    rows = {f"plant {name}": np.asarray(values) for name, values in draws.items()}
    rows |= {f"controller {name}": values for name, values in controller_draws.items()}
    sizes = scenario.step, scenario.longest_delay

    def work(chunk: Mapping[str, np.ndarray]) -> Mapping[str, Array]:
        with own_settings():
            plant, loops = (
                {
                    name.removeprefix(kind): values
                    for name, values in chunk.items()
                    if name.startswith(kind)
                }
                for kind in ("plant ", "controller ")
            )
            if fault is None:
                steppers = steppers_of(twin, plant, *sizes, whole)
            else:
                # A fault is a closure, whose program could not be kept; as it is, all faults share
                # the programs before and after it.
                faulty = jax.vmap(fault)(_systems_of(twin, plant))
                steppers = _steppers_of_systems(faulty, *sizes, whole)
            steppers, fixed, varied = in_precision((steppers, scenario, loops), dtype)
            chosen = in_precision(controller, dtype)
            kept = tuple(measures.items())
            return _measured(steppers, chosen, varied, fixed, kept)

    loop_bytes = (
        jnp.dtype(dtype).itemsize * scenario.ambient.size * numbers_per_step(twin, scenario)
    )
    chunk_size = min(max(CHUNK_BYTES // loop_bytes, 1), MAX_CHUNK)
    if controller.needs_one_thread:
        workers = 1
    results = work_in_chunks(rows, work, chunk_size=chunk_size, workers=workers)
    # Energy and peak power are measures of the loop here, computed at every step of the plant.
    custom = {name: results[name] for name in measures}
    failed = results["failed"] | (scenario.switched_off is not None)
    return Reductions(twin.channels, failed, custom=custom, custom_units=units_of(measures))


def numbers_per_step(twin: Twin, scenario: Scenario) -> int:
    """Returns the number of values of a `ClosedLoop` at each step of the plant."""
    outputs, cells = len(scenario.output_weights), len(twin.netlist.cells)
    return 2 + len(twin.netlist.nodes) + len(twin.channels) + 3 * outputs + 2 * cells


def is_whole_delay(twin: Twin, drawn: Iterable[str], step: float) -> bool:
    """Whether the driver's delay is the same whole number of plant steps in all draws."""
    delay = twin.wiring.delay
    return delay is None or (
        delay.names.isdisjoint(drawn) and is_multiple(assembled(twin).delay, step)
    )


@persistent_jit_unoptimised
def steppers_of(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    step: float,
    longest_delay: float,
    is_whole_delay: bool,
) -> Stepper:
    """Makes a stepper for each draw; its numbers are NaN for invalid draws."""

    def stepper_of(values: Mapping[str, Array]) -> Stepper:
        return _stepper_of(twin.with_values(values), step, longest_delay, is_whole_delay)

    return jax.vmap(stepper_of)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit_unoptimised
def _systems_of(twin: Twin, draws: Mapping[str, Float[Array | np.ndarray, " chunk"]]) -> System:
    """Makes the equations of each draw."""

    def system_of(values: Mapping[str, Array]) -> System:
        return twin.with_values(values).system()

    return jax.vmap(system_of)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit_unoptimised
def _steppers_of_systems(
    systems: System, step: float, longest_delay: float, is_whole_delay: bool
) -> Stepper:
    """Makes a stepper for each of several equations."""

    def stepper_of(system: System) -> Stepper:
        return _stepper_of(system, step, longest_delay, is_whole_delay)

    return jax.vmap(stepper_of)(systems)


def _stepper_of(
    twin: Twin | System, step: float, longest_delay: float, is_whole_delay: bool
) -> Stepper:
    """Makes a stepper, whose numbers are NaN if no rig can have the values."""
    stepper = Stepper(twin, step, longest_delay=longest_delay, is_whole_delay=is_whole_delay)
    valid = stepper.system.is_valid

    def marked(leaf: Array) -> Array:
        is_real = jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.where(valid, leaf, jnp.nan) if is_real else leaf

    return jax.tree.map(marked, stepper)


@persistent_jit
def _measured(
    steppers: Stepper,
    controller: AbstractController,
    varied: Mapping[str, Float[Array | np.ndarray, "chunk ..."]],
    scenario: Scenario,
    measures: tuple[tuple[str, Measure], ...],
) -> dict[str, Array]:
    """Computes the measures of a chunk of loops, each with its stepper."""

    def of_draw(stepper: Stepper, values: Mapping[str, Array | np.ndarray]) -> dict[str, Array]:
        changed = with_values(controller, values)
        loop: ClosedLoop = run_loop(stepper, changed, scenario, single_precision_losses=True)
        result = {name: jnp.asarray(function(loop)) for name, function in measures}
        is_finite = loop.stays_finite
        result = {
            name: (
                jnp.where(is_finite, value, jnp.nan)
                if jnp.issubdtype(value.dtype, jnp.floating)
                else value
            )
            for name, value in result.items()
        }
        return {**result, "failed": ~is_finite}

    return jax.vmap(of_draw)(steppers, dict(varied))


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
