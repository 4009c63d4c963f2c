"""MPC: the regulator where no limit is active, hard limits, and a loop without offset."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag

from jaxtwin import Twin, linearize, simulate_closed_loop
from jaxtwin.control import MPC, HeatInput, StateSpace, design_mpc
from jaxtwin.control.controllers._mpc import MPCState
from jaxtwin.control.linear._riccati import regulator
from jaxtwin.errors import ControlError

BOTH = ("left", "right")


def plate() -> StateSpace:
    """Two places that warm each other, each with a cell behind lag and delay."""
    A = np.array([[-0.03, 0.01], [0.008, -0.025]])
    B = np.array([[1.2, 0.1], [0.1, 1.0]])
    model = StateSpace(A, B, np.eye(2), np.zeros((2, 2)), output_names=BOTH, delay_s=2.5, lag_s=3)
    return model.discretise(1.0)


def followed(
    mpc: MPC, model: StateSpace, references: np.ndarray, heat: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and duty from rest, with heat that acts as a duty of all cells would."""
    with jax.enable_x64(True):
        weights = mpc.reading_weights(model.output_names)
        step = jax.jit(lambda state, r, y: mpc.step(state, r, y))
        x = np.zeros(len(model.A))
        state = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), np.zeros(len(weights))))
        outputs, duties = [], []
        for reference in references:
            outputs.append(weights @ model.C @ x)
            duty, state = step(state, reference, outputs[-1])
            duties.append(np.asarray(duty))
            x = model.A @ x + model.B @ (duties[-1] + heat)
        return np.array(outputs)[:, :2], np.array(duties)


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1, 7])
def test_an_mpc_without_an_active_limit_is_the_regulator(horizon: int):
    """Of x and the last duty, with changes of the duty as input, whatever the horizon."""
    model = plate()
    mpc = design_mpc(
        model, measured=BOTH, horizon=horizon, output_deviation=2.0, duty_deviation=0.5
    )
    n = len(model.A)
    A = np.block([[model.A, model.B], [np.zeros((2, n)), np.eye(2)]])
    Q = np.asarray(block_diag(model.C.T @ model.C / 4, np.eye(2) / 0.5**2))
    K, _ = regulator("test", A, np.vstack([model.B, np.eye(2)]), Q, np.eye(2) / 0.05**2)
    random = np.random.default_rng(3)
    states, last = 0.02 * random.normal(size=n), np.array([0.01, -0.02])
    reference = np.array([0.2, 0.1])
    rest = np.linalg.solve(np.eye(n) - model.A, model.B)
    aim = np.linalg.solve(model.C @ rest, reference)
    change = -K @ np.r_[states - rest @ aim, last - aim]
    with jax.enable_x64(True):
        estimated = jnp.asarray(np.r_[states, 0, 0])
        state = MPCState(estimated, jnp.asarray(last), jnp.zeros(0), jnp.zeros(()))
        duty, _ = jax.jit(lambda s, r, y: mpc.step(s, r, y))(state, reference, model.C @ states)
    np.testing.assert_allclose(duty, last + change, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_limits_of_duty_and_rate_are_hard_and_heat_leaves_no_offset():
    model = plate()
    mpc = design_mpc(model, measured=BOTH, limits=(0, 0.5), rate_limit=0.05, horizon=10)
    outputs, duty = followed(mpc, model, np.tile([16.0, 13.0], (300, 1)), heat=0.05)
    assert duty.min() >= 0
    assert 0.5 - 1e-9 < duty.max() <= 0.5
    changes = np.diff(duty, axis=0, prepend=0)
    assert np.abs(changes).max() == pytest.approx(0.05, abs=1e-12)
    np.testing.assert_allclose(outputs[-1], [16.0, 13.0], atol=1e-3)
    assert np.max(outputs - [16.0, 13.0]) < 1.0


@pytest.mark.slow
def test_an_mpc_at_its_limit_does_not_wind_up():
    model = plate()
    mpc = design_mpc(model, measured=BOTH, limits=(-1, 0.3), horizon=10)
    aims = np.r_[np.full((300, 2), 60.0), np.full((5, 2), 5.0)]
    _, duty = followed(mpc, model, aims)
    np.testing.assert_allclose(duty[100:300], 0.3, atol=1e-6)
    assert np.all(duty[300] < 0.25)


@pytest.mark.slow
def test_a_temperature_limit_is_kept_while_the_other_output_goes_on():
    """The reference asks for more than the limit of one side; nothing tells the other."""
    model = plate()
    limits: Any = {"left": (-5, 10)}
    mpc = design_mpc(
        model, measured=BOTH, horizon=10, temperature_limits=limits, excess_deviation=0.05
    )
    outputs, _ = followed(mpc, model, np.tile([16.0, 13.0], (300, 1)), heat=0.05)
    assert np.max(outputs[:, 0]) < 10.1
    np.testing.assert_allclose(outputs[-1], [10.0, 13.0], atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_of_limits_that_exclude_each_other_the_one_of_smaller_accepted_excess_is_kept(first: int):
    """The right place shall be warm, which warms the left one, and no cell can cool."""
    model = plate()
    accepted = np.array([1.0, 1.0])
    accepted[first] = 0.01
    limits: Any = {"left": (-5, 10, accepted[0]), "right": (30, 90, accepted[1])}
    mpc = design_mpc(model, measured=BOTH, limits=(0, 1), temperature_limits=limits)
    outputs, _ = followed(mpc, model, np.zeros((600, 2)))
    beyond = np.array([outputs[-1, 0] - 10, 30 - outputs[-1, 1]])
    assert beyond[first] < 0.05
    assert beyond[1 - first] > 2


@pytest.mark.slow
def test_a_start_beyond_a_temperature_limit_is_left_as_fast_as_the_duty_allows():
    """Soft: there is a plan, although none keeps the limit."""
    model = plate()
    limits: Any = {"left": (-5, -1)}
    mpc = design_mpc(
        model, measured=BOTH, horizon=10, limits=(-0.2, 0.2), temperature_limits=limits
    )
    outputs, duty = followed(mpc, model, np.zeros((200, 2)))
    assert duty[0, 0] == pytest.approx(-0.2, abs=1e-6)
    np.testing.assert_allclose(outputs[-1], [-1.0, 0.0], atol=0.05)


@pytest.mark.slow
def test_heat_beside_a_limited_channel_is_seen_by_its_own_sensor(twin: Twin):
    """10 W at T11, of which TAM and TCM tell little: T11 stays below its limit, which gives way to
    the reference, and TCM is held. Without the limit T11 comes to 46 degC."""
    model = linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(1.0)
    limits: Any = {"T11": (0, 39)}
    mpc = design_mpc(
        model,
        measured=["TAM", "TCM"],
        duty_deviation=0.04,
        reading_noise=0.5,
        limits=(0, 1),
        rate_limit=0.05,
        temperature_limits=limits,
    )
    hand = HeatInput(("V11",), 0.0, 900.0, 10.0)
    run = simulate_closed_loop(twin, mpc, 40.0, duration=900, disturbances=[hand])
    T11 = run.run.temperatures[:, twin.channels.index("T11")]
    assert T11[run.time > 120].max() < 39.5
    assert T11[-1] > 38.8
    assert run.output[-1, 1] == pytest.approx(40.0, abs=0.2)
    assert not run.exceeded


@pytest.mark.slow
def test_the_rounded_duty_keeps_the_rate_limit(twin: Twin):
    """0.05 of 255 counts are 12.75: rounded changes of 13 would exceed it."""
    model = linearize(twin, temperatures={"TAM": 30.0, "TCM": 30.0}).reduce(4).discretise(1.0)
    mpc = design_mpc(model, measured=["TAM", "TCM"], limits=(0, 1), rate_limit=0.05)
    run = simulate_closed_loop(twin, mpc, 30.0, duration=60)
    changes = np.abs(np.diff(run.duty, axis=0)).max()
    assert changes == pytest.approx(12 / 255, abs=1e-12)
    with pytest.raises(
        ControlError, match=r"rate_limit: expected at least a count .* 0\.00392 1/s"
    ):
        design_mpc(model, measured=["TAM", "TCM"], rate_limit=0.003).for_rig(twin.rig)


@pytest.mark.slow
def test_a_limit_that_no_duty_keeps_is_named(twin: Twin):
    model = linearize(twin, temperatures={"TAM": 30.0, "TCM": 30.0}).reduce(4).discretise(1.0)
    limits: Any = {"T11": (0, 25), "T16": (0, 90)}
    mpc = design_mpc(model, measured=["TAM", "TCM"], limits=(0, 1), temperature_limits=limits)
    hand = HeatInput(("V11",), 0.0, 300.0, 10.0)
    run = simulate_closed_loop(twin, mpc, 30.0, duration=300, disturbances=[hand])
    (exceeded,) = run.exceeded
    T11 = run.run.temperatures[:, twin.channels.index("T11")]
    assert exceeded.channel == "T11"
    assert exceeded.excess == pytest.approx(T11.max() - 25.0)
    assert exceeded.until == 300.0
    assert T11[run.time < exceeded.since].max() <= 25.1
    assert f"T11 was up to {exceeded.excess:.2f} K above its limit of 25 degC" in repr(run)


@pytest.mark.slow
def test_a_temperature_limit_far_away_changes_nothing():
    model = plate()
    far: Any = {"left": (-500, 500), "right": (-500, 500)}
    references = np.tile([6.0, 3.0], (40, 1))
    _, without = followed(design_mpc(model, measured=BOTH, horizon=10), model, references)
    mpc = design_mpc(model, measured=BOTH, horizon=10, temperature_limits=far)
    _, duty = followed(mpc, model, references)
    np.testing.assert_allclose(duty, without, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_with_preview_the_duty_moves_before_the_reference():
    """The horizon in place of the reference of now: the duty moves before the step does."""
    model = plate()
    mpc = design_mpc(model, measured=BOTH, horizon=10, duty_deviation=0.5)
    steps = np.where(np.arange(60)[:, None] < 30, 0.0, np.array([5.0, 4.0]))
    preview = np.stack([steps[n : n + 10] for n in range(50)])
    with_it, early = followed(mpc, model, preview)
    without, late = followed(mpc, model, steps[:50])
    assert np.all(np.abs(late[:30]) < 1e-8)
    assert np.max(early[:30]) > 0.05
    missed = [np.abs(outputs[:50] - steps[:50]).sum() for outputs in (with_it, without)]
    assert missed[0] < 0.75 * missed[1]


@pytest.mark.slow
def test_a_simulated_loop_gives_the_references_to_come(twin: Twin):
    """With `preview` the duty moves before the reference does, and the error's integral is less."""
    model = linearize(twin, temperatures={"TAM": 30.0, "TCM": 30.0}).reduce(4).discretise(2.0)
    settings: dict[str, Any] = {"duration": 200.0, "noise": False, "quantised": False}
    runs = []
    for preview in (False, True):
        mpc = design_mpc(
            model,
            measured=["TAM", "TCM"],
            limits=(0, 1),
            horizon=12,
            duty_deviation=0.3,
            preview=preview,
        )
        runs.append(simulate_closed_loop(twin, mpc, "0:28/27,140:31/30", **settings))
    without, with_it = runs
    step = int(np.flatnonzero(without.time >= 140)[0])
    # 12 samples of 2 s.
    np.testing.assert_allclose(with_it.duty[: step - 30], without.duty[: step - 30], atol=1e-6)
    before = slice(step - 22, step)
    assert np.ptp(without.duty[before], axis=0).max() < 0.02
    assert np.min(with_it.duty[step - 1] - without.duty[step - 1]) > 0.1
    table = [run.measures()["value"] for run in runs]
    assert table[1]["integral_absolute_error"] < table[0]["integral_absolute_error"]
    assert table[1]["settling_time"] < table[0]["settling_time"]
    since = [np.abs(run.output - run.reference)[step - 30 :].sum() for run in runs]
    assert since[1] < 0.75 * since[0]


@pytest.mark.slow
def test_an_mpc_takes_over_without_a_jump_of_the_duty():
    mpc = design_mpc(plate(), measured=BOTH)
    with jax.enable_x64(True):
        step = jax.jit(lambda state, r, y: mpc.step(state, r, y))
        duty, measurement = np.array([0.31, -0.12]), np.array([31.0, 33.0])
        state = mpc.init(duty, measurement)
        for _ in range(3):
            found, state = step(state, measurement, measurement)
            np.testing.assert_allclose(found, duty, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_rig_comes_to_its_mean_and_difference_without_offset(twin: Twin):
    model = linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(2.0)
    mpc = design_mpc(model, measured=["TAM", "TCM"], limits=(0, 1), horizon=10)
    hand = HeatInput(elements=("V14", "V15"), start=150, end=400, heat=2.0)
    run = simulate_closed_loop(
        twin,
        mpc,
        "0:33/31",
        duration=400,
        noise=False,
        quantised=False,
        disturbances=[hand],
    )
    np.testing.assert_allclose(run.output[-1], [33.0, 31.0], atol=0.02)
    assert np.max(run.output - [33.0, 31.0]) < 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 0}, "MPC: horizon: expected"),
        ({"rate_limit": 0}, "MPC: rate_limit: expected a number above 0"),
        ({"duty_change_deviation": -1.0}, "MPC: duty_change_deviation: expected a finite"),
        ({"excess_deviation": 0}, "MPC: excess_deviation: expected a finite"),
        ({"temperature_limits": {"top": (0, 1)}}, "MPC: temperature_limits: unknown channel 'top'"),
        ({"temperature_limits": {"left": (2, 1)}}, "left: expected the lowest and the highest"),
        ({"measured": ["left"] * 3}, "MPC: measured: expected at most as many outputs"),
    ],
)
def test_invalid_designs_of_an_mpc_are_refused(arguments: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        design_mpc(plate(), **arguments)
