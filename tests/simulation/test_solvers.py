"""The default solver: its order, and other solvers in its place."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import interp1d

from jaxtwin import Experiment, Twin, response, simulate, simulate_batch
from jaxtwin.errors import RecordingError, SimulationError
from jaxtwin.simulation import NetworkExponential, TimeGrid, build_time_grid, solve_network
from jaxtwin.simulation._interpolation import step_polynomials
from jaxtwin.simulation._refinement import ERROR_TOLERANCE, needs_shorter_steps
from jaxtwin.simulation._simulate import run_exponential
from jaxtwin.simulation._time_grid import time_grid

# One minute with both cells apart, reversed after a third.
TIME = np.arange(61.0)
STEPS = Experiment(TIME, np.where(TIME < 20, 1, -1)[:, None] * np.array([0.5, 0.8]))

FIXED = diffrax.PIDController(rtol=1e-6, atol=1e-6, dtmax=0.1)


@pytest.fixture(scope="module")
def dual_cell() -> Twin:
    """With a driver that lags and delays, and losses that are not linear."""
    return Twin("dual-cell")


@pytest.mark.slow
@pytest.mark.parametrize("values", [pytest.param("startup", marks=pytest.mark.long), "initial"])
def test_default_solver_is_of_fourth_order(values, circuits, twins, float64):
    """Halving equal steps over 16 s lowers the error sixteenfold, on the rig's equations."""
    twin, circuit = twins[values], circuits[values]
    time, duty = np.array([0.0, 16.0]), np.full((2, 2), 0.5)
    exact = circuit.solve(time, duty)[-1]
    errors = []
    for steps in (16, 32, 64):
        first_and_last = np.array([0, steps - 1], dtype=np.int32)
        grid = TimeGrid(
            times=time,
            sizes=np.array([16.0 / steps]),
            size=np.zeros(steps, dtype=np.int32),
            duty=np.full((steps, 2), 0.5),
            ambient=None,
            polynomials=step_polynomials([np.full(steps, 16.0 / steps)]),
            step_of=first_and_last,
            weights=np.eye(6)[[0, 2]],  # value at the start of one, at the end of the other
            ambient_at=None,
        )
        system = twin.system()
        _, deviation = solve_network(system, grid, system.initial_temperature, np.eye(28))
        errors.append(np.abs(np.asarray(deviation)[-1] + 15.0 - exact).max())
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.25)


def largest_difference(twin: Twin, solver, **options) -> float:
    other = twin.simulate(STEPS, solver=solver, **options)
    return np.abs(twin.simulate(STEPS).states - other.states).max()


@pytest.mark.long
def test_kvaerno5_gives_the_same_on_the_paper_s_circuit(twins):
    """Voltage averaging; a stiff solver of diffrax's own."""
    assert largest_difference(twins["startup"], diffrax.Kvaerno5()) < 1e-3


@pytest.mark.slow
def test_kvaerno5_gives_the_same_with_on_off_switching(dual_cell):
    """Plate by geometry, cells braked while they are off, sinks with a mass."""
    assert largest_difference(dual_cell, diffrax.Kvaerno5()) < 1e-3


@pytest.mark.slow
def test_samples_before_a_late_command_are_right(dual_cell):
    """A minute in which a plate warmer than the room cools undriven."""
    late = dual_cell.with_values({"t_delay": 60.0, "T_start": 40.0})
    assert largest_difference(late, diffrax.Kvaerno5()) < 1e-3


@pytest.mark.slow
def test_explicit_solver_with_small_steps_gives_the_same(dual_cell):
    """Tsit5 at 0.1 s, below every time constant of this twin's nodes."""
    assert largest_difference(dual_cell, diffrax.Tsit5(), stepsize_controller=FIXED) < 1e-3


@pytest.mark.slow
def test_our_own_step_as_a_diffrax_solver_gives_the_same(dual_cell):
    """With diffrax choosing the steps by the embedded error estimate."""
    controller = diffrax.PIDController(rtol=1e-5, atol=1e-5)
    difference = largest_difference(
        dual_cell, NetworkExponential(), stepsize_controller=controller, dt0=0.01
    )
    assert difference < 1e-3


