"""A twin step by step is the twin of `simulate`."""

import copy
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Stepper, Twin, simulate
from jaxtwin.errors import ParameterError, SimulationError

TIME = np.arange(121.0)
DUTY = np.where(TIME < 50, 0.6, -0.3)[:, None] * np.array([1.0, 0.5])


def channels_after_each_command(stepper: Stepper, steps: int) -> np.ndarray:
    state, rows = stepper.start(), []
    for command in DUTY[:-1]:
        state = stepper.step(state, command, steps=steps)
        rows.append(np.asarray(stepper.channels(state)))
    return np.stack(rows)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [2.0, 1.37])
def test_steps_follow_a_lag_and_a_delay_of_whole_steps_or_not(delay: float):
    twin = Twin("dual-cell", {"t_delay": delay})
    expected = simulate(twin, Experiment(TIME, DUTY)).temperatures
    stepper = Stepper(twin, 1.0)
    np.testing.assert_allclose(
        channels_after_each_command(stepper, 1), expected[1:], rtol=0, atol=2e-3
    )


@pytest.mark.slow
def test_several_steps_under_a_command_are_shorter_steps():
    twin = Twin("paper-2024")
    expected = simulate(twin, Experiment(TIME, DUTY)).temperatures
    found = channels_after_each_command(Stepper(twin, 0.25), 4)
    np.testing.assert_allclose(found, expected[1:], rtol=0, atol=1e-3)


def test_an_ambient_above_the_rigs_warms_an_idle_plate():
    stepper = Stepper(Twin("paper-2024"), 1.0)
    ambient = float(stepper.ambient)
    still = stepper.step(stepper.start(ambient), [0.0, 0.0], steps=100)
    np.testing.assert_allclose(still.nodes, ambient, rtol=0, atol=1e-9)
    warmer = stepper.step(still, [0.0, 0.0], ambient + 10, steps=3000)
    assert np.all(np.asarray(warmer.nodes) > ambient + 1)
    assert np.all(np.asarray(warmer.nodes) < ambient + 10)


@pytest.mark.slow
def test_derivatives_with_respect_to_command_and_parameter_are_those_of_differences():
    twin, size = Twin("paper-2024"), 1e-4

    def after_ten_seconds(duty: jax.Array, resistance: jax.Array) -> jax.Array:
        # Differences contain how the error of the steps changes with the parameter, derivatives do
        # not: the steps are short.
        stepper = Stepper(twin.with_values({"R_pc": resistance}), 0.1)
        state = stepper.step(stepper.start(30.0), jnp.stack([duty, duty]), steps=100)
        return stepper.channels(state)

    with jax.enable_x64(True):
        at = jnp.array(0.5), jnp.asarray(twin.values["R_pc"])
        derivatives = jax.jit(jax.jacfwd(after_ten_seconds, argnums=(0, 1)))(*at)
        for number, derivative in enumerate(derivatives):
            change = size * at[number]
            above, below = (
                after_ten_seconds(*(x + sign * change * (k == number) for k, x in enumerate(at)))
                for sign in (1, -1)
            )
            np.testing.assert_allclose(derivative, (above - below) / (2 * change), rtol=1e-5)


@pytest.mark.slow
def test_steppers_of_many_draws_are_made_and_stepped_in_one_vmap():
    twin, delays = Twin("dual-cell"), np.array([0.4, 1.2, 2.9])

    def after_five_steps(delay: jax.Array) -> jax.Array:
        stepper = Stepper(twin.with_values({"t_delay": delay}), 1.0, longest_delay=3.0)
        return stepper.channels(stepper.step(stepper.start(), jnp.array([0.8, 0.1]), steps=5))

    with jax.enable_x64(True):
        found = jax.jit(jax.vmap(after_five_steps))(jnp.asarray(delays))
    for row, delay in zip(found, delays, strict=True):
        stepper = Stepper(twin.with_values({"t_delay": delay}), 1.0)
        expected = stepper.channels(stepper.step(stepper.start(), [0.8, 0.1], steps=5))
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("step_size", "message"), [(0.0, "above 0"), (np.nan, "above 0, in s, got nan")]
)
def test_a_step_without_a_size_is_refused(step_size: float, message: str):
    with pytest.raises(SimulationError, match=rf"Stepper: step_size: .*{message}"):
        Stepper(Twin("paper-2024"), step_size)


