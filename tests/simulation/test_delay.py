"""The lag of the command: a first-order system, solved by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin.simulation._drive import lagged_duty

STARTS = np.array([0.0, 10.0, 30.0])
COMMANDS = np.array([[0.5, 0.2], [0.8, -0.4], [0.0, 1.0]])


def by_hand(tau: float, times: np.ndarray, start: np.ndarray) -> np.ndarray:
    duty, found = start, []
    at = 0.0
    for t in times:
        for switch in STARTS[1:]:
            if at < switch <= t:
                before = COMMANDS[np.searchsorted(STARTS, at, side="right") - 1]
                duty, at = before + (duty - before) * np.exp(-(switch - at) / tau), switch
        now = COMMANDS[np.searchsorted(STARTS, at, side="right") - 1]
        found.append(now + (duty - now) * np.exp(-(t - at) / tau))
    return np.array(found)


@pytest.mark.usefixtures("float64")
def test_between_changes_the_duty_is_an_exponential():
    times = np.array([0.0, 4.0, 12.0, 29.0, 33.0, 60.0])
    found = lagged_duty(
        jnp.array(6.0), None, jnp.array(STARTS), jnp.array(COMMANDS), jnp.array(times)
    )
    np.testing.assert_allclose(found, by_hand(6.0, times, np.zeros(2)), rtol=1e-12, atol=1e-15)


@pytest.mark.usefixtures("float64")
def test_a_delay_shifts_all_of_it_and_begins_at_nothing():
    times = np.array([1.0, 5.0, 14.0, 40.0])
    lag, delay = jnp.array(3.0), jnp.array(2.0)
    late = lagged_duty(lag, delay, jnp.array(STARTS), jnp.array(COMMANDS), jnp.array(times))
    early = lagged_duty(lag, None, jnp.array(STARTS), jnp.array(COMMANDS), jnp.array(times - 2.0))
    np.testing.assert_allclose(late[1:], early[1:], rtol=1e-12)
    np.testing.assert_array_equal(late[0], np.zeros(2))


@pytest.mark.usefixtures("float64")
def test_from_a_steady_start_the_lagged_duty_is_the_first_command():
    found = lagged_duty(
        jnp.array(3.0), None, jnp.array(STARTS), jnp.array(COMMANDS), jnp.array([0.0, 9.0]), True
    )
    np.testing.assert_allclose(found, COMMANDS[[0, 0]])
