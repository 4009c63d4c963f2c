"""Many draws of a twin's parameters at once."""

import os
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, final, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._errors import ParameterError, SimulationError
from ..io import Experiment
from ..physics import System, Twin
from ._exponential import Modes, network_modes, reference_temperature, solve_schedule
from ._initial import Initial, checked_initial, initial_temperatures, keeps_symmetry
from ._schedule import Schedule, build_schedule
from ._simulate import checked_channels

Reduction = Literal["cost", "final", "minimum", "maximum", "spread", "deviation"]
REDUCTIONS: tuple[Reduction, ...] = (
    "cost",
    "final",
    "minimum",
    "maximum",
    "spread",
    "deviation",
)
Precision = Literal["float64", "float32"]

_LAPACK = threading.Lock()
# XLA's batched LAPACK kernels wait for the thread pool that they run on: two of them at once, on as
# many cores, wait for each other for ever (seen with jax 0.10.2). They spread over all cores
# themselves, so nothing is lost by letting one in at a time.

CHUNK_CPU = 64
"""Draws that one core works on at a time: their modes stay in its second-level cache."""

CHUNK_ACCELERATOR = 65536
"""Draws that an accelerator works on at a time: enough to fill it."""


@final
@dataclass(frozen=True)
class Reductions:
    """What was asked of many draws instead of their trajectories; None where it was not.

    - `channels`: names.
    - `cost`: mean squared error against the recording, eq. (11), `(draws, channels)`, K^2.
    - `final`: temperature at the end, `(draws, channels)`, degC.
    - `minimum`, `maximum`: over time, `(draws, channels)`, degC.
    - `spread`: largest minus smallest plate element at the end, `(draws,)`, K.
    - `deviation`: standard deviation over the plate's elements at the end, `(draws,)`, K.
    - `failed`: draws with a resistance or capacitance that is not above 0, or whose temperatures
      do not stay finite, `(draws,)`; their other entries are NaN.
    """

    channels: tuple[str, ...]
    failed: np.ndarray
    cost: Float[np.ndarray, "draws channels"] | None = None
    final: Float[np.ndarray, "draws channels"] | None = None
    minimum: Float[np.ndarray, "draws channels"] | None = None
    maximum: Float[np.ndarray, "draws channels"] | None = None
    spread: Float[np.ndarray, " draws"] | None = None
    deviation: Float[np.ndarray, " draws"] | None = None

    @property
    def rmse(self) -> Float[np.ndarray, " draws"]:
        """Over all channels, K.

        **Raises:** `SimulationError` where the cost was not asked for.
        """
        if self.cost is None:
            raise SimulationError('rmse: ask simulate_batch for reductions=["cost"]')
        return np.sqrt(self.cost.mean(axis=1))


