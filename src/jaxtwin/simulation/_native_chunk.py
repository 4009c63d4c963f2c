"""Chunks of draws solved by `rodas5p.c`, a draw in each lane of the processor's vectors.

It takes steps of Rodas5P, as `_scalar_chunk` does on an accelerator, and writes what is wanted of
the draws into the arrays of the caller: temperatures at samples, mean squared errors, extremes, the
energy, the plate at the end. A draw whose error estimate is too large is solved again with steps
half as long.
"""

import ctypes
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Float, Int, Shaped

from .._jax_settings import own_settings
from ..io import Experiment
from ..physics import Twin, wiring_of
from ._compressed import CompressedRecording
from ._initial import CheckedInitial, keeps_symmetry
from ._input_levels import input_rates
from ._modes import MAX_SPAN
from ._native_library import native_library
from ._native_network import Outputs, native_network, pack_draws
from ._native_steps import POWERS, NativeSteps, commanded_steps, shared_delay
from ._time_grid import TimeGrid, longest_lateness

# The largest error estimate of a solution that is accepted, K. Around the bundled rigs all are
# smaller; of draws between all bounds none with a smaller estimate had an error above 1e-3 K.
ERROR_TOLERANCE = 4.5e-4

# The largest network. The code for a larger one takes long to compile, and its factors as long as
# the modes of a draw.
MAX_NODES = 400

# The number of draws in a chunk.
NATIVE_CHUNK = 256

# Whether the temperatures of the channels are written at all samples, the last one or none.
Samples: TypeAlias = Literal["all", "last", "none"]

# The reductions that `rodas5p.c` computes: for each channel, and for all cells together.
OF_CHANNELS, OF_SUPPLY = ("cost", "minimum", "maximum"), ("energy", "peak_power")

# The largest number of lanes of a vector.
MAX_LANES = 8

POINTER = ctypes.c_void_p