@pytest.mark.slow
def test_solver_without_an_error_estimate_takes_the_default_solver_s_steps(circuits, twins):
    """Explicit Euler, step by step by hand; a change of input at the last sample is not felt."""
    duty = np.vstack([STEPS.duty[:-1], [[0.0, 0.0]]])
    experiment = Experiment(TIME, duty)
    grid, circuit = build_time_grid(experiment), circuits["initial"]
    times, states = [0.0], [circuit.start()]
    for size, held in zip(grid.sizes[grid.size], grid.duty, strict=True):
        times.append(times[-1] + size)
        states.append(states[-1] + size * circuit.rate(states[-1], held, 288.15))
    by_hand = interp1d(times, np.array(states) - 273.15, axis=0)(np.minimum(TIME, times[-1]))
    run = twins["initial"].simulate(experiment, solver=diffrax.Euler())
    np.testing.assert_allclose(run.states, by_hand, atol=1e-6)


@pytest.mark.slow
def test_solver_that_leaves_the_finite_numbers_is_an_error(twins):
    """Explicit Euler on a cell side that settles in a millisecond."""
    with pytest.raises(SimulationError, match=r"paper-2024: .* do not stay finite"):
        twins["published"].simulate(STEPS, solver=diffrax.Euler())


@pytest.mark.slow
def test_solver_that_gives_up_is_an_error(twins):
    """The reason is diffrax's own."""
    controller = diffrax.PIDController(rtol=1e-12, atol=1e-12, dtmin=0.5, force_dtmin=False)
    with pytest.raises(SimulationError, match=r"paper-2024: Tsit5: .*minimum step size"):
        twins["published"].simulate(
            STEPS, solver=diffrax.Tsit5(), stepsize_controller=controller, dt0=1.0
        )


def test_controller_that_steps_over_input_changes_is_refused(twins):
    with pytest.raises(
        SimulationError, match=r"stepsize_controller: expected .* got ConstantStepSize"
    ):
        twins["startup"].simulate(
            STEPS,
            solver=diffrax.Tsit5(),
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=0.1,
        )


@pytest.mark.parametrize(
    "options", [{"dt0": 0.1}, {"stepsize_controller": diffrax.ConstantStepSize()}]
)
def test_steps_without_a_solver_are_refused(twins, options):
    with pytest.raises(SimulationError, match=r"expected a solver beside it, got none"):
        twins["startup"].simulate(STEPS, **options)


def test_first_step_of_a_solver_without_an_error_estimate_is_refused(twins):
    with pytest.raises(SimulationError, match=r"dt0: expected None for Euler.* got 0.1"):
        twins["startup"].simulate(STEPS, solver=diffrax.Euler(), dt0=0.1)


def test_default_solver_compiles_once_for_all_parameter_values(twins, caplog):
    """A second run with other values and other duty cycles of the same shape compiles nothing."""
    twins["startup"].simulate(STEPS)
    with jax.log_compiles():
        caplog.clear()
        twins["published"].simulate(Experiment(STEPS.time, -0.5 * STEPS.duty))
        assert not compiled(caplog)
        # The log does speak: what nobody has compiled before compiles.
        jax.jit(lambda x: x + 1)(1.0)
        assert compiled(caplog)


@pytest.mark.parametrize(
    ("stability_number", "error_estimate", "refinement", "is_refused"),
    [
        (1.0, 2.0e-3, 0, False),
        (1.0, 2.1e-3, 0, True),
        (1.1, 2.0e-3, 0, True),
        (1.0, 1.0e-3, 2, False),
        (1.0, 1.1e-3, 2, True),
        (np.inf, 0.0, 0, True),
        (1.0, np.nan, 0, True),  # did not stay finite
        (np.nan, 1.0, 0, False),  # shorter steps do not help
    ],
)
def test_steps_are_short_enough_up_to_a_stability_number_and_an_error_estimate(
    stability_number, error_estimate, refinement, is_refused
):
    """1, and 2 mK, or 1 mK for steps that have been halved."""
    found = needs_shorter_steps(
        np.array([stability_number]), np.array([error_estimate]), refinement
    )
    assert found.tolist() == [is_refused]


