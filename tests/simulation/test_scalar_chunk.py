"""The steps of Rodas5P that many draws take on an accelerator, here on the CPU.

XLA's fusion for CPUs takes minutes for them, and is left out. Quick tests also do without MLIR, but
these not: without both, what jaxlib 0.10.2 compiles is off by 13 K.
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from small_rigs import bundled

from jaxtwin import Experiment, Twin, reduce_batch, simulate_batch
from jaxtwin.simulation import ReductionName, _draw_solver, _scalar_chunk
from jaxtwin.simulation._chunk_programs import Prepared, Stepped
from jaxtwin.simulation._native_library import VARIABLE
from jaxtwin.simulation._scalar_chunk import MAX_STEPS, MIN_DRAWS, scalar_grid
from jaxtwin.simulation._time_grid import TimeGrid

DRAWS = 8
UNFUSED: dict[str, str | bool] = {"xla_disable_hlo_passes": "fusion"}
if jax.__version_info__ < (0, 11):  # jaxlib 0.12 has MLIR alone
    UNFUSED["xla_cpu_use_fusion_emitters"] = True


@pytest.fixture
def scalar(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Lets the draws of a test take the way of an accelerator. The list gets the number of steps of
    each chunk that did."""
    compiled: Any = _scalar_chunk.step_scalar_chunk
    step, chunks = compiled.__wrapped__, []

    def step_unfused(prepared: Prepared, grid: TimeGrid, *rest: Any) -> Stepped:
        chunks.append(len(grid.size))
        program = jax.jit(
            lambda prepared, grid: step(prepared, grid, *rest), compiler_options=UNFUSED
        )
        return program(prepared, grid)

    monkeypatch.setattr(_draw_solver, "step_scalar_chunk", step_unfused)
    monkeypatch.setattr(_draw_solver, "is_accelerated", lambda: True)
    monkeypatch.setattr(_scalar_chunk, "MIN_DRAWS", 1)
    return chunks


def spread(twin: Twin, names: list[str]) -> dict[str, np.ndarray]:
    """Draws around a twin's values."""
    random = np.random.default_rng(0)
    return {name: np.asarray(twin.values[name]) * random.normal(1.0, 0.15, DRAWS) for name in names}


def drive(twin: Twin, **more: Any) -> Experiment:
    """Five minutes with a change of the duty; cells are reversed."""
    is_heater = twin.wiring.heaters or (False,) * len(twin.wiring.cold)
    time = np.arange(301.0)
    duty = [np.where(time < 120, 0.7, 0.3 if heater else -0.4) for heater in is_heater]
    return Experiment(time, np.transpose(duty), **more)


LIMITED = {"off_phase": "open", "current_limit": "2 A"}


def case(name: str, precision: str, mark: pytest.MarkDecorator, **driver: str) -> Any:
    return pytest.param(name, precision, driver, marks=mark, id=f"{name}-{precision}")