@final
class NativeRecording(ctypes.Structure):
    """`struct recording` of `rodas5p.c`."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("is_by_sample", "rows")),
        *((name, POINTER) for name in ("step", "weight")),
        *((name, POINTER) for name in ("target", "counted", "number", "beyond")),
    ]


@final
class RunStruct(ctypes.Structure):
    """`struct run`."""

    _fields_ = [
        *(
            (name, ctypes.c_int)
            for name in ("steps", "waiting", "times", "channels", "outputs", "weights")
        ),
        ("duration", ctypes.c_double),
        ("largest_span", ctypes.c_double),
        *((name, POINTER) for name in ("size", "ambient", "duty", "first_duty", "input", "time")),
        *((name, POINTER) for name in ("ambient_at", "output_row", "output_node")),
        *((name, ctypes.c_int) for name in ("first_read", "first_written")),
        ("recording", NativeRecording),
    ]


@final
class Results(ctypes.Structure):
    """`struct results`."""

    _fields_ = [
        ("rows", ctypes.c_size_t),
        *((name, POINTER) for name in ("temperatures", "temperatures_32", "cost")),
        *((name, POINTER) for name in ("minimum", "maximum", "energy", "peak_power")),
        *((name, POINTER) for name in ("others", "error_estimates", "failed")),
    ]


@final
class NativeRun:
    """A run of a twin for many draws.

    **Arguments:**

    - `library`: that of the network.
    - `twin`, `initial`, `columns`: as in `DrawSolver`.
    - `grid`, `steps`: the steps before and after the driver's delay.
    - `recorded`: the recorded temperatures to which draws are compared, degC; None for no cost.
    - `samples`: which temperatures are written.
    - `reductions`: which of `OF_CHANNELS` and `OF_SUPPLY` are computed.
    - `with_plate`: whether the plate's elements are read at the end.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        twin: Twin,
        initial: CheckedInitial,
        columns: Int[np.ndarray, " channels"],
        grid: TimeGrid,
        steps: NativeSteps,
        recorded: Float[np.ndarray, "times channels"] | None,
        samples: Samples,
        reductions: Collection[str],
        with_plate: bool,
    ) -> None:
        wiring = wiring_of(twin.rig, keeps_symmetry(initial))
        self.library, self.twin = library, twin
        self.initial: CheckedInitial = initial
        self.columns, self.with_plate = tuple(columns.tolist()), with_plate
        self.inputs = grid.summary()
        self._kept: list[np.ndarray] = []
        outputs = Outputs(wiring, self.columns, with_plate)
        self._of_all = Outputs(wiring, range(len(wiring.channels)), with_plate)
        time = np.asarray(grid.times)
        ambient = np.zeros(len(time))
        if grid.ambient_at is not None:
            ambient = np.asarray(grid.ambient_at) - grid.ambient_at[0]
        self.elements, self.reductions = len(outputs.others), tuple(reductions)
        first_written = {"all": 0, "last": len(time) - 1, "none": len(time)}[samples]
        self.samples = len(time) - first_written
        recording = NativeRecording()
        if recorded is not None:
            drifts = self.twin.wiring.ambient_drift is not None or bool(np.any(ambient))
            recording = self._recording(
                recorded, None if drifts else steps.compressed(grid, recorded)
            )
        first_read = first_written
        if with_plate:  # it is read at the last sample
            first_read = min(first_read, len(time) - 1)
        if recording.is_by_sample or not {"minimum", "maximum"}.isdisjoint(reductions):
            first_read = 0
        first = steps.duty[0] if grid.steady_start else np.zeros_like(steps.duty[0])
        network = native_network(wiring)
        levels = np.zeros((len(steps.size), 0)) if steps.levels is None else steps.levels
        self.structure = RunStruct(
            steps=len(steps.size),
            waiting=steps.waiting,
            times=len(time),
            channels=len(columns),
            outputs=outputs.count,
            weights=len(outputs.nodes),
            duration=float(self.inputs.duration),
            largest_span=MAX_SPAN,
            size=self._double(steps.size),
            ambient=self._double(steps.ambient),
            duty=self._double(steps.duty),
            first_duty=self._double(first),
            input=self._double(network.inputs.of_steps(levels)),
            time=self._double(time),
            ambient_at=self._double(ambient),
            output_row=self._int(outputs.row),
            output_node=self._int(network.position[outputs.nodes]),
            first_read=first_read,
            first_written=first_written,
            recording=recording,
        )

    def solve(
        self,
        draws: Mapping[str, Float[np.ndarray, " chunk"]],
        count: int,
        temperatures: Float[np.ndarray, "draws rows channels"] | None,
    ) -> dict[str, Shaped[np.ndarray, "solved ..."]]:
        """Solves the first draws of a chunk.

        **Arguments:**

        - `draws`: name -> values; each chunk has the same number.
        - `count`: the number of draws to solve.
        - `temperatures`: where the temperatures of the channels are written, degC, in float64 or
          float32, from the first row of each draw on; None for nowhere.

        **Returns:** "failed"; "refused", whether a draw needs shorter steps; the reductions by
        name; and "plate_end", K above the reference, if it is wanted.
        """
        return self.solve_packed(self.pack(draws), count, temperatures)

    def pack(
        self, draws: Mapping[str, Float[np.ndarray, " chunk"]]
    ) -> Float[np.ndarray, "numbers chunk"]:
        """The numbers of a chunk of draws, name -> values."""
        with own_settings():
            numbers = pack_draws(self.twin, draws, self.inputs, self.initial, self.with_plate)
        return self._of_all.select(np.asarray(numbers), self.columns)

    def solve_packed(
        self,
        numbers: Float[np.ndarray, "numbers chunk"],
        count: int,
        temperatures: Float[np.ndarray, "draws rows channels"] | None,
    ) -> dict[str, Shaped[np.ndarray, "solved ..."]]:
        """`solve` for draws that are packed already."""
        numbers = np.ascontiguousarray(numbers)
        result: dict[str, np.ndarray] = {
            "error_estimate": np.empty(count),
            "failed": np.empty(count, np.uint8),
        }
        for name in self.reductions:
            result[name] = np.empty((count, len(self.columns)) if name in OF_CHANNELS else count)
        if self.with_plate:
            result["plate_end"] = np.empty((count, self.elements))
        is_single = temperatures is not None and temperatures.dtype == np.float32
        to = Results(
            rows=0 if temperatures is None else temperatures.shape[1],
            temperatures=None if is_single else _address(temperatures),
            temperatures_32=_address(temperatures) if is_single else None,
            **{name: _address(result[name]) for name in self.reductions},
            others=_address(result.get("plate_end")),
            error_estimates=_address(result["error_estimate"]),
            failed=_address(result["failed"]),
        )
        columns, wanted = ctypes.c_size_t(numbers.shape[1]), ctypes.c_size_t(count)
        code = self.library.jaxtwin_solve(
            ctypes.byref(self.structure), POINTER(numbers.ctypes.data), columns, wanted,
            ctypes.byref(to),
        )  # fmt: skip
        if code:
            raise MemoryError("the draws of a chunk do not fit into memory")
        result["failed"] = result["failed"] != 0
        result["refused"] = ~(result.pop("error_estimate") <= ERROR_TOLERANCE)
        return result

    def _recording(
        self,
        recorded: Float[np.ndarray, "times channels"],
        few: CompressedRecording | None,
    ) -> NativeRecording:
        """The recording, in a few rows for each step if it is compressed."""
        there = ~np.isnan(recorded)
        target, counted = np.nan_to_num(recorded), there.astype(float)
        number, beyond = there.sum(axis=0), np.zeros(recorded.shape[1])
        step, weight = np.zeros(0, int), np.zeros((0, POWERS))
        if few is not None:
            number, beyond = few.samples, few.beyond
            order = np.argsort(few.grid.step_of, kind="stable")
            step, weight, target, counted = (
                np.asarray(table)[order]
                for table in (few.grid.step_of, few.grid.weights, few.target, few.counted)
            )
        # Whole vectors are read, beyond the last channel of the last row too.
        target, counted = (np.append(table, np.zeros(MAX_LANES)) for table in (target, counted))
        doubles = (weight, target, counted, number, beyond)
        rows = self._int(step), *map(self._double, doubles)
        return NativeRecording(few is None, len(step), *rows)

    def _double(self, values: Any) -> int:
        return self._keep(np.ascontiguousarray(values, float))

    def _int(self, values: Any) -> int:
        return self._keep(np.ascontiguousarray(values, np.int32))

    def _keep(self, array: np.ndarray) -> int:
        """The address of an array, which is kept for as long as this run."""
        self._kept.append(array)
        return array.ctypes.data


