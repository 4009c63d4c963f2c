"""Controllers by themselves: their laws by hand, their limits, their start."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin._jax_settings import in_precision
from jaxtwin.control import (
    PID,
    AbstractController,
    DecoupledPI,
    FunctionController,
    Relay,
    decoupling_of,
)
from jaxtwin.control.controllers._controller import checked_measured
from jaxtwin.control.controllers._decoupled_pi import inverse
from jaxtwin.errors import ControlError

GROUPS = (("T11",), ("T16",))


def answers(controller: AbstractController, references: list, measurements: list) -> np.ndarray:
    """The duty at each sample, from rest at duty 0."""
    with jax.enable_x64(True):
        first = np.array(measurements[0], float)

        def sample(state: Any, row: Any) -> Any:
            duty, state = controller.step(state, *row)
            return state, duty

        rows = jnp.array(references, float), jnp.array(measurements, float)
        start = jax.tree.map(jnp.asarray, controller.init(np.zeros(2), first))
        return np.asarray(jax.lax.scan(sample, start, rows)[1])


def test_a_pid_is_its_difference_equation():
    """Solved by hand: Kp 0.02, Ki 0.01, Kd 0.04, Tf 3 s, h 1 s, b 0.5, c 0."""
    pid = PID(Kp=0.02, Ki=0.01, Kd=0.04, Tf=3.0, setpoint_weight=0.5)
    found = answers(pid, [[10.0]] * 3, [[0.0], [2.0], [3.0]])
    # I0 = 0 - 0.02 (0.5 - 1) 0 = 0. d = -y.
    first = 0.02 * 5 + 0.0 + 0.0
    integral = 0.01 * 10
    derivative = 0.04 * (-2) / 4
    second = 0.02 * (5 - 2) + integral + derivative
    integral += 0.01 * 8
    derivative = (3 * derivative + 0.04 * (-1)) / 4
    third = 0.02 * (5 - 3) + integral + derivative
    np.testing.assert_allclose(found[:, 0], [first, second, third], rtol=1e-12)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])


def test_back_calculation_keeps_the_integral_from_winding_up():
    """An hour at the limit, and the duty leaves it as soon as the error has changed its sign.

    At the limit, Ki e = (v - u) / Tt with Tt = Kp / Ki: P + I = 1 + Kp e, and I = 1.
    """
    pid = PID(Kp=0.02, Ki=0.001)
    far, past = [[100.0]] * 3600, [[100.0]] * 30
    found = answers(pid, far + past, [[0.0]] * 3600 + [[101.0]] * 30)
    assert np.all(found[:3600] == 1)
    np.testing.assert_allclose(found[3600, 0], 1 - 0.02, atol=1e-9)
    without = PID(Kp=0.02, Ki=0.001, tracking_time_s=1e9)
    assert answers(without, far + past, [[0.0]] * 3600 + [[101.0]] * 30)[3629, 0] == 1


def test_clamping_stops_the_integral_at_a_limit_until_the_error_turns():
    """P is 0.19 and a sample adds 0.095: beyond the limit of 1 first with an integral of 0.855."""
    pid = PID(Kp=0.002, Ki=0.001, anti_windup="clamping")
    found = answers(pid, [[95.0]] * 600, [[0.0]] * 598 + [[96.0]] * 2)
    np.testing.assert_allclose(found[8:598, 0], 1 - np.r_[0.05, np.zeros(589)], atol=1e-12)
    np.testing.assert_allclose(found[598:, 0], [0.853, 0.852], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "controller",
    [
        PID(0.05, 0.002, 0.1, 2.0, setpoint_weight=0.3, derivative_weight=0.2, measured=GROUPS),
        DecoupledPI(
            0.05,
            0.002,
            0.1,
            0.003,
            measured=GROUPS,
            setpoint_weight=0.4,
            decoupling=[[1.3, -0.3], [-0.2, 1.2]],
        ),
    ],
)
def test_a_controller_takes_over_without_a_jump_of_the_duty(controller: AbstractController):
    with jax.enable_x64(True):
        duty, measurement = np.array([0.31, -0.12]), np.array([31.0, 33.0])
        state = controller.init(duty, measurement)
        for _ in range(3):
            found, state = controller.step(state, measurement, measurement)
            np.testing.assert_allclose(found, duty, rtol=0, atol=1e-12)


def test_a_decoupled_pi_moves_the_mean_and_the_difference_apart():
    """With the plant's gain G, D = g / G: an error of the mean moves the mean alone."""
    gain = np.array([[40.0, 12.0], [8.0, 36.0]])
    controller = DecoupledPI(0.01, 0.0, 0.02, 0.0, measured=GROUPS, decoupling=decoupling_of(gain))
    mean = answers(controller, [[2.0, 2.0]], [[0.0, 0.0]])[0]
    moved = gain @ mean
    np.testing.assert_allclose(moved, moved.mean(), rtol=1e-12)
    np.testing.assert_allclose(moved, 0.01 * 2 * gain.sum(axis=1).mean(), rtol=1e-12)
    difference = answers(controller, [[1.0, -1.0]], [[0.0, 0.0]])[0]
    np.testing.assert_allclose((gain @ difference).sum(), 0, atol=1e-12)