@pytest.mark.parametrize(
    ("name", "precision", "driver"),
    [
        case("paper-2024", "float64", pytest.mark.slow),
        case("dual-cell", "float32", pytest.mark.long),
        case("single-cell", "float64", pytest.mark.long, **LIMITED),
        case("printer-bed", "float32", pytest.mark.long),
        case("paper-2024", "float32", pytest.mark.long),
        case("dual-cell", "float64", pytest.mark.long),
        case("single-cell", "float32", pytest.mark.long, **LIMITED),
        case("pcr-block", "float64", pytest.mark.long),
    ],
)
def test_draws_are_those_of_the_default_solver(name, precision, driver, request, monkeypatch):
    """With a lag, a delay, nonlinear losses, heaters and a limited current: at the end to 1e-5 K,
    or 1e-4 K where the limit makes a kink within steps; at samples inside the steps to half a
    millikelvin."""
    monkeypatch.setenv(VARIABLE, "off")
    twin = bundled(name, driver)
    draws = spread(twin, ["R_E", "R_Th"] if "R_Th" in twin.values else list(twin.values)[:2])
    experiment = drive(twin)
    wanted: list[ReductionName] = ["final", "energy", "minimum", "maximum"]
    default = reduce_batch(twin, experiment, draws, wanted)
    trajectories = simulate_batch(twin, experiment, draws)
    chunks = request.getfixturevalue("scalar")
    found = reduce_batch(twin, experiment, draws, wanted, precision=precision)
    whole = simulate_batch(twin, experiment, draws, precision=precision)
    assert len(chunks) == 2
    rounding = 0 if precision == "float64" else 1e-3
    assert np.abs(found["final"] - default["final"]).max() < (1e-4 if driver else 1e-5) + rounding
    assert np.abs(whole - trajectories).max() < 5e-4 + rounding
    np.testing.assert_allclose(found["energy"], default["energy"], rtol=1e-4)
    np.testing.assert_allclose(found["minimum"], default["minimum"], rtol=0, atol=2e-3)
    np.testing.assert_allclose(found["maximum"], default["maximum"], rtol=0, atol=2e-3)


@pytest.mark.slow
def test_the_room_may_change_and_a_run_begin_at_rest(request):
    """A recorded ambient temperature, a steady start under a lag, a cost, and draws that fail."""
    twin = bundled("single-cell", {"lag": "3 s"})
    room = 20 + 3 * np.sin(np.arange(301.0) / 50)
    experiment = drive(twin, ambient=np.where(np.arange(301) % 60 < 30, 20.0, 21.0) + 0 * room)
    answer = twin.simulate(experiment)
    experiment = replace(experiment, channels=answer.channels, temperatures=answer.temperatures)
    name = next(iter(twin.values))
    draws = {name: twin.values[name] * np.array([1.0, 0.8, 1.2, -1.0])}
    wanted: list[ReductionName] = ["cost", "final"]
    default = reduce_batch(twin, experiment, draws, wanted, initial="steady")
    request.getfixturevalue("scalar")
    found = reduce_batch(twin, experiment, draws, wanted, initial="steady")
    np.testing.assert_array_equal(found.failed, default.failed)
    np.testing.assert_allclose(found["final"], default["final"], rtol=0, atol=1e-4)
    np.testing.assert_allclose(found["cost"], default["cost"], rtol=1e-3, atol=1e-6)


def test_modes_are_taken_where_they_are_as_good():
    """Few draws, a drive that changes all the time, and a large plate."""
    twin, steps = Twin("paper-2024"), Experiment.schedule("0:0.5", duration=600.0, cells=2)
    assert scalar_grid(twin, steps, MIN_DRAWS - 1, steady_start=False) is None
    grid = scalar_grid(twin, steps, MIN_DRAWS, steady_start=True)
    assert grid is not None
    assert grid.steady_start
    assert len(grid.size) < MAX_STEPS / 2
    random = np.random.default_rng(0).uniform(-1, 1, size=(301, 2))
    restless = Experiment(np.arange(301.0), random)
    assert scalar_grid(twin, restless, MIN_DRAWS, steady_start=False) is None


def test_steps_of_no_length_end_each_span_and_the_others_fill_it():
    twin, steps = Twin("paper-2024"), Experiment.schedule("0:0.5,100:0.8", duration=600.0, cells=2)
    grid = scalar_grid(twin, steps, MIN_DRAWS, steady_start=False)
    assert grid is not None
    sizes = np.asarray(grid.sizes)[np.asarray(grid.size)]
    ends = np.cumsum(sizes)
    assert ends[-1] == pytest.approx(600.0)
    change = int(np.searchsorted(ends, 100.0 - 1e-6))
    assert sizes[change + 1] == 0
    np.testing.assert_array_equal(np.asarray(grid.duty)[[change + 1, change + 2], 0], [0.5, 0.8])