@pytest.mark.slow
def test_a_solution_with_a_large_error_estimate_is_solved_again_with_shorter_steps(float64):
    """Cells of low resistance behind poor contacts: on the longest steps the channels are more than
    1e-3 K from what very short ones give, `simulate` and `simulate_batch` are not."""
    values = {"R_E": 0.1, "R_ph": 1.3, "R_pc": 0.1, "R_Tfx2": 1.9, "C_esp": 110.0}
    twin = Twin("paper-2024", values)
    drive = Experiment(np.arange(201.0), np.full((201, 2), 0.6))

    def on_steps_halved(times: int) -> tuple[np.ndarray, float]:
        _, readings, _, error_estimate = run_exponential(twin, time_grid(twin, drive, times), None)
        return np.asarray(readings) - 273.15, float(error_estimate)

    (longest, error_estimate), (fine, _) = on_steps_halved(0), on_steps_halved(6)
    assert error_estimate > ERROR_TOLERANCE
    assert np.abs(longest - fine).max() > 1e-3
    np.testing.assert_allclose(twin.simulate(drive).temperatures, fine, atol=1e-3)
    draws = {"R_E": np.array([2.0, 0.1, 1.8])}
    batch = simulate_batch(twin, drive, draws, chunk_size=3)
    np.testing.assert_allclose(batch[1], fine, atol=1e-3)
    ordinary = twin.with_values({"R_E": 1.8}).simulate(drive)
    np.testing.assert_allclose(batch[2], ordinary.temperatures, atol=1e-4)


def compiled(caplog) -> list[str]:
    return [record.message for record in caplog.records if "Compiling" in record.message]


@pytest.mark.slow
def test_a_recorded_room_is_the_same_to_another_solver(twins):
    """Also where its temperature rises by 4 K in half a minute and starts away from the rig's."""
    room = np.where(TIME < 30, 21.0, 25.0)
    drive = Experiment(TIME, STEPS.duty, ambient=room)
    other = twins["startup"].simulate(drive, solver=diffrax.Kvaerno5())
    ours = twins["startup"].simulate(drive)
    np.testing.assert_allclose(ours.temperatures, other.temperatures, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_a_drive_that_is_reversed_at_every_sample_is_exact(dual_cell: Twin):
    """The lagged duty passes zero between samples, where the heat of an on/off drive has a kink: in
    a sample after a reversal too."""
    duty = np.random.default_rng(1).uniform(-0.6, 0.6, (41, 2))
    experiment = Experiment(np.arange(41.0), duty)
    exact = dual_cell.simulate(experiment, solver=diffrax.Kvaerno5(), stepsize_controller=FIXED)
    found = dual_cell.simulate(experiment)
    np.testing.assert_allclose(found.temperatures, exact.temperatures, atol=5e-4)


@pytest.mark.slow
def test_samples_between_the_ends_of_long_steps_follow_fast_modes():
    """A small load with a strong film, at the edge of the bounds: its fastest mode has 390 of its
    time constants in a step of 32 s. The slope of that mode as the force at the amplitudes minus
    rate times amplitude led to 64 mK between the ends of the steps, where the amplitudes are right
    within 1.4 mK."""
    values = {"C_load": 1.086, "R_loss": 0.1303, "n_film": 0.4093, "alpha": 0.01516}
    values |= {"R_E": 5.456, "R_Th": 2.523, "C_side": 1.359, "R_pc": 0.1645, "R_ph": 2.991}
    values |= {"C_sink": 1170.0, "R_sink": 0.639, "R_supply": 1.638, "g_T": 1.095}
    twin = Twin("single-cell", values | {"T_amb": 28.61, "T_start": 31.76, "T_sink": 42.0})
    drive = Experiment.schedule("0:0.5,500:0.78", duration=1000, cells=1)
    exact = twin.simulate(drive, solver=diffrax.Kvaerno5()).temperatures
    assert np.abs(twin.simulate(drive).temperatures - exact).max() < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "hold"),
    [
        ("single-cell", 3.0),
        ("dual-cell", 0.2),
        *(
            pytest.param(rig, hold, marks=pytest.mark.long)
            for rig, hold in (
                ("single-cell", 0.2),
                ("single-cell", 1.0),
                ("dual-cell", 1.0),
                ("dual-cell", 3.0),
                ("pcr-block", 0.2),
                ("pcr-block", 1.0),
                ("pcr-block", 3.0),
            )
        ),
    ],
)
def test_samples_between_two_changes_of_the_duty_are_as_exact_as_those_at_them(
    rig: str, hold: float
):
    """Ten samples a second, and a duty that is held for a fifth of a second to three seconds,
    beside Kvaerno5 at 1e-9."""
    twin = Twin(rig)
    time = 0.1 * np.arange(101)
    number = np.floor((time + 1e-9) / hold).astype(int)
    rng = np.random.default_rng(0)
    duty = rng.uniform(0.2, 0.8, (number.max() + 1, len(twin.rig.cells)))[number]
    drive = Experiment(time, duty, channels=twin.channels)
    exact = simulate(
        twin,
        drive,
        solver=diffrax.Kvaerno5(),
        stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9),
    )
    np.testing.assert_allclose(
        simulate(twin, drive).temperatures, exact.temperatures, rtol=0, atol=1e-3
    )


