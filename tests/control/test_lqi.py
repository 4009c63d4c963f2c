"""LQI: gains by hand and by python-control, limits, start, and a loop without offset."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Twin, export_c, linearize, simulate_closed_loop
from jaxtwin.control import (
    LQI,
    MPC,
    HeatInput,
    StateSpace,
    design_lqi,
    design_mpc,
    read_controller,
    save_controller,
)
from jaxtwin.control.linear._riccati import filter_gain, regulator
from jaxtwin.errors import ControlError

GOLDEN = (1 + 5**0.5) / 2


def plate(*, delay_s: float = 2.5, D: Any = ((0.0, 0.0), (0.0, 0.0))) -> StateSpace:
    """Two places that warm each other, each with a cell."""
    A = np.array([[-0.03, 0.01], [0.008, -0.025]])
    B = np.array([[1.2, 0.1], [0.1, 1.0]])
    names = ["left", "right"]
    model = StateSpace(A, B, np.eye(2), np.array(D), output_names=names, delay_s=delay_s, lag_s=3.0)
    return model.discretise(1.0)


def followed(
    controller: Any, model: StateSpace, reference: list[float], samples: int, heat: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and duty from rest, with heat that acts as a duty of all cells would."""
    with jax.enable_x64(True):
        weights = controller.output_weights(model.output_names)
        step = jax.jit(lambda state, r, y: controller.step(state, r, y))
        x, last = np.zeros(len(model.A)), np.zeros(2)
        state = jax.tree.map(jnp.asarray, controller.init(last, np.zeros(len(weights))))
        outputs, duties = [], []
        for _ in range(samples):
            y = weights @ (model.C @ x + model.D @ last)
            duty, state = step(state, np.array(reference), y)
            last = np.asarray(duty)
            x = model.A @ x + model.B @ (last + heat)
            outputs.append(y)
            duties.append(last)
        return np.array(outputs), np.array(duties)


def test_gains_of_a_scalar_are_those_by_hand():
    """With a = b = q = r = 1, P = 1 + P - P² / (1 + P) is the golden ratio."""
    unit = np.eye(1)
    K, P = regulator("test", unit, unit, unit, unit)
    np.testing.assert_allclose(P, GOLDEN, rtol=1e-12)
    np.testing.assert_allclose(K, GOLDEN / (1 + GOLDEN), rtol=1e-12)
    L = filter_gain("test", unit, unit, unit, unit)
    np.testing.assert_allclose(L, GOLDEN / (1 + GOLDEN), rtol=1e-12)


@pytest.mark.python_control
def test_gains_are_those_of_python_control():
    import control

    model = plate()
    given = {"output_deviation": [0.5, 2.0], "drift": 0.2, "reading_noise": 0.1}
    lqi = design_lqi(model, measured=["left", "right"], **given)
    states, h = len(model.A), lqi.sample_time_s
    A = np.block([[model.A, np.zeros((states, 2))], [-h * model.C, np.eye(2)]])
    B = np.vstack([model.B, np.zeros((2, 2))])
    Q = np.zeros((states + 2, states + 2))
    Q[:states, :states] = model.C.T @ np.diag([4.0, 0.25]) @ model.C
    Q[states:, states:] = np.eye(2) / 30.0**2
    K, _, _ = control.dlqr(A, B, Q, np.eye(2) / 0.5**2)
    np.testing.assert_allclose(np.hstack([lqi.Kx, -lqi.Ki]), K, rtol=1e-7, atol=1e-10)
    kalman = lqi.kalman
    moves = np.vstack([np.zeros((states, 2)), np.eye(2)])
    L, _, _ = control.dlqe(
        np.asarray(kalman.A), moves, np.asarray(kalman.C), np.eye(2) * 0.2**2 * h, np.eye(2) * 0.01
    )
    np.testing.assert_allclose(kalman.A @ kalman.L, L, rtol=1e-6, atol=1e-10)