def test_steps_that_are_not_stable_are_refused():
    twin = Twin("paper-2024", {"alpha": 2.0})
    with pytest.raises(SimulationError, match="step_size: expected steps with a stability number"):
        Stepper(twin, 100.0)


def test_a_command_for_another_number_of_cells_is_refused():
    stepper = Stepper(Twin("paper-2024"))
    with pytest.raises(SimulationError, match="duty: expected 2 duty cycles"):
        stepper.step(stepper.start(), [0.5])


def test_a_delay_longer_than_the_queue_is_refused_and_a_traced_one_needs_a_bound():
    twin = Twin("dual-cell")
    with pytest.raises(SimulationError, match="longest_delay: expected at least"):
        Stepper(twin.with_values({"t_delay": 9.0}), longest_delay=1.0)
    with pytest.raises(SimulationError, match="step_size: expected at least 2e-06 s"):
        Stepper(twin.with_values({"t_delay": 2.0}), 1e-9)
    with pytest.raises(SimulationError, match="longest_delay: expected a number"):
        jax.jit(lambda d: Stepper(twin.with_values({"t_delay": d})).reference)(1.0)


def test_values_that_no_simulation_can_take_are_refused():
    with pytest.raises(ParameterError, match="expected a value above 0"):
        Stepper(Twin("paper-2024", {"R_pc": -1.0}))


def test_heat_into_a_node_warms_the_rig_by_its_energy():
    """For a second nothing of it is lost yet."""
    twin = Twin("dual-cell")
    stepper = Stepper(twin, 0.1)
    still = stepper.start(16.0)
    heat = np.zeros(len(twin.netlist.nodes))
    heat[3] = 5.0
    warm = stepper.step(still, [0.0, 0.0], 16.0, steps=10, heat=heat)
    energy = np.asarray(stepper.system.capacitance) @ (np.asarray(warm.nodes) - 16.0)
    np.testing.assert_allclose(energy, 5.0, rtol=5e-3)
    assert int(np.argmax(warm.nodes)) == 3


@pytest.mark.slow
def test_gradients_pass_backwards_through_steps():
    twin = Twin("paper-2024")
    with jax.enable_x64(True):

        def end(duty: jax.Array) -> jax.Array:
            stepper = Stepper(twin, 1.0)
            state = stepper.step(stepper.start(), jnp.stack([duty, duty]), steps=5)
            return stepper.channels(state).mean()

        at = jnp.array(0.5)
        forwards = jax.jacfwd(end)(at)
        np.testing.assert_allclose(jax.grad(end)(at), forwards, rtol=1e-10)


def test_a_pickled_or_copied_stepper_takes_the_same_steps():
    """JAX reads its float64 arrays from a pickle as float32 where it is not told otherwise."""
    stepper = Stepper(Twin("paper-2024"), 1.0)
    state = stepper.step(stepper.start(), [0.5, 0.2], steps=60)
    expected = stepper.channels(stepper.step(state, [0.1, 0.9], steps=60))
    for other, begin in (
        pickle.loads(pickle.dumps((stepper, state))),
        copy.deepcopy((stepper, state)),
    ):
        found = other.channels(other.step(begin, [0.1, 0.9], steps=60))
        np.testing.assert_array_equal(found, expected)


def test_a_stepper_computes_in_float32_inside_a_function_compiled_in_float32():
    stepper = Stepper(Twin("paper-2024"), 1.0)
    begin, duty = stepper.start(), np.array([0.5, 0.2])
    expected = stepper.channels(stepper.step(begin, duty, steps=60))

    @jax.jit
    def after_a_minute(duty: jax.Array) -> jax.Array:
        return stepper.channels(stepper.step(begin, duty, steps=60))

    with jax.enable_x64(False):
        found = after_a_minute(jnp.asarray(duty))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)
