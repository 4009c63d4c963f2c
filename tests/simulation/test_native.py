"""Draws by `rodas5p.c`: the same as by the programs of JAX, for all that a rig file can describe.

The two solve the same equations in different ways (Rodas5P on steps of its own, exponentials in the
modes of the network), so that an agreement to a few tenths of a millikelvin checks both.
"""

import os
import subprocess
import sys
from math import factorial

import numpy as np
import pytest
from heated_box import cell_and_heater
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import Experiment, Twin, reduce_batch, simulate_batch
from jaxtwin.errors import SimulationError
from jaxtwin.simulation import _native_library
from jaxtwin.simulation._native_library import VARIABLE, native_library, native_state
from jaxtwin.simulation._native_network import Elimination, native_network
from jaxtwin.simulation._reductions import REDUCTIONS, ReductionName
from jaxtwin.simulation._rosenbrock_step import (
    CORRECTION,
    DENSE,
    GAMMA,
    SLOPE_TABLE,
    STATE_TABLE,
)

pytestmark = pytest.mark.c_compiler

# Those without inputs besides the duty.
RIGS = [
    *("paper-2024", "dual-cell", "single-cell", "tclab", "printer-bed", "pcr-block"),
    "dew-point-mirror",
]

# The largest difference of two ways to solve a draw, K.
NEAR = 6e-4