def test_the_filter_finds_the_disturbance_that_it_was_made_for():
    """In K at rest: a duty of 0.1 that nobody gave."""
    model = plate()
    lqi = design_lqi(model, measured=["left", "right"], reading_noise=0.1)
    gain = model.C @ np.linalg.solve(np.eye(len(model.A)) - model.A, model.B)
    with jax.enable_x64(True):
        x = np.zeros(len(model.A))
        states = jnp.zeros(len(model.A) + 2)
        for _ in range(200):
            states = lqi.kalman.update(states, jnp.asarray(model.C @ x))
            states = lqi.kalman.predict(states, jnp.zeros(2))
            x = model.A @ x + model.B @ np.full(2, 0.1)
    np.testing.assert_allclose(states[-2:], gain @ np.full(2, 0.1), rtol=1e-6)


@pytest.mark.parametrize("direct", [0.0, 0.4])
def test_outputs_come_to_their_references_in_spite_of_heat(direct: float):
    """In the mean and in the difference, also where outputs follow the duty at once."""
    model = plate(delay_s=0.0 if direct else 2.5, D=np.eye(2) * direct)
    lqi = design_lqi(model, measured=["left", "right"])
    outputs, _ = followed(lqi, model, [8.0, 5.0], 800, heat=0.05)
    np.testing.assert_allclose(outputs[-1], [8.0, 5.0], atol=1e-4)
    assert np.max(outputs[:, 0]) < 8.8


def test_two_cells_share_the_duty_for_one_mean():
    model = plate()
    lqi = design_lqi(model)
    outputs, duty = followed(lqi, model, [6.0], 800)
    np.testing.assert_allclose(outputs[-1], 6.0, atol=1e-4)
    assert duty[-1].min() > 0.4 * duty[-1].sum()


def test_a_limit_of_the_duty_does_not_wind_up_the_integrals():
    """Far beyond reach for long, then a reference within: the limit is left within the delay."""
    model = plate()
    lqi = design_lqi(model, measured=["left", "right"], limits=(-1, 0.3), setpoint_weight=1.0)
    with jax.enable_x64(True):
        step = jax.jit(lambda state, r, y: lqi.step(state, r, y))
        x = np.zeros(len(model.A))
        state = jax.tree.map(jnp.asarray, lqi.init(np.zeros(2), np.zeros(2)))
        duties = []
        for sample in range(420):
            aim = np.full(2, 60.0 if sample < 400 else 10.0)
            duty, state = step(state, aim, model.C @ x)
            duties.append(np.asarray(duty))
            x = model.A @ x + model.B @ duties[-1]
    assert np.all(np.array(duties[10:400]) == 0.3)
    assert np.all(duties[402] < 0.3)