def test_a_decoupled_pi_does_not_wind_up():
    controller = DecoupledPI(
        0.02, 0.001, 0.02, 0.001, measured=GROUPS, decoupling=[[1.2, -0.2], [-0.2, 1.2]]
    )
    far = [[100.0, 100.0]] * 1830
    found = answers(controller, far, [[0.0, 0.0]] * 1800 + [[101.0, 101.0]] * 30)
    assert np.all(found[:1800] == 1)
    assert np.all(found[1800:] < 1)


def test_cells_that_are_wired_the_other_way_round_get_the_same_duty():
    """With a decoupling that has a zero on its diagonal, at the limits and away from them."""
    straight, turned = (
        DecoupledPI(
            0.02,
            0.001,
            0.03,
            0.002,
            measured=GROUPS,
            decoupling=decoupling,
            setpoint_weight=0.5,
        )
        for decoupling in ([[1.0, 0.3], [0.0, 1.2]], [[0.0, 1.2], [1.0, 0.3]])
    )
    reference, readings = [[20.0, 90.0]] * 100 + [[1.0, 1.0]] * 100, [[0.0, 0.0]] * 200
    found, expected = (answers(c, reference, readings) for c in (turned, straight))
    assert (expected == 1).any()
    assert (np.abs(expected) < 1).any()
    np.testing.assert_allclose(found, expected[:, ::-1], rtol=0, atol=1e-12)


def test_the_inverse_of_a_decoupling_passes_zeros_on_its_diagonal():
    """And its derivative, -D⁻¹ dD D⁻¹, does."""
    matrix = np.array([[0.0, 1.0, 0.2], [0.0, 0.3, 1.1], [1.2, 0.0, 0.0]])
    change = np.array([[0.4, 0.1, 0.3], [-0.2, 0.7, 0.5], [0.6, -0.1, 0.2]])
    expected = np.linalg.inv(matrix)
    with jax.enable_x64(True):
        found, moved = jax.jvp(inverse, (jnp.asarray(matrix),), (jnp.asarray(change),))
    np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_allclose(moved, -expected @ change @ expected, atol=1e-14)


def test_a_function_sees_the_time_and_every_channel():
    controller = FunctionController(lambda t, r, y: 0.1 * t + 0.01 * (r - y).mean(), 2.0)
    found = answers(controller, [[3.0, 5.0]] * 3, [[1.0, 2.0]] * 3)
    np.testing.assert_allclose(found[:, 0], 0.025 + np.array([0.0, 0.2, 0.4]))
    np.testing.assert_array_equal(controller.output_weights(["a", "b"]), np.eye(2))


@pytest.mark.slow
def test_many_controllers_are_one_with_an_axis_more_and_derivatives_pass():
    with jax.enable_x64(True):
        many = eqx.filter_vmap(lambda Kp: PID(Kp=Kp, Ki=0.001))(jnp.array([0.01, 0.02]))

        def first(pid: PID) -> jax.Array:
            return pid.step(pid.init(np.zeros(2), np.zeros(1)), np.array([1.0]), np.zeros(1))[0][0]

        np.testing.assert_allclose(eqx.filter_vmap(first)(many), [0.01, 0.02])
        gradient = jax.grad(lambda pid: first(pid))(PID(Kp=jnp.array(0.1), Ki=jnp.array(0.2)))
        assert float(gradient.Kp) == 1.0