@overload
def simulate_batch(
    twin: Twin,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"]: ...


@overload
def simulate_batch(
    twin: Twin,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: Iterable[Reduction],
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Reductions: ...


def simulate_batch(
    twin: Twin,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: Iterable[Reduction] | None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"] | Reductions:
    """Runs a twin through an experiment for many draws of its parameters.

    Draws are worked on in chunks by all cores, or by the accelerator where JAX has one. A draw that
    fails (a negative resistance, an overflow) becomes NaN and leaves the others alone.

    **Arguments:**

    - `twin`: what is not drawn keeps its values.
    - `experiment`: the inputs; with recorded temperatures where the cost is asked for.
    - `parameters`: name -> draws `(draws,)` in the unit of the rig's table.
    - `reductions`: some of "cost", "final", "minimum", "maximum", "spread", "deviation": computed
      where the draws are, so that no trajectory is kept. See `Reductions`.
    - `initial`: as in `simulate`.
    - `precision`: of the computation. Deviations from ambient keep float32 to about a millikelvin.
    - `chunk_size`: draws at a time, by default by the kind of device.
    - `workers`: threads that work on chunks, by default one a core on a CPU.
    - `on_progress`: called with the number of finished draws after each chunk.

    **Returns:** temperatures `(draws, times, channels)`, degC, for the channels that the experiment
    names, else all; or `Reductions`.

    **Raises:** `ParameterError` for unknown names, draws that are not one row of finite numbers or
    not equally many, or none; `SimulationError` where experiment and rig do not belong together,
    or the cost is asked for without recorded temperatures.
    """
    names = checked_channels(twin, experiment)
    start = checked_initial(twin, initial)
    draws = _checked_draws(twin, parameters)
    wanted = None if reductions is None else _checked_reductions(reductions, experiment)
    if precision not in ("float64", "float32"):
        raise SimulationError(f'precision: found {precision!r}, allowed is "float64" or "float32"')
    accelerated = jax.default_backend() != "cpu"
    count = len(next(iter(draws.values())))
    size = chunk_size or min(CHUNK_ACCELERATOR if accelerated else CHUNK_CPU, count)
    schedule = build_schedule(experiment)
    solve = partial(
        _solve_chunk,
        schedule=schedule,
        columns=np.array([twin.channels.index(name) for name in names]),
        recorded=experiment.temperatures if wanted is not None and "cost" in wanted else None,
        wanted=wanted,
    )

    def work(first: int) -> dict[str, np.ndarray]:
        chunk = {n: _padded(values[first : first + size], size) for n, values in draws.items()}
        # Each thread has its own precision.
        with jax.enable_x64(precision == "float64"):
            with _LAPACK:
                prepared = jax.block_until_ready(_prepare_chunk(twin, chunk, schedule, start))
            result = jax.tree.map(np.asarray, solve(*prepared))
        if on_progress is not None:
            on_progress(min(first + size, count) - first)
        return {name: values[: count - first] for name, values in result.items()}

    threads = workers or (1 if accelerated else os.cpu_count() or 1)
    firsts = range(0, count, size)
    with ThreadPoolExecutor(max_workers=threads) as pool:
        parts = list(pool.map(work, firsts))
    result = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if wanted is None:
        return result["temperatures"]
    return Reductions(channels=names, failed=result.pop("failed"), **result)


@eqx.filter_jit
def _prepare_chunk(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    schedule: Schedule,
    initial: str | Float[Array | np.ndarray, " starts"] | None,
) -> tuple[System, Modes, Float[Array, "chunk nodes"]]:
    """All linear algebra of a chunk: the draws' equations, modes and initial temperatures."""

    def one(
        values: Mapping[str, Float[Array | np.ndarray, ""]],
    ) -> tuple[System, Modes, Float[Array, " nodes"]]:
        system = twin.with_parameters(values).system(lumped=keeps_symmetry(initial))
        reference = reference_temperature(system, schedule)
        start = initial_temperatures(system, initial, schedule.duty[0], reference)
        return system, network_modes(system), start

    return jax.vmap(one)(draws)


@eqx.filter_jit
def _solve_chunk(
    systems: System,
    modes: Modes,
    starts: Float[Array, "chunk nodes"],
    *,
    schedule: Schedule,
    columns: Int[Array | np.ndarray, " channels"],
    recorded: Float[Array | np.ndarray, "times channels"] | None,
    wanted: tuple[Reduction, ...] | None,
) -> dict[str, Array]:
    wiring = systems.wiring
    # Every element of the rig's plate counts in its spread, also where one node stands for two.
    plate = np.eye(len(wiring.netlist.nodes))[wiring.rig_elements]
    needs_plate = wanted is not None and ("spread" in wanted or "deviation" in wanted)

    def one(system: System, modes: Modes, start: Float[Array, " nodes"]) -> dict[str, Array]:
        dtype = system.capacitance.dtype
        reference = reference_temperature(system, schedule)
        weights = jnp.asarray(system.wiring.channel_weights, dtype)[columns]
        readout = jnp.concatenate([weights, plate]) if needs_plate else weights
        deviation = solve_schedule(system, schedule, start, readout, modes)
        ambient = 0.0
        if schedule.ambient_at is not None:
            ambient = (jnp.asarray(schedule.ambient_at, dtype) - reference)[:, None]
        gain = system.gain[columns]
        rise = ambient + gain * (deviation[:, : len(columns)] - ambient)
        offset = reference - 273.15
        failed = ~(system.physical & jnp.all(jnp.isfinite(rise)))
        if wanted is None:
            return {"temperatures": jnp.where(failed, jnp.nan, rise + offset)}
        elements = deviation[-1, len(columns) :]
        results: dict[str, Callable[[], Array]] = {
            "cost": lambda: jnp.mean((rise - (jnp.asarray(recorded) - offset)) ** 2, axis=0),
            "final": lambda: rise[-1] + offset,
            "minimum": lambda: rise.min(axis=0) + offset,
            "maximum": lambda: rise.max(axis=0) + offset,
            "spread": lambda: elements.max() - elements.min(),
            "deviation": lambda: elements.std(),
        }
        reduced = {name: jnp.where(failed, jnp.nan, results[name]()) for name in wanted}
        return {"failed": failed, **reduced}

    return jax.vmap(one)(systems, modes, starts)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    """The last chunk is filled up with its last draw: one shape, one compilation."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values))])


def _checked_draws(twin: Twin, parameters: Mapping[str, Any]) -> dict[str, np.ndarray]:
    rig = twin.rig
    if not parameters:
        raise ParameterError(f"{rig.name}: parameters: found none, allowed is name -> draws")
    draws: dict[str, np.ndarray] = {}
    for name, values in parameters.items():
        if name not in rig.parameters:
            raise ParameterError(
                f"{rig.name}: unknown parameter {name!r}, allowed are {', '.join(rig.parameters)}"
            )
        array = np.asarray(values, dtype=float)
        if array.ndim != 1 or array.size == 0:
            raise ParameterError(
                f"{rig.name}: parameter {name}: found draws of shape {array.shape}, allowed is one "
                "row of at least one draw"
            )
        if not np.isfinite(array).all():
            raise ParameterError(
                f"{rig.name}: parameter {name}: found {array[~np.isfinite(array)][0]} at draw "
                f"{int(np.flatnonzero(~np.isfinite(array))[0])}, allowed are finite numbers"
            )
        draws[name] = array
    lengths = {name: len(array) for name, array in draws.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(
            f"{rig.name}: parameters: found unequal numbers of draws ({found}), allowed is the "
            "same number for each"
        )
    return draws


def _checked_reductions(
    reductions: Iterable[Reduction], experiment: Experiment
) -> tuple[Reduction, ...]:
    wanted = tuple(reductions)
    unknown = [name for name in wanted if name not in REDUCTIONS]
    if unknown or not wanted:
        raise SimulationError(
            f"reductions: found {', '.join(unknown) or 'none'}, allowed are {', '.join(REDUCTIONS)}"
        )
    if "cost" in wanted and experiment.temperatures is None:
        raise SimulationError(
            'reductions: found "cost", allowed only for an experiment with recorded temperatures'
        )
    return wanted