def drive(twin: Twin, seconds: int = 400) -> Experiment:
    """Two steps, the second a reversal where the rig can cool."""
    time = np.arange(seconds + 1.0)
    cells = len(twin.wiring.cold)
    level = np.where(time < seconds // 2, 0.6, 0.3)
    duty = np.outer(level, np.ones(cells))
    duty[time >= seconds // 2] *= np.where(twin.wiring.lowest_duty < 0, -1, 1)
    return Experiment(time, duty)


def draws_around(twin: Twin, count: int, spread: float = 0.2, held: tuple[str, ...] = ()):
    rng = np.random.default_rng(0)
    names = [
        name
        for name, row in twin.rig.parameters.items()
        if name not in held and row.lower < twin.values[name] < row.upper
    ]
    values = {
        name: twin.values[name] * np.exp(rng.normal(0, spread, count))
        if twin.values[name] > 0
        else np.full(count, twin.values[name])
        for name in names
    }
    return {
        name: np.clip(row, twin.rig.parameters[name].lower, twin.rig.parameters[name].upper)
        for name, row in values.items()
    }


@pytest.fixture
def by_jax(monkeypatch):
    """Solves by the programs of JAX inside a call."""

    def call(function, *arguments, **keywords):
        with monkeypatch.context() as context:
            context.setenv(VARIABLE, "off")
            return function(*arguments, **keywords)

    return call


@pytest.mark.slow
@pytest.mark.parametrize(
    "rig", [*RIGS[:2], "tclab", *(pytest.param(rig, marks=pytest.mark.long) for rig in RIGS[4:])]
)
def test_draws_are_those_of_jax(rig, by_jax):
    """Reversals, lags and delays that differ between draws, heaters, losses, bodies: whatever a
    bundled rig has."""
    twin = Twin(rig)
    experiment, draws = drive(twin), draws_around(twin, 12)
    found = simulate_batch(twin, experiment, draws)
    np.testing.assert_allclose(found, by_jax(simulate_batch, twin, experiment, draws), atol=NEAR)


@pytest.mark.slow
def test_a_drive_that_changes_at_every_sample_has_the_same_answer(by_jax):
    twin = Twin("dual-cell")
    rng = np.random.default_rng(1)
    time = np.arange(121.0)
    experiment = Experiment(time, rng.choice([0.2, 0.8], (121, 2)))
    draws = {"R_E": np.linspace(1.5, 2.5, 9), "t_lag": np.linspace(2.0, 9.0, 9)}
    found = simulate_batch(twin, experiment, draws)
    np.testing.assert_allclose(found, by_jax(simulate_batch, twin, experiment, draws), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_reductions_are_those_of_jax(precision, by_jax):
    """With samples missing, channels chosen, a room that changes and one draw that is invalid."""
    twin = Twin("dual-cell")
    time = np.arange(301.0)
    duty = np.where(time < 150, 0.5, 0.8)[:, None] * np.ones(2)
    room = 20 + np.where(time < 100, 0.0, 1.5)
    recorded = 20 + 30 * (1 - np.exp(-time / 80))[:, None] * np.ones(2)
    recorded[50:80, 0] = np.nan
    experiment = Experiment(
        time, duty, channels=("T11", "TCM"), temperatures=recorded, ambient=room
    )
    draws = {"R_E": np.array([1.8, 2.0, -1.0, 2.2]), "g_T11": np.array([0.9, 1.0, 1.0, 1.1])}
    names: list[ReductionName] = list(REDUCTIONS)
    found = reduce_batch(twin, experiment, draws, names, precision=precision)
    other = by_jax(reduce_batch, twin, experiment, draws, names, precision=precision)
    assert found.failed.tolist() == other.failed.tolist() == [False, False, True, False]
    for name in names:
        assert found[name].dtype == other[name].dtype
        assert np.isnan(found[name][2]).all()
        np.testing.assert_allclose(found[name], other[name], rtol=2e-3, atol=2e-3)


@pytest.mark.slow
def test_the_extremes_of_a_failed_draw_are_nan(by_jax):
    """XLA:CPU finds infinite extremes of NaN."""
    twin = Twin("paper-2024")
    experiment, draws = drive(twin), {"R_E": np.array([2.0, -1.0])}
    names: list[ReductionName] = ["minimum", "maximum"]
    for found in (
        reduce_batch(twin, experiment, draws, names),
        by_jax(reduce_batch, twin, experiment, draws, names),
    ):
        for name in names:
            assert np.isnan(found[name]).any(axis=1).tolist() == [False, True]
            assert np.isnan(found[name][1]).all()


@pytest.mark.slow
def test_the_cost_of_draws_that_differ_in_the_delay_is_that_of_jax(by_jax):
    """Each is then compared sample by sample; the samples of a recording are missing at times."""
    twin = Twin("dual-cell")
    step = drive(twin, 120)
    recorded = np.array(twin.simulate(step).temperatures)
    recorded[40:60, 3] = np.nan
    experiment = Experiment(step.time, step.duty, channels=twin.channels, temperatures=recorded)
    draws = {"t_delay": np.linspace(0.5, 6.0, 9), "R_E": np.linspace(1.8, 2.1, 9)}
    names: list[ReductionName] = ["cost", "minimum", "maximum"]
    found = reduce_batch(twin, experiment, draws, names)
    other = by_jax(reduce_batch, twin, experiment, draws, names)
    for name in names:
        np.testing.assert_allclose(found[name], other[name], rtol=2e-3, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("averaging", ["voltage", "on-off"])
def test_energy_and_peak_power_do_not_depend_on_the_samples(averaging, by_jax):
    """They are those of JAX with twenty samples a second, between which it takes temperatures to be
    linear. The rig has a current limit, a heater at the supply and one of a given power."""
    twin = Twin(cell_and_heater(averaging))
    names: list[ReductionName] = ["energy", "peak_power"]
    draws = {"R_E": np.array([1.5, 2.0, 2.5])}

    def run(part: float) -> Experiment:
        time = np.arange(round(60 / part) + 1) * part
        later = (time >= 30)[:, None]
        return Experiment(time, np.where(later, [[-0.9, 0.2, 1.0]], [[0.7, 0.5, 0.3]]))

    found = reduce_batch(twin, run(1.0), draws, names)
    other = by_jax(reduce_batch, twin, run(0.05), draws, names)
    np.testing.assert_allclose(found["energy"], other["energy"], rtol=3e-5)
    np.testing.assert_allclose(found["peak_power"], other["peak_power"], rtol=3e-5)


@pytest.mark.slow
def test_a_steady_start_and_own_starts_are_those_of_jax(by_jax):
    twin = Twin("dual-cell")
    experiment = drive(twin, 200)
    draws = {"R_Th": np.array([1.4, 1.6, 1.8])}
    for initial in ("steady", 35.0, {twin.netlist.nodes[0].name: 40.0}):
        found = simulate_batch(twin, experiment, draws, initial=initial)
        other = by_jax(simulate_batch, twin, experiment, draws, initial=initial)
        np.testing.assert_allclose(found, other, atol=NEAR)


def test_results_do_not_depend_on_chunks_or_on_the_draws_beside():
    """A draw keeps its lane's numbers to itself."""
    twin = Twin("paper-2024")
    experiment, draws = drive(twin, 100), draws_around(twin, 21)
    whole = simulate_batch(twin, experiment, draws)
    parts = simulate_batch(twin, experiment, draws, chunk_size=5, workers=2)
    np.testing.assert_allclose(whole, parts, atol=1e-11)


def test_out_is_filled_and_returned():
    twin = Twin("paper-2024")
    experiment, draws = drive(twin, 60), {"R_E": np.array([1.5, 2.0])}
    expected = simulate_batch(twin, experiment, draws)
    for precision in ("float64", "float32"):
        out = np.full(expected.shape, -1.0, precision)
        found = simulate_batch(twin, experiment, draws, precision=precision, out=out)
        assert found is out
        np.testing.assert_allclose(out, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("out", "told"),
    [
        (np.empty((2, 61, 14)), r"expected an array of shape \(2, 61, 15\)"),
        (np.empty((2, 61, 15), np.float32), "float64, got shape"),
        (np.empty((2, 61, 30))[:, :, ::2], "contiguous"),
    ],
)
def test_an_array_that_cannot_hold_the_temperatures_is_refused(out, told):
    twin = Twin("paper-2024")
    with pytest.raises(SimulationError, match=told):
        simulate_batch(twin, drive(twin, 60), {"R_E": [1.5, 2.0]}, out=out)


def test_without_a_compiler_draws_are_solved_by_jax(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    state = native_state()
    assert state.compiler is None
    assert "no-such-compiler" in state.reason
    assert native_library("") is None


def test_one_setting_turns_it_off(monkeypatch):
    monkeypatch.setenv(VARIABLE, "off")
    assert native_state() == (None, f"by JAX; C is off by {VARIABLE}")


CHILD = """
import numpy as np
from jaxtwin import Experiment, Twin, reduce_batch, simulate_batch
from jaxtwin.simulation import _native_library

checks = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_native_library.FLAGS += checks
time = np.arange(61.0)
rigs = {"dual-cell": ("T11", "TCM", "T26"), "single-cell": (), "heated-box": ()}
inputs = {"fan": np.where(time < 20, 1.0, 0.2), "lid": 1.0}
for rig, channels in rigs.items():
    twin = Twin(rig)
    names = [name for name in channels if name in twin.channels] or list(twin.channels)
    later = -0.4 if rig != "heated-box" else 0.2
    duty = np.outer(np.where(time < 30, 0.5, later), np.ones(len(twin.wiring.cold)))
    recorded = np.full((61, len(names)), 20.0)
    experiment = Experiment(time, duty, channels=names, temperatures=recorded)
    name = "R_E" if rig != "heated-box" else "R_heater"
    if rig == "heated-box":
        experiment = experiment.with_inputs(**inputs)
    draws = {name: np.linspace(1.0, 3.0, 11)}
    draws[name][4] = -1.0
    reductions = ["cost", "final", "minimum", "maximum", "energy", "peak_power"]
    if rig == "dual-cell":
        reductions += ["plate_range"]
        draws["t_delay"] = np.linspace(0.5, 4.0, 11)
    for precision in ("float64", "float32"):
        simulate_batch(twin, experiment, draws, precision=precision)
        reduce_batch(twin, experiment, draws, reductions, precision=precision)
print(_native_library._library.cache_info().currsize, "libraries")
"""


@pytest.mark.slow
def test_sanitizers_find_no_wrong_access_and_no_undefined_operation():
    """Numbers of draws and channels that fill no vector, a failed draw, both precisions."""
    libraries = [
        subprocess.run(
            ["cc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    environment = os.environ | {
        "LD_PRELOAD": ":".join(libraries),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own
        "JAXTWIN_COMPILATION_CACHE": "off",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",  # only the library in C is looked at
    }
    done = subprocess.run(
        [sys.executable, "-c", CHILD], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "3 libraries\n"
    assert "solved by JAX" not in done.stderr


def test_a_compiler_that_fails_is_told_and_does_without(monkeypatch, caplog):
    monkeypatch.setattr(_native_library, "FLAGS", ("--no-such-flag",))
    _native_library._library.cache_clear()
    header = native_network(Twin("single-cell").system(lumped=True).wiring).header
    assert native_library(header) is None
    assert "draws are solved by JAX" in caplog.text
    _native_library._library.cache_clear()


def test_the_correction_makes_the_continuous_output_exact_to_the_fifth_order():
    r"""For $\dot y = z y$ with a step of 1 from 1, as series in $z$: the coefficient of $z^5$ is
    $s^5 / 5!$ at any part $s$ of the step."""
    terms = 6
    one, z = np.eye(terms)[0], np.eye(terms)[1]

    def times(a, b):
        return np.convolve(a, b)[:terms]

    inverse = GAMMA ** np.arange(1, terms + 1)
    stages, state = [], one
    for number in range(8):
        state = one + sum(STATE_TABLE[number][j] * stages[j] for j in range(number))
        right = times(z, state) + sum(SLOPE_TABLE[number][j] * stages[j] for j in range(number))
        stages.append(times(inverse, right))
    end = state + stages[-1]
    two, three, four = (sum(w * k for w, k in zip(row, stages, strict=True)) for row in DENSE)
    for s in (0.2, 0.5, 0.9):
        correction = sum(weight * s**power for power, weight in enumerate(CORRECTION))
        value = (1 - s) * one + s * end + s * (1 - s) * (two + s * (three + s * four))
        expected = [s**n / factorial(n) for n in range(terms)]
        np.testing.assert_allclose(value + correction * stages[-1], expected, atol=1e-12)


@given(st.integers(1, 12), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_elimination_by_rows_solves_any_diagonally_dominant_system(size, seed):
    """Its tables, followed in NumPy as `factorise` and `solve` of `rodas5p.c` do."""
    rng = np.random.default_rng(seed)
    pattern = rng.random((size, size)) < 0.3
    pattern |= pattern.T | np.eye(size, dtype=bool)
    matrix = np.where(pattern, rng.normal(size=(size, size)), 0) + 2 * size * np.eye(size)
    right = rng.normal(size=size)
    table = Elimination(pattern)
    ordered = matrix[np.ix_(table.order, table.order)]
    factors = np.zeros(len(table.factor_column))
    rows = np.repeat(np.arange(size), np.diff(table.row))
    factors[table.place[rows, table.column]] = ordered[rows, table.column]
    changed = iter(table.changed)
    for i in range(size):
        for p in range(table.factor_row[i], table.diagonal[i]):
            k = table.factor_column[p]
            factors[p] *= factors[table.diagonal[k]]
            for q in range(table.diagonal[k] + 1, table.factor_row[k + 1]):
                factors[next(changed)] -= factors[p] * factors[q]
        factors[table.diagonal[i]] = 1 / factors[table.diagonal[i]]
    x = right[table.order]
    for i in range(size):
        for p in range(table.factor_row[i], table.diagonal[i]):
            x[i] -= factors[p] * x[table.factor_column[p]]
    for i in reversed(range(size)):
        for p in range(table.diagonal[i] + 1, table.factor_row[i + 1]):
            x[i] -= factors[p] * x[table.factor_column[p]]
        x[i] *= factors[table.diagonal[i]]
    expected = np.linalg.solve(matrix, right)[table.order]
    np.testing.assert_allclose(x, expected, atol=1e-12)