def test_groups_of_channels_are_means():
    pid = PID(0.1, measured=[["a", "b"], "c"])
    np.testing.assert_array_equal(pid.output_weights(["a", "b", "c"]), [[0.5, 0.5, 0], [0, 0, 1]])
    np.testing.assert_allclose(PID(0.1).output_weights(["a", "b"]), [[0.5, 0.5]])
    with pytest.raises(ControlError, match="measured: unknown channel 'd'"):
        PID(0.1, measured=["d"]).output_weights(["a", "b"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"Kp": -1.0}, "PID: Kp: expected finite numbers of at least 0, got -1.0"),
        ({"Kp": 1.0, "Ki": np.nan}, "PID: Ki: expected finite"),
        ({"Kp": "much"}, "PID: Kp: expected finite"),
        ({"Kp": 1.0, "limits": (0.5, 0.1)}, "PID: limits: expected the lowest"),
        ({"Kp": 1.0, "limits": (0, 2)}, "PID: limits: expected the lowest"),
        ({"Kp": 1.0, "sample_time_s": 0}, "PID: sample_time_s: expected a number above 0"),
        ({"Kp": 1.0 + 2.0j}, "PID: Kp: expected finite"),
        ({"Kp": 1.0, "measured": []}, "PID: measured: expected channels"),
        (
            {"Kp": 1.0, "anti_windup": "clamping", "tracking_time_s": 3.0},
            "PID: tracking_time_s: expected None with clamping",
        ),
        ({"Kp": 1.0, "tracking_time_s": [0.0, 1.0]}, "PID: tracking_time_s: expected a time above"),
    ],
)
def test_invalid_parameters_of_a_controller_are_refused(arguments: dict, message: str):
    with pytest.raises(ControlError, match=message):
        PID(**arguments)


@pytest.mark.parametrize("measured", [{"a", "b"}, [{"a", "b"}], frozenset({"a"}), 5, ["a", 5]])
def test_outputs_without_an_order_are_refused(measured: object):
    """Which output of a set is the first may be another in the next process."""
    with pytest.raises(ControlError, match="PID: measured: expected channels, or groups"):
        checked_measured("PID", measured)


def test_a_controller_is_printed_with_its_numbers_and_units():
    assert str(PID(0.1, [0.002, 0.003], limits=(0, 1), measured=["T11"])) == (
        "PID(Kp=0.1 1/K, Ki=[0.002, 0.003] 1/(K s), Kd=0 s/K, Tf=0 s, setpoint_weight=1, "
        "derivative_weight=0, limits=(0.0, 1.0), sample_time=1 s, measured=(('T11',),))"
    )
    assert "Kp_mean=1 1/K, Ki_mean=0.5 1/(K s)" in str(DecoupledPI(1, 0.5, 1, 0, measured=GROUPS))
    assert "hysteresis=0.2 K, timeout=" in str(Relay(0.1, 0.4, 0.2))
    assert "function=<function" in str(FunctionController(lambda t, r, y: 0.0, 2.0))


def test_many_controllers_and_traced_ones_are_printed_with_their_shapes():
    many = jax.vmap(PID)(jnp.ones(100))
    assert "Kp=f32[100] 1/K" in str(many)
    printed = []
    jax.jit(lambda gain: printed.append(str(PID(gain))))(1.0)
    assert printed[0].startswith("PID(Kp=weak_f32[] 1/K")


def test_a_singular_or_misshapen_decoupling_is_refused():
    for decoupling in ([[1, 1], [1, 1]], [[1, float("nan")], [0, 1]], [[1, 0, 0], [0, 1, 0]]):
        with pytest.raises(ControlError, match="expected an invertible matrix"):
            DecoupledPI(1, 0, 1, 0, measured=GROUPS, decoupling=decoupling)
    with pytest.raises(ControlError, match="that the cells move differently"):
        decoupling_of([[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(ControlError, match="expected a square matrix"):
        decoupling_of([1.0, 2.0])


@pytest.mark.parametrize(
    "controller",
    [
        PID(0.1, 0.002, measured=GROUPS),
        DecoupledPI(0.1, 0.002, 0.1, 0.002, measured=GROUPS, decoupling=np.eye(2)),
    ],
)
def test_a_controller_computes_in_the_precision_of_its_numbers(controller: AbstractController):
    """Also where JAX is set to float64, as in loops that are simulated in float32."""
    with jax.enable_x64(True):
        controller = in_precision(controller, jnp.float32)
        outputs = jnp.full(2, 30, jnp.float32)
        state = controller.init(jnp.zeros(2, jnp.float32), outputs)
        for leaf in jax.tree.leaves(controller.step(state, outputs + 5, outputs)):
            assert leaf.dtype == jnp.float32