@pytest.mark.parametrize("weight", [0.0, 0.6])
@pytest.mark.parametrize("measured", [("left", "right"), None])
def test_an_lqi_takes_over_without_a_jump_of_the_duty(weight: float, measured: Any):
    """Whatever the readings are: what the model does not explain is a disturbance."""
    lqi = design_lqi(plate(), measured=measured, setpoint_weight=weight)
    with jax.enable_x64(True):
        duty, measurement = np.array([0.31, -0.12]), np.array([31.0, 33.0])[: len(lqi.outputs)]
        state = lqi.init(duty, measurement)
        for _ in range(5):
            found, state = lqi.step(state, measurement, measurement)
            np.testing.assert_allclose(found, duty, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_gains_can_be_drawn_and_differentiated():
    lqi = design_lqi(plate(), measured=["left", "right"])
    with jax.enable_x64(True):

        def asked(Ki: jax.Array) -> jax.Array:
            changed = eqx.tree_at(lambda c: c.Ki, lqi, Ki)
            state = changed.init(np.zeros(2), np.zeros(2))
            _, state = changed.step(state, np.ones(2), np.zeros(2))
            return changed.step(state, np.ones(2), np.zeros(2))[0]

        slope = jax.jacfwd(asked)(jnp.asarray(lqi.Ki))
        np.testing.assert_allclose(np.einsum("iij->ij", slope), 1.0, rtol=1e-9)


@pytest.mark.slow
def test_a_rig_comes_to_its_mean_and_difference_without_offset(twin: Twin):
    """Designed on 4 states of the plate at 40 °C, far below, and with heat that nobody told."""
    model = linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(2.0)
    lqi = design_lqi(model, measured=["TAM", "TCM"], limits=(0, 1))
    hand = HeatInput(elements=("V14", "V15"), start=200, end=500, heat=2.0)
    run = simulate_closed_loop(
        twin,
        lqi,
        "0:33/31",
        duration=500,
        noise=False,
        quantised=False,
        disturbances=[hand],
    )
    np.testing.assert_allclose(run.output[-1], [33.0, 31.0], atol=0.02)
    assert np.max(run.output - [33.0, 31.0]) < 1.0


def refusing(message: str, **arguments: Any) -> None:
    model = arguments.pop("model", plate())
    with pytest.raises(ControlError, match=message):
        design_lqi(model, **arguments)


def test_invalid_designs_of_an_lqi_are_refused():
    refusing("LQI: model: expected a discrete model", model=linearize(Twin("tclab"), duty=0.4))
    refusing("LQI: drift: expected a finite number above 0", drift=0.0)
    refusing("LQI: output_deviation: expected .* or 1 of them", output_deviation=[1, 2, 3])
    refusing("LQI: duty_deviation: expected a finite", duty_deviation=np.nan)
    refusing("measured: unknown channel 'middle'", measured=["middle"])
    refusing("expected at most as many outputs as the 2 cells", measured=["left"] * 3)
    alike = ["left", "left"]
    refusing("expected outputs that the cells move differently", measured=alike)
    for pole, message in (
        (0.1, "LQI: expected a model that its inputs can make stable"),
        (0.0, "LQI: model: expected one that comes to rest"),
    ):
        A, B = np.diag([pole, -0.1]), np.array([[0.0], [1.0]])  # no input reaches the first state
        model = StateSpace(A, B, np.ones((1, 2)), np.zeros((1, 1)), output_names=["left"])
        refusing(message, model=model.discretise(1.0))


@pytest.mark.parametrize("design", [design_lqi, design_mpc])
def test_a_controller_of_another_rigs_model_is_refused(twin: Twin, design: Any, tmp_path: Path):
    other = Twin("paper-2024")
    model = linearize(other, duty=0.3).reduce(3).discretise(1.0)
    controller = design(model, measured=["TAM", "TCM"], limits=(0, 1))
    words = "a model of dual-cell, got one designed on a model of paper-2024"
    with pytest.raises(ControlError, match=words):
        simulate_closed_loop(twin, controller, 35.0, duration=60)
    with pytest.raises(ControlError, match=words):
        save_controller(tmp_path / "other.toml", controller, twin.rig)
    with pytest.raises(ControlError, match=words):
        export_c(controller, tmp_path, rig=twin.rig)
    save_controller(tmp_path / "own.toml", controller, other.rig)
    read_controller(tmp_path / "own.toml", other.rig)


@pytest.mark.parametrize(("kind", "design"), [(LQI, design_lqi), (MPC, design_mpc)])
def test_the_constructor_takes_the_arguments_of_the_design_with_a_warning(kind: Any, design: Any):
    model = plate()
    given: dict[str, Any] = {"measured": ["left", "right"], "limits": (0, 1)}
    for old in (lambda: kind(model, **given), lambda: kind(model=model, **given)):
        with pytest.warns(DeprecationWarning, match=rf"is now {design.__name__}") as warned:
            assert eqx.tree_equal(old(), design(model, **given))
        # Python shows the warnings of the script that is run, not those of libraries.
        assert "equinox" not in warned[0].filename


def test_only_a_design_with_weights_is_designed_again():
    lqi = design_lqi(plate(), measured=["left", "right"])
    with pytest.raises(ControlError, match=r"redesigned: unknown weight 'drfit'.* drift"):
        lqi.redesigned({"drfit": 0.2})
    with pytest.raises(ControlError, match="expected an LQI with the weights of its design"):
        dataclasses.replace(lqi, weights=None).redesigned({"drift": 0.2})
    with pytest.raises(ControlError, match="setpoint_weight: expected finite numbers"):
        dataclasses.replace(lqi, setpoint_weight=-0.5)
    refusing("setpoint_weight: expected one number, or one for", setpoint_weight=[1.0] * 3)
    refusing("drift: expected a finite number above 0, or 1 of them, got True", drift=True)