@pytest.mark.slow
def test_a_draw_that_does_not_stay_finite_is_solved_with_shorter_steps():
    """Two draws whose first solution overflows, among sixty that are solved at once. XLA's largest
    of several NaN is not NaN in a chunk of this size."""
    twin = Twin("single-cell")
    drive = Experiment.schedule("0:0.5,500:0.78", duration=1000, cells=1, channels=twin.channels)
    odd = {
        "C_load": 5.587906953688283, "R_loss": 0.20900559584369316, "n_film": 0.937910481158186,
        "alpha": 0.05690241706441305, "R_E": 9.752725982993043, "R_Th": 3.6179001685692738,
        "C_side": 34.02378842686504, "R_pc": 0.49176480432200953, "R_ph": 0.012386471183787336,
        "C_sink": 9020.2185939587, "R_sink": 5.376701108533904, "R_supply": 0.036994348207002786,
        "g_T": 0.6378794934366826, "T_amb": 10.905613322882607, "T_start": 62.19059473430268,
        "T_sink": 39.24878922687994,
    }  # fmt: skip
    draws = {name: np.full(64, twin.values[name]) for name in odd}
    for name, value in odd.items():
        draws[name][[5, 40]] = value
    found = simulate_batch(twin, drive, draws)
    alone = simulate(twin.with_values(odd), drive).temperatures
    np.testing.assert_allclose(found[[5, 40]], np.stack([alone] * 2), rtol=0, atol=1e-4)


@pytest.mark.usefixtures("float64")
def test_a_solver_of_diffrax_is_differentiated_in_both_directions():
    twin = Twin("single-cell")
    plan = Experiment.schedule("0:0.5", duration=30)

    def heat(value, **options):
        return response(twin.with_values({"R_pc": value}), plan, **options).sum()

    value = float(twin.values["R_pc"])
    expected = jax.jacfwd(heat)(value)
    by_solver = [
        differentiate(lambda v: heat(v, solver=diffrax.Tsit5()))(value)
        for differentiate in (jax.grad, jax.jacfwd)
    ]
    np.testing.assert_allclose(by_solver, float(expected), rtol=1e-4)


def test_a_traced_duty_is_answered_with_what_can_be_differentiated():
    def heat(duty):
        return Experiment([0.0, 1.0], jnp.full((2, 1), duty))

    with pytest.raises(RecordingError, match=r"duty: expected numbers, .* jaxtwin.Stepper"):
        jax.grad(heat)(0.5)
