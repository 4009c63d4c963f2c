"""Solves many draws of a twin: from their parameters to trajectories or reductions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, final

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._padded_rows import padded
from ..io import Experiment
from ..physics import Twin
from ._chunk_programs import (
    Precision,
    Prepared,
    Stepped,
    compressed_cost,
    compressed_errors,
    prepare_chunk,
    sample_chunk,
    sample_plate_end,
    sample_power,
    step_chunk,
)
from ._compressed import CompressedRecording, compress
from ._drive import delayed_time_grid, draws_change_delay
from ._initial import CheckedInitial
from ._native_chunk import (
    NATIVE_CHUNK,
    OF_CHANNELS,
    OF_SUPPLY,
    NativeRun,
    Samples,
    native_run,
)
from ._reductions import BatchReadings, Reduction, reduce_readings
from ._refinement import Results, needs_shorter_steps
from ._scalar_chunk import prepare_scalar_chunk, scalar_chunk_size, scalar_grid, step_scalar_chunk
from ._time_grid import TimeGrid, padded_time_grid
from ._workers import fill_in_chunks, is_accelerated, usual_chunk_size, work_in_chunks

if TYPE_CHECKING:
    from ._diffeqsolve import DiffraxMethod

# The reductions that `rodas5p.c` computes.
NATIVE = frozenset(OF_CHANNELS + OF_SUPPLY)

# Name of a parameter -> its values in the unit of the rig's table.
Draws: TypeAlias = Mapping[str, Float[np.ndarray, " draws"]]


@final
@dataclass(frozen=True, eq=False)
class DrawSolver:
    """The problem that all draws of a batch share, and two methods to solve it.

    **Arguments:**

    - `twin`: the twin; parameters that are not drawn keep its values.
    - `experiment`: the inputs.
    - `initial`: the checked temperatures at the start.
    - `columns`: the positions of the requested channels among those of the rig.
    - `reductions`: name of the result -> reduction; None for whole trajectories.
    - `precision`: the precision of the steps. The modes are always computed in float64, because
      their rates span nine decades.
    - `chunk_size`: the number of draws in a chunk, None for the default of the device.
    - `workers`: the number of threads, None for one for each core, or for each accelerator.
    """

    twin: Twin
    experiment: Experiment
    initial: CheckedInitial
    columns: Int[np.ndarray, " channels"]
    reductions: Mapping[str, Reduction] | None
    precision: Precision
    chunk_size: int | None
    workers: int | None

    def solve(
        self,
        draws: Draws,
        refinement: int,
        on_progress: Callable[[int], None] | None = None,
        total: int | None = None,
        out: Float[np.ndarray, "draws times channels"] | None = None,
    ) -> Results:
        """Solves draws by the default solver.

        **Arguments:**

        - `refinement`: the number of times that the steps are halved; see `solve_refined`.
        - `on_progress`: called with the number of draws in each finished chunk.
        - `total`: the number of all draws if `draws` is a part of them; see `work_in_chunks`.
        - `out`: an array into which temperatures may be written; they are among the results in any
          case.
        """
        own_delays = draws_change_delay(self.twin, draws)
        if not is_accelerated() and (native := self._native(refinement, own_delays)) is not None:
            return self._solve_native(native, draws, on_progress, total, out)
        count = total or len(next(iter(draws.values())))
        scalar_steps = None
        if refinement == 0 and not own_delays and is_accelerated():
            scalar_steps = scalar_grid(
                self.twin, self.experiment, count, steady_start=isinstance(self.initial, str)
            )
        commanded = self._grid(refinement) if scalar_steps is None else scalar_steps
        inputs, to_be_delayed = commanded.summary(), commanded if own_delays else None
        # Draws with the same delay share the interpolation weights of the samples.
        grid = commanded if own_delays else _delayed_as(self.twin, commanded)
        compressed = None if own_delays else self._compressed(grid)

        def work(chunk: Draws) -> dict[str, Array | np.ndarray]:
            with own_settings():
                prepared = (
                    prepare_chunk(
                        self.twin, chunk, inputs, self.initial, to_be_delayed, self.precision
                    )
                    if scalar_steps is None
                    else prepare_scalar_chunk(
                        self.twin, chunk, inputs, self.initial, self.precision
                    )
                )
            with own_settings(float64=self.precision == "float64"):
                step = step_chunk if scalar_steps is None else step_scalar_chunk
                stepped = step(
                    prepared, grid, self.columns, self._reads("plate_end"), self._reads_power()
                )
                reduced = self._reduced(prepared, stepped, grid, compressed)
            # Neither shorter steps nor another solver help an invalid draw. NumPy needs no
            # compilation.
            refused = needs_shorter_steps(
                prepared.stability_number, stepped.channels.error_estimate, refinement
            )
            is_valid = np.asarray(prepared.system.is_valid)
            return {"refused": refused & is_valid, "failed": stepped.failed, **reduced}

        # The next chunk is brought in and the last one out while one is computed.
        overlapped = None if scalar_steps is None else 2 * jax.local_device_count()
        return work_in_chunks(
            draws,
            work,
            chunk_size=self.chunk_size
            or self._usual_chunk_size(scalar_steps, compressed is not None),
            workers=self.workers or overlapped,
            on_progress=on_progress,
            total=total,
        )

    def solve_with_diffrax(
        self,
        draws: Draws,
        method: "DiffraxMethod",
        on_progress: Callable[[int], None] | None = None,
        total: int | None = None,
    ) -> Results:
        """Solves draws by a diffrax solver, always in float64. `on_progress` and `total` are as in
        `solve`."""
        from ._diffrax_programs import diffrax_chunk

        grid = self._grid(0)
        recorded = self.experiment.temperatures

        def work(chunk: Draws) -> dict[str, Array | np.ndarray]:
            with own_settings():
                temperatures, plate, drawn, failed = diffrax_chunk(
                    self.twin,
                    chunk,
                    grid,
                    self.initial,
                    self.experiment,
                    method,
                    self._reads_power(),
                )
                temperatures = np.asarray(temperatures)[:, :, self.columns]
                if self.reductions is None:
                    return {"failed": failed, "temperatures": temperatures}
                energy, peak = (None, None) if drawn is None else (drawn.energy[:, -1], drawn.peak)
                end = temperatures[:, -1]
                readings = BatchReadings(temperatures, temperatures, end, plate, energy, peak)
                return {"failed": failed, **reduce_readings(self.reductions, readings, recorded)}

        # On a CPU, the linear algebra of two chunks at once would deadlock (`_lapack`).
        is_alone = method.calls_lapack and not is_accelerated()
        return work_in_chunks(
            draws,
            work,
            chunk_size=self.chunk_size or usual_chunk_size(),
            workers=1 if is_alone else self.workers,
            on_progress=on_progress,
            total=total,
        )

    def _native(self, refinement: int, own_delays: bool) -> NativeRun | None:
        """The run of `rodas5p.c`, None where it cannot give what is wanted."""
        reads = {r.reads for name, r in (self.reductions or {}).items() if name not in NATIVE}
        samples: Samples = "last" if "end" in reads else "none"
        if self.reductions is None or "trajectory" in reads:
            samples = "all"
        return native_run(
            self.twin,
            self.experiment,
            self.initial,
            self.columns,
            # A method of fifth order does with half as many halvings.
            -(-refinement // 2),
            own_delays=own_delays,
            samples=samples,
            reductions=[name for name in self.reductions or () if name in NATIVE],
            with_plate="plate_end" in reads,
        )

    def _solve_native(
        self,
        run: NativeRun,
        draws: Draws,
        on_progress: Callable[[int], None] | None,
        total: int | None,
        out: Float[np.ndarray, "draws times channels"] | None,
    ) -> Results:
        count, dtype = len(next(iter(draws.values()))), np.dtype(self.precision)
        if self.reductions is None and (out is None or out.dtype != dtype):
            out = np.empty((count, run.samples, len(self.columns)), dtype)

        def work(chunk: Draws, part: slice) -> dict[str, np.ndarray]:
            number = part.stop - part.start
            if self.reductions is None:
                assert out is not None
                return run.solve(chunk, number, out[part])
            size, read = len(next(iter(chunk.values()))), None
            if run.samples:
                read = np.empty((size, run.samples, len(self.columns)), dtype)
            result = run.solve(chunk, number, read)
            reduced = self._native_reduced(result, read)
            return {**result, **reduced}

        few = run.samples <= 1 or self.reductions is None
        results = fill_in_chunks(
            draws,
            work,
            chunk_size=self.chunk_size or (NATIVE_CHUNK if few else usual_chunk_size()),
            workers=self.workers,
            on_progress=on_progress,
            total=total,
        )
        if out is not None:
            results["temperatures"] = out
        return results

    def _native_reduced(
        self,
        chunk: dict[str, np.ndarray],
        read: Float[np.ndarray, "chunk rows channels"] | None,
    ) -> dict[str, np.ndarray]:
        """The reductions of what `NativeRun.solve` found and read of a chunk."""
        dtype = np.dtype(self.precision)
        results: dict[str, np.ndarray] = {}
        reductions = dict(self.reductions or {})
        for name in NATIVE.intersection(reductions):
            del reductions[name]
            results[name] = chunk.pop(name).astype(dtype)
        plate = chunk.pop("plate_end").astype(dtype) if "plate_end" in chunk else None
        end = None if read is None else read[:, -1]
        with own_settings(float64=self.precision == "float64"):
            reduced = reduce_readings(reductions, BatchReadings(read, None, end, plate), None)
            return results | {name: np.asarray(values) for name, values in reduced.items()}

    def _usual_chunk_size(self, scalar_steps: TimeGrid | None, is_compressed: bool) -> int:
        """The default chunk size; larger for Rodas5P, unless whole trajectories fill the memory."""
        reductions = dict(self.reductions or {})
        if is_compressed:
            del reductions["cost"]
        few = {"end", "plate_end"}
        keeps_few = self.reductions is not None and {r.reads for r in reductions.values()} <= few
        return scalar_chunk_size() if scalar_steps is not None and keeps_few else usual_chunk_size()

    def _grid(self, refinement: int) -> TimeGrid:
        steady_start = isinstance(self.initial, str)
        return padded_time_grid(self.twin, self.experiment, refinement, steady_start=steady_start)

    def _compressed(self, grid: TimeGrid) -> CompressedRecording | None:
        """The compressed recording for the cost; None if the ambient temperature changes, because
        the readings then do not follow from the nodes."""
        if self.reductions is None or "cost" not in self.reductions:
            return None
        drifts = grid.ambient_at is not None or self.twin.wiring.ambient_drift is not None
        recorded = self.experiment.temperatures
        return None if drifts or recorded is None else compress(grid, recorded)

    def _reads(self, *readings: str) -> bool:
        """Whether a reduction reads one of these fields of `BatchReadings`."""
        reductions = {} if self.reductions is None else self.reductions
        return any(reduction.reads in readings for reduction in reductions.values())

    def _reads_power(self) -> bool:
        return self._reads("energy", "peak_power")

    def _reduced(
        self,
        prepared: Prepared,
        stepped: Stepped,
        grid: TimeGrid,
        compressed: CompressedRecording | None,
    ) -> dict[str, Array | np.ndarray]:
        """The trajectories or the reductions of a chunk. Nothing else is computed."""
        count = len(self.experiment.time)
        if self.reductions is None:
            temperatures = sample_chunk(prepared, stepped, grid, self.columns)
            # NumPy slices without compiling for each new number of samples.
            return {"temperatures": np.asarray(temperatures)[:, :count]}
        reductions, results = dict(self.reductions), {}
        if compressed is not None:
            del reductions["cost"]
            errors = compressed_errors(prepared, stepped, compressed, self.columns)
            results["cost"] = compressed_cost(errors, compressed)
        reads = {reduction.reads for reduction in reductions.values()}
        readings: dict[str, Array | np.ndarray] = {}
        if reads & {"trajectory", "padded_trajectory"}:
            temperatures = sample_chunk(prepared, stepped, grid, self.columns)
            readings["padded_trajectory"] = temperatures
            if "trajectory" in reads:
                readings["trajectory"] = temperatures[:, :count]
            if "end" in reads:
                readings["end"] = temperatures[:, -1]
        elif "end" in reads:
            end = sample_chunk(prepared, stepped, grid, self.columns, last=True)
            readings["end"] = end[:, 0]
        if "plate_end" in reads:
            readings["plate_end"] = sample_plate_end(prepared, stepped, grid)
        if self._reads_power():
            drawn = sample_power(prepared, stepped, grid, padded(self.experiment.duty))
            readings |= {"energy": drawn.energy[:, -1], "peak_power": drawn.peak}
        recorded = self.experiment.temperatures
        recorded = None if recorded is None else padded(recorded, np.nan)
        return {**results, **reduce_readings(reductions, BatchReadings(**readings), recorded)}


def _delayed_as(twin: Twin, commanded: TimeGrid) -> TimeGrid:
    """The grid with the inputs delayed by the driver's delay, if there is one."""
    delay = twin.wiring.delay
    if delay is None:
        return commanded
    with own_settings():
        delayed = _delayed(commanded, delay(twin.values_si)[0])
    return jax.tree.map(np.asarray, delayed)


_delayed = persistent_jit(delayed_time_grid)