def native_run(
    twin: Twin,
    experiment: Experiment,
    initial: CheckedInitial,
    columns: Int[np.ndarray, " channels"],
    refinement: int,
    *,
    own_delays: bool,
    samples: Samples,
    reductions: Collection[str],
    with_plate: bool,
) -> NativeRun | None:
    """The run of a twin for many draws; None where the programs of JAX solve them: for a very large
    network, for some rigs whose driver has a delay (`NativeSteps.of`), or without a C compiler.

    **Arguments:**

    - `refinement`: the number of times that the steps are halved.
    - `own_delays`: whether the draws differ in the driver's delay.
    - The others are as in `NativeRun`.
    """
    wiring = wiring_of(twin.rig, keeps_symmetry(initial))
    if len(wiring.netlist.nodes) > MAX_NODES:
        return None
    lags, inputs = wiring.lag is not None, wiring.inputs_and_effects
    rates, lateness = input_rates(twin.rig), longest_lateness(twin)
    grid = commanded_steps(experiment, lags, refinement, inputs, rates, lateness)
    grid = replace(grid, steady_start=isinstance(initial, str))
    delay = None if own_delays else shared_delay(twin)
    of_room = rates[len(wiring.cold)]
    steps = NativeSteps.of(grid, delay, own_delays=own_delays, of_room=of_room)
    if steps is None:
        return None
    library = native_library(native_network(wiring).header)
    if library is None:
        return None
    recorded = experiment.temperatures if "cost" in reductions else None
    return NativeRun(
        library, twin, initial, columns, grid, steps, recorded, samples, reductions, with_plate
    )


def _address(array: np.ndarray | None) -> int | None:
    return None if array is None else array.ctypes.data
