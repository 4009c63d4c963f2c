"""The recordings of a match, simulated where there is a C compiler: readings and their derivatives.

`rodas5p.c` solves the readings, and their derivatives as central differences of draws side by side,
two for each entry that acts on the network. All draws take the same steps, so that a difference has
the derivative of their error, not the error over the step. The programs that JAX compiles for
readings and derivatives take several times as long to compile as the network's library, and to run.

The readings are linear in the gains of the channels. One further draw with other gains therefore
gives the derivatives with respect to all of them.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, lru_cache
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from .._padded_rows import padded
from ..io import Experiment
from ..physics import System
from ..simulation import (
    CheckedInitial,
    Modes,
    NativeRun,
    checked_initial,
    draws_change_delay,
    is_accelerated,
    native_run,
    padded_time_grid,
    run_exponential,
)
from ._objective import MatchObjective
from ._problem import MatchProblem

# The step of a difference, in the default scales of the entries. C computes the losses of a plate
# in single precision, which makes noise of 4e-7 K; the error of third order is 3e-6 of a derivative
# where the readings follow a power of the parameter.
DIFFERENCE = 4e-3

# The halvings of the steps that are tried where an error estimate is too large.
REFINEMENTS = 2

# The number of draws whose readings are in memory: 55 MB for eight hours of 15 channels.
DRAWS = 16


class _PaddedRecording(NamedTuple):
    """A recording, with the positions of its channels, and its temperatures, padded as those of the
    objective."""

    experiment: Experiment
    columns: Int[np.ndarray, " channels"]
    temperatures: Float[np.ndarray, "times channels"]

    def errors_of(
        self, readings: Float[np.ndarray, "_times channels"]
    ) -> Float[np.ndarray, "times channels"]:
        """Simulated minus recorded temperatures, K; 0 where the recording is padded."""
        times = len(self.experiment.time)
        errors = np.zeros_like(self.temperatures)
        errors[:times] = readings[:times] - self.temperatures[:times]
        return errors


@final
class NativeRecordings:
    """The recordings of a problem, to be made by `of`."""

    def __init__(self, problem: MatchProblem) -> None:
        twin, unknowns = problem.twin, problem.unknowns
        layout = unknowns.layout
        self._twin = twin
        self._initial: CheckedInitial = checked_initial(twin, problem.initial)
        self._names = [name for name, _ in layout.names]
        self._entries = layout.entry_indices()
        self._inner = np.array(layout.network_entries(twin), int)
        self._outer = np.setdiff1d(np.arange(len(self._names)), self._inner)
        # Two for each derivative, and two for those by gains.
        self._points = 2 * len(self._inner) + 2
        self._is_logarithmic = np.array([is_logarithm for _, is_logarithm in layout.names])
        self._steps = DIFFERENCE * unknowns.default_scales()
        # Logarithms may go a little beyond their bounds, but a number must not become negative.
        of_all = np.array([row.is_logarithmic for row in unknowns.entry_parameters], dtype=bool)
        self._lower = np.where(of_all, -np.inf, unknowns.lower())
        self._upper = np.where(of_all, np.inf, unknowns.upper())
        self._recordings = [
            _PaddedRecording(
                experiment,
                np.array([twin.channels.index(name) for name in experiment.channels]),
                padded(np.nan_to_num(np.asarray(experiment.temperatures))),
            )
            for experiment in problem.experiments
        ]
        self._native = lru_cache(maxsize=None)(self._native_run)

    @classmethod
    def of(cls, problem: MatchProblem) -> "NativeRecordings | None":
        """The recordings of a problem; None where C cannot solve them, see `native_run`."""
        if is_accelerated():
            return None
        recordings = cls(problem)
        can = (recordings._native(number, 0) for number in range(len(problem.experiments)))
        return recordings if all(run is not None for run in can) else None

    def output_errors(
        self, vector: Float[np.ndarray, " unknowns"], number: int
    ) -> Float[np.ndarray, "times channels"]:
        """The `output_errors` of one recording: by C, or by the program of `simulate` where C
        cannot solve it, as with values that are far from any device's."""
        errors = self._native_errors(vector, number, 0)
        return self._errors_by_jax(vector, number) if errors is None else errors

    def errors_of_short_steps(
        self, vector: Float[np.ndarray, " unknowns"], number: int
    ) -> Float[np.ndarray, "times channels"] | None:
        """The `output_errors` by C with its shortest steps; None if C cannot solve them."""
        return self._native_errors(vector, number, REFINEMENTS)

    def _native_errors(
        self, vector: Float[np.ndarray, " unknowns"], number: int, halvings: int
    ) -> Float[np.ndarray, "times channels"] | None:
        """The `output_errors` by C with steps halved at least so often; None if it cannot."""
        recording, local = self._recordings[number], vector[self._entries[number]]
        # As many draws as for the derivatives, of which one is solved: the program that packs them
        # is then the same.
        values = self._values(np.repeat(local[None], self._points, axis=0))
        for refinement in range(halvings, REFINEMENTS + 1):
            run = self._run(number, refinement)
            readings = np.empty((1, run.samples, len(recording.columns)))
            result = run.solve_packed(run.pack(values)[:, :1], 1, readings)
            if not np.any(result["refused"] | result["failed"]):
                return recording.errors_of(readings[0])
        return None

    def _errors_by_jax(
        self, vector: Float[np.ndarray, " unknowns"], number: int
    ) -> Float[np.ndarray, "times channels"]:
        recording, local = self._recordings[number], vector[self._entries[number]]
        grid = padded_time_grid(
            self._twin, recording.experiment, steady_start=isinstance(self._initial, str)
        )
        twin = self._twin.with_values(self._values(local))
        _, readings, _, _ = run_exponential(twin, grid, self._initial)
        return recording.errors_of(np.asarray(readings)[:, recording.columns] - ZERO_CELSIUS)

    def jacobian(
        self, vector: Float[np.ndarray, " unknowns"], number: int
    ) -> Float[np.ndarray, "entries times channels"] | None:
        """The `output_error_jacobians` of one recording; None if C cannot solve all its draws."""
        for refinement in range(REFINEMENTS + 1):
            jacobian = self._differences(vector, number, self._run(number, refinement))
            if jacobian is not None:
                return jacobian
        return None

    def _run(self, number: int, refinement: int) -> NativeRun:
        run = self._native(number, refinement)
        assert run is not None, "`of` has seen it"
        return run

    def _native_run(self, number: int, refinement: int) -> NativeRun | None:
        recording = self._recordings[number]
        return native_run(
            self._twin,
            recording.experiment,
            self._initial,
            recording.columns,
            refinement,
            own_delays=draws_change_delay(self._twin, self._names),
            samples="all",
            reductions=(),
            with_plate=False,
        )

    def _differences(
        self, vector: Float[np.ndarray, " unknowns"], number: int, run: NativeRun
    ) -> Float[np.ndarray, "entries times channels"] | None:
        """The derivatives by one size of steps; None if a draw is refused."""
        at, inner, outer = self._entries[number], self._inner, self._outer
        local, steps = vector[at], self._steps[at]
        ahead = np.minimum(local + steps, self._upper[at])
        behind = np.maximum(local - steps, self._lower[at])
        moved = local.copy()
        moved[outer] += steps[outer]
        # Each pair of points is followed by the next.
        points = np.repeat(local[None], self._points, axis=0)
        points[np.arange(0, 2 * len(inner), 2), inner] = ahead[inner]
        points[np.arange(1, 2 * len(inner), 2), inner] = behind[inner]
        points[-2] = moved
        numbers = run.pack(self._values(points))
        recording, times = self._recordings[number], run.samples
        jacobian = np.zeros((len(local), *recording.temperatures.shape))
        readings = np.empty((DRAWS, times, len(recording.columns)))
        for first in range(0, len(points), DRAWS):
            count = min(DRAWS, len(points) - first)
            result = run.solve_packed(numbers[:, first : first + count], count, readings)
            if np.any(result["refused"] | result["failed"]):
                return None
            changes = readings[0:count:2] - readings[1:count:2]
            entries = inner[first // 2 : (first + count) // 2]
            jacobian[entries, :times] = changes[: len(entries)]
            if first + count == len(points) and outer.size:
                by_gain = self._gain_slopes(number, local, moved)
                jacobian[outer, :times] = by_gain[:, None] * changes[-1]
        jacobian[inner] /= (ahead - behind)[inner, None, None]
        return jacobian

    def _gain_slopes(
        self,
        number: int,
        local: Float[np.ndarray, " entries"],
        moved: Float[np.ndarray, " entries"],
    ) -> Float[np.ndarray, "outer channels"]:
        """The derivatives of the channels' gains with respect to the entries that act on gains
        alone, over the change of the gains between two points."""
        outer, columns = self._outer, self._recordings[number].columns
        size = 1e-6
        sides = [local + sign * size * np.eye(len(local))[outer] for sign in (1, -1)]
        points = np.concatenate([*sides, local[None], moved[None]])
        values, table = self._values(points), self._twin.rig.parameters
        own = self._twin.numbers_si | {n: table[n].to_si(v) for n, v in values.items()}
        gains = self._twin.wiring.gains.numbers(own)[columns]
        ahead, behind = gains[:, : len(outer)], gains[:, len(outer) : -2]
        change = gains[:, -1] - gains[:, -2]
        over = np.where(change != 0, change, np.inf)
        return (ahead - behind).T / (2 * size) / over

    def _values(
        self, local: Float[np.ndarray, "*draws entries"]
    ) -> dict[str, Float[np.ndarray, "*draws"]]:
        """Name -> value in the parameter's unit."""
        powers = np.exp(np.where(self._is_logarithmic, local, 0.0))
        values = np.where(self._is_logarithmic, powers, local)
        return {name: values[..., number] for number, name in enumerate(self._names)}


@final
class NativeDescents:
    """The `NativeRecordings` of descents side by side, which give what the programs of JAX do."""

    def __init__(self, recordings: Sequence[NativeRecordings], objective: MatchObjective) -> None:
        self._recordings = recordings
        self._batches = [batch.positions for batch in objective.same_shape_batches]
        self._count = sum(map(len, self._batches))

    @classmethod
    def of(
        cls, problems: Sequence[MatchProblem], objective: MatchObjective
    ) -> "NativeDescents | None":
        """Those of each descent's problem; None if C cannot solve all."""
        of_problem = {id(problem): problem for problem in problems}
        native = {key: NativeRecordings.of(problem) for key, problem in of_problem.items()}
        recordings = [part for problem in problems if (part := native[id(problem)]) is not None]
        return cls(recordings, objective) if len(recordings) == len(problems) else None

    def output_errors(
        self, vectors: Float[Array, "descents unknowns"], wanted: Bool[np.ndarray, " descents"]
    ) -> list[Float[np.ndarray, "descents _recordings _times _channels"]]:
        """The output errors of the wanted descents at their vectors; any for the others."""
        errors = self._each(NativeRecordings.output_errors, vectors, wanted)
        assert errors is not None
        return errors

    def jacobians(
        self, vectors: Float[Array, "descents unknowns"], wanted: Bool[np.ndarray, " descents"]
    ) -> list[Float[np.ndarray, "descents _recordings _entries _times _channels"]] | None:
        """Their derivatives; None if C cannot solve all."""
        return self._each(NativeRecordings.jacobian, vectors, wanted)

    def _each(
        self,
        function: Callable[[NativeRecordings, np.ndarray, int], np.ndarray | None],
        vectors: Float[Array, "descents unknowns"],
        wanted: Bool[np.ndarray, " descents"],
    ) -> list[np.ndarray] | None:
        points = np.asarray(vectors)
        tasks = [
            (descent, number)
            for descent in np.flatnonzero(wanted).tolist()
            for number in range(self._count)
        ]

        def work(task: tuple[int, int]) -> np.ndarray | None:
            descent, number = task
            with own_settings():
                return function(self._recordings[descent], points[descent], number)

        parts = dict(zip(tasks, _threads().map(work, tasks), strict=True))
        if any(part is None for part in parts.values()):
            return None
        # The result of a descent that is not wanted is not used.
        first = int(np.flatnonzero(wanted)[0])
        sources = [number if is_wanted else first for number, is_wanted in enumerate(wanted)]
        return [
            np.array([[parts[descent, number] for number in positions] for descent in sources])
            for positions in self._batches
        ]


@cache
def _threads() -> ThreadPoolExecutor:
    """The threads of all matches: to start new ones for each evaluation takes as long as a run."""
    return ThreadPoolExecutor(os.cpu_count())


# The modes of a large network that matter for its readings.
#
# On a fine grid most modes are ripples between neighbouring elements, which the drive hardly
# reaches: a heat flow $q$ into the sides of the cells holds mode $i$ at $v_i^T q / \lambda_i$. A
# match takes the derivatives of many runs in the same modes, and without these ripples they take a
# fraction of the time. Those that remain are exact modes of the whole network.

# The number of modes above which few are taken, and their number. On a plate of 324 elements and
# two cells, the largest error of a reading is 6 mK at rises of 50 K.
MANY, FEW = 128, 96

# A heat flow of a cell, W, and a deviation of the plate from its surroundings at the start, K.
TYPICAL_HEAT, TYPICAL_DEVIATION = 30.0, 3.0


def few_modes(system: System, modes: Modes) -> Modes:
    """The modes of a run; of many modes those that matter: half of them the slowest, half those in
    which the heat of the cells and the surroundings changes readings and cells the most."""
    count = modes.rates.shape[-1]
    # Modes for each regime of a rig's inputs have a leading axis.
    if count <= MANY or modes.rates.ndim > 1:
        return modes
    weight = _largest_change(system, modes)
    _, others = jax.lax.top_k(weight[FEW // 2 :], FEW - FEW // 2)
    chosen = jnp.sort(jnp.concatenate([jnp.arange(FEW // 2), FEW // 2 + others]))

    def of_chosen(shapes: Array | None) -> Array | None:
        return None if shapes is None else shapes[:, chosen]

    return replace(
        modes,
        rates=modes.rates[chosen],
        shapes=modes.shapes[:, chosen],
        sides=modes.sides[:, chosen],
        losses=jax.tree.map(of_chosen, modes.losses),
        switched=of_chosen(modes.switched),
    )


def _largest_change(system: System, modes: Modes) -> Float[Array, " modes"]:
    """The change of a reading or of a cell by each mode under a typical drive, K."""
    at_sides = jnp.abs(modes.sides).max(axis=0)
    weights = jnp.asarray(system.channel_weights, modes.rates.dtype)
    read = jnp.abs(weights @ modes.shapes).max(axis=0)
    surroundings = jnp.abs(system.ambient_conductance @ modes.shapes)
    force = jnp.maximum(TYPICAL_HEAT * at_sides, TYPICAL_DEVIATION * surroundings)
    return jnp.maximum(read, at_sides) * force / modes.rates
