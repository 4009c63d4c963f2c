"""The filter of a linear twin is the Kalman filter of its equations, which are solved here by the
exponential of a matrix; and its steps and commands are those of a simulation."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from small_rigs import bundled

import jaxtwin as jt
from jaxtwin import Experiment, Twin, simulate
from jaxtwin.observers import ExtendedKalmanFilter, KalmanState, ProcessNoise, live_observer
from jaxtwin.observers._augmented_model import DRIVEN
from jaxtwin.observers._commands import Commands
from jaxtwin.observers._filter_run import (
    Filtered,
    FilterSamples,
    filtered,
    following,
    samples_of,
)
from jaxtwin.observers._observe import filter_for

pytestmark = pytest.mark.usefixtures("float64")

NOISE = ProcessNoise(
    reading=0.15,
    reading_time=0.5,
    heat=0.02,
    command_time=0.3,
    disturbance=0.05,
    disturbance_time=40.0,
    room=0.01,
    common=0.2,
    common_time=30.0,
    channel=0.1,
    channel_time=80.0,
    ambient=0.3,
)

# What the heaters take at a duty of 1, W, as the rig file states.
POWER = np.array([1.0, 0.75])

# The temperatures of heaters and sensors at the start, degC.
START = np.array([30.0, 25.0, 28.0, 24.0])

# That of the rig file, degC.
ROOM = 23.0


def irregular_recording(seed: int = 0) -> Experiment:
    """Noisy readings at irregular times, of which many are missing, and an ambient."""
    random = np.random.default_rng(seed)
    steps = random.uniform(0.7, 1.3, 79)
    steps[40] = 6.0
    time = np.append(0.0, np.cumsum(steps))
    duty = random.uniform(0, 1, (8, 2)).repeat(10, axis=0)
    # Near what the twin expects, because what is far from it is rejected.
    run = simulate(Twin("tclab"), Experiment(time, duty, ambient=24.0), initial=26.0)
    readings = run.temperatures + random.normal(0.0, 0.5, (80, 2))
    readings[random.uniform(size=readings.shape) < 0.2] = np.nan
    readings[20:30] = np.nan
    readings[0] = 28.0, 24.0
    ambient = random.normal(24.0, 0.3, 80)
    return Experiment(
        time, duty, channels=("T1", "T2"), temperatures=readings, ambient=ambient, name="random"
    )


class Textbook:
    """The Kalman filter of two heaters with a sensor each.

    The state are four deviations from the room of the rig file, that of the room, a heat into each
    heater, the error of both readings and that of each. The heats and the room are held during a
    step.
    """

    size = 4 + 1 + 2 + 1 + 2

    def __init__(self, twin: Twin):
        model = jt.linearize(twin, duty=[0.5, 0.5])
        self.A, self.C = np.asarray(model.A), np.asarray(model.C)
        self.per_watt = np.asarray(model.B) / POWER
        # Where all nodes are as warm as the room, nothing changes.
        of_room = -self.A.sum(axis=1, keepdims=True)
        forces = np.hstack([of_room, self.per_watt])
        self.generator = np.vstack([np.hstack([self.A, forces]), np.zeros((3, 7))])
        self.H = np.hstack([self.C, 1 - self.C.sum(axis=1, keepdims=True), np.zeros((2, 2))])
        self.H = np.hstack([self.H, np.ones((2, 1)), np.eye(2)])

    def run(self, samples: FilterSamples, room_spread: float) -> dict[str, list]:
        """Means and covariances after each time, and the log likelihood."""
        mean = np.concatenate([START - ROOM, np.zeros(6)])
        spread = [0.1] * 4 + [room_spread] + [NOISE.disturbance] * 2
        P = np.diag(np.array([*spread, NOISE.common, NOISE.channel, NOISE.channel]) ** 2)
        slope = np.zeros(2)
        found = {"mean": [], "covariance": [], "likelihood": []}
        before = samples.duty[0]
        for dt, duty, readings, ambient in zip(*samples[:4], strict=True):
            if dt > 0:
                F, of_duty, Q = self.step(dt, duty, duty - before)
                after = F @ mean + of_duty
                slope = self.C @ (after - mean)[:4] / dt
                mean, P, before = after, F @ P @ F.T + Q, duty
            row = np.zeros((1, self.size))
            row[0, 4] = 1.0
            there = np.append(np.isfinite(ambient), np.isfinite(readings))
            H = np.vstack([row, self.H])[there]
            R = np.append(NOISE.ambient**2, NOISE.reading**2 + (NOISE.reading_time * slope) ** 2)
            error = (np.append(ambient, readings) - ROOM)[there] - H @ mean
            S = H @ P @ H.T + np.diag(R[there])
            K = np.linalg.solve(S, H @ P).T
            mean, P = mean + K @ error, P - K @ S @ K.T
            found["mean"].append(mean)
            found["covariance"].append(P)
        return found

    def step(self, dt: float, duty: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, ...]:
        """Transition, effect of the duty, and noise of a step."""
        whole = np.asarray(expm(self.generator * dt))
        times = np.array([NOISE.disturbance_time] * 2 + [NOISE.common_time] + [80.0] * 2)
        levels = np.array([NOISE.disturbance] * 2 + [NOISE.common] + [NOISE.channel] * 2)
        decay = np.exp(-dt / times)
        F = np.array(block_diag(whole[:4, :4], 1.0, np.diag(decay)))
        F[:4, 4:7] = whole[:4, 4:]
        heated = whole[:4, 5:]
        # A heater is a cell whose sides are one node. White heat has this mean over a step, and a
        # late command delays this heat.
        white = 2 * NOISE.heat**2 / dt
        late = NOISE.command_time * POWER * change / dt
        Q = block_diag(
            heated @ np.diag(white + late**2) @ heated.T,
            NOISE.room**2 * dt,
            np.diag(levels**2 * (1 - decay**2)),
        )
        return F, np.append(heated @ (POWER * duty), np.zeros(6)), np.asarray(Q)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


@pytest.fixture(scope="module")
def recording() -> Experiment:
    return irregular_recording()


@pytest.fixture(scope="module")
def kalman(twin: Twin, recording: Experiment) -> ExtendedKalmanFilter:
    return filter_for(twin, recording, NOISE)


@pytest.fixture(scope="module")
def found(kalman: ExtendedKalmanFilter, recording: Experiment) -> Filtered:
    with jax.enable_x64(True):
        samples, _ = samples_of(kalman, recording)
        return filtered(kalman, kalman.init(START, np.zeros(2)), samples)


def to_nodes(kalman: ExtendedKalmanFilter) -> np.ndarray:
    """The matrix from the state of the filter to that of the textbook."""
    return np.asarray(block_diag(np.asarray(kalman.model.shapes), np.eye(6)))


@pytest.mark.slow
def test_a_linear_twins_filter_is_the_textbooks(
    twin: Twin, kalman: ExtendedKalmanFilter, recording: Experiment, found: Filtered
):
    """Irregular times, a gap, missing readings, a measured ambient; the textbook takes all readings
    of a time at once."""
    spread = float(np.asarray(kalman.model.room_spread))
    expected = Textbook(twin).run(samples_of(kalman, recording)[0], spread)
    to = to_nodes(kalman)
    means = np.asarray(found.states.mean) @ to.T
    np.testing.assert_allclose(means, np.stack(expected["mean"]), rtol=0, atol=1e-9)
    covariances = to @ np.asarray(found.states.covariance) @ to.T
    wanted = np.stack(expected["covariance"])
    np.testing.assert_allclose(covariances, wanted, rtol=0, atol=1e-9)


@pytest.mark.long
def test_a_transition_has_the_derivatives_of_the_exponential_of_the_matrix(
    twin: Twin, kalman: ExtendedKalmanFilter
):
    dt, duty, before = 0.83, np.array([0.7, 0.2]), np.array([0.1, 0.3])
    state = kalman.init(START, before)
    _, transition = kalman.linearised_step(state, jnp.asarray(duty), jnp.asarray(dt))
    F, _, Q = Textbook(twin).step(dt, duty, duty - before)
    to = to_nodes(kalman)
    slope = to @ np.asarray(transition.slope) @ np.linalg.inv(to)
    np.testing.assert_allclose(slope, F, rtol=0, atol=1e-9)
    noise = to @ np.asarray(transition.noise) @ to.T
    np.testing.assert_allclose(noise, Q, rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("duty", [pytest.param([0.8, 0.3], marks=pytest.mark.long), [-0.5, 1.0]])
def test_a_transition_has_the_derivatives_of_a_step_of_any_twin(duty: list[float]):
    """It linearises once a step, not in each stage: a warm plate that loses heat nonlinearly, cells
    whose duty has just changed, and a slow parameter."""
    kalman = live_observer(Twin("dual-cell"), ProcessNoise(names=("R_E",)))
    warm = np.array([0.8, 0.3])
    state = jax.jit(lambda: kalman.predict(kalman.init(25.0, np.zeros(2)), warm, np.nan, 60.0))()
    given = jnp.asarray(duty), jnp.asarray(1.0)
    wanted = jax.jit(
        jax.jacfwd(lambda mean: kalman.predict_mean(replace(state, mean=mean), *given).mean)
    )(state.mean)
    transition = jax.jit(lambda state: kalman.linearised_step(state, *given)[1])(state)
    layout = kalman.model.layout
    for part in DRIVEN:
        block = layout.of("modes"), layout.of(part)
        error = np.linalg.norm(transition.slope[block] - wanted[block])
        assert error < 2e-3 * np.linalg.norm(wanted[block]), part
    rest = np.arange(layout.of("duty").start, layout.size)
    np.testing.assert_allclose(transition.slope[rest], wanted[rest], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_step_of_the_mean_alone_is_the_step(kalman: ExtendedKalmanFilter):
    state = kalman.init(START, np.zeros(2))
    given = jnp.array([0.5, 0.1]), jnp.asarray(0.9)
    whole = eqx.filter_jit(kalman.step)(state, *given)
    alone = eqx.filter_jit(kalman.predict_mean)(state, *given)
    np.testing.assert_allclose(alone.mean, whole.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(alone.slope, whole.slope, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(alone.covariance, state.covariance)


@pytest.mark.slow
def test_a_prediction_over_a_long_time_takes_steps_of_at_most_the_longest(
    kalman: ExtendedKalmanFilter,
):
    longest = float(np.asarray(kalman.longest_step))
    step = eqx.filter_jit(kalman.step)
    duty = jnp.array([0.5, 0.1])
    state = kalman.init(START, np.zeros(2))
    found = kalman.predict(state, duty, np.nan, 2.5 * longest)
    for _ in range(3):
        state = step(state, duty, jnp.asarray(2.5 / 3 * longest))
    np.testing.assert_allclose(found.mean, state.mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.covariance, state.covariance, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_states_side_by_side_are_those_alone(kalman: ExtendedKalmanFilter):
    starts = jnp.array([20.0, 25.0, 40.0])
    duty = jnp.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.7]])
    readings = jnp.array([[20.5, 19.0], [np.nan, 26.0], [41.0, np.nan]])

    def run(start: jax.Array, duty: jax.Array, readings: jax.Array) -> tuple[jax.Array, jax.Array]:
        state = kalman.step(kalman.init(start, jnp.zeros(2)), duty, jnp.asarray(1.0))
        state = kalman.update(state, readings, jnp.isfinite(readings), jnp.asarray(np.nan))
        return state.mean, state.covariance

    together = jax.jit(jax.vmap(run))(starts, duty, readings)
    alone = jax.jit(run)
    for number in range(3):
        for part, own in zip(
            together, alone(starts[number], duty[number], readings[number]), strict=True
        ):
            np.testing.assert_allclose(part[number], own, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_likelihood_has_the_derivative_of_differences(
    kalman: ExtendedKalmanFilter, recording: Experiment
):
    """With respect to the logarithm of the reading noise and of the random heat."""
    samples, _ = samples_of(kalman, recording)
    few = jax.tree.map(lambda leaf: jnp.asarray(leaf[:30]), samples)

    def log_likelihood(logarithms: jax.Array) -> jax.Array:
        changed = eqx.tree_at(
            lambda k: (k.model.noise.reading, k.model.noise.heat),
            kalman,
            tuple(jnp.exp(logarithms)),
        )
        start = changed.init(26.0, jnp.zeros(2))
        return following(changed, start, few)[0].states.log_likelihood.sum()

    at, step = jnp.log(jnp.array([NOISE.reading, NOISE.heat])), 1e-4
    derivative = jax.grad(log_likelihood)(at)
    for number in range(2):
        change = step * jnp.eye(2)[number]
        slope = (log_likelihood(at + change) - log_likelihood(at - change)) / (2 * step)
        np.testing.assert_allclose(derivative[number], slope, rtol=1e-4)


class TestCommands:
    """The duty that reaches the heaters through the driver's delay and lag."""

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "driver",
        [
            pytest.param({}, id="neither", marks=pytest.mark.long),
            pytest.param({"lag": "3 s"}, id="a lag"),
            pytest.param(
                {"lag": "3 s", "delay": "0.4 s"}, id="a short delay", marks=pytest.mark.long
            ),
            pytest.param({"lag": "3 s", "delay": "4.3 s"}, id="a delay of several samples"),
        ],
    )
    def test_without_readings_the_filter_follows_the_equations(self, driver: dict[str, str]):
        """At irregular times, with a command at nearly each of them. A step in which a command
        arrives is wrong by some millikelvin, short steps by little; so is `simulate`."""
        random = np.random.default_rng(4)
        time = np.append(0.0, np.cumsum(random.uniform(0.5, 1.4, 30)))
        duty = random.integers(0, 11, (31, 2)) / 10
        twin = bundled("tclab", driver)
        run = simulate(twin, Experiment(time, duty))
        expected = _exact(twin, time, duty)
        assert np.ptp(expected) > 2
        kalman = filter_for(twin, run.to_recording(noise=0.0), NOISE)
        found = [predicted(kalman, time, duty, parts) for parts in (1, 100)]
        np.testing.assert_allclose(found[0], expected, rtol=0, atol=0.01)
        np.testing.assert_allclose(found[1], expected, rtol=0, atol=1e-6)
        np.testing.assert_allclose(run.temperatures[1:], expected, rtol=0, atol=1e-3)

    def test_a_step_after_a_delay_follows_the_lag(self):
        r"""$u = 1 - e^{-(t - d) / \tau}$ from the time $d$ on."""
        delay, lag = jnp.asarray(2.5), jnp.asarray(3.0)
        commands = Commands.held(jnp.zeros(1), 4).given(jnp.ones(1), 0.05).older(jnp.asarray(1.0))
        times = jnp.linspace(0.0, 12.0, 25)
        found = commands.reached(times, jnp.zeros(1), lag, delay)[:, 0]
        expected = -np.expm1(-np.maximum(np.asarray(times) - 1.5, 0) / 3.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)

    def test_a_delay_without_a_lag_switches_the_duty(self):
        commands = Commands.held(jnp.zeros(1), 4)
        for duty in (0.4, 0.9):
            commands = commands.given(jnp.array([duty]), 0.05).older(jnp.asarray(1.0))
        times = jnp.array([0.0, 0.49, 0.51, 1.49, 1.51, 9.0])
        found = commands.reached(times, jnp.zeros(1), None, jnp.asarray(2.5))[:, 0]
        np.testing.assert_array_equal(found, [0.0, 0.0, 0.4, 0.4, 0.9, 0.9])

    def test_the_same_command_again_keeps_the_age_of_the_first(self):
        first = Commands.held(jnp.zeros(1), 3).given(jnp.ones(1), 0.05).older(jnp.asarray(1.0))
        again = first.given(jnp.ones(1), 0.05)
        np.testing.assert_array_equal(again.ages, first.ages)
        np.testing.assert_array_equal(again.duty, first.duty)

    def test_commands_that_follow_too_fast_count_as_one(self):
        first = Commands.held(jnp.zeros(1), 3).given(jnp.ones(1), 0.05).older(jnp.asarray(0.01))
        second = first.given(jnp.full(1, 0.5), 0.05)
        np.testing.assert_array_equal(second.duty[:, 0], [0.5, 0.0, 0.0])
        np.testing.assert_array_equal(second.ages, first.ages)


@eqx.filter_jit
def predicted(
    kalman: ExtendedKalmanFilter, time: np.ndarray, duty: np.ndarray, parts: int
) -> jax.Array:
    """The readings after each sample time, each divided into parts, of a rig that was at rest."""

    def take(state: KalmanState, sample: tuple[jax.Array, jax.Array]) -> tuple[KalmanState, Any]:
        dt, command = sample
        state = jax.lax.fori_loop(
            0, parts, lambda _, s: kalman.predict_mean(s, command, dt / parts), state
        )
        return state, kalman.readings(state, jnp.asarray(np.nan))

    start = kalman.init(np.full(4, ROOM), np.zeros(2))
    return jax.lax.scan(take, start, (jnp.diff(time), jnp.asarray(duty[:-1])))[1]


def _exact(twin: Twin, time: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """These readings by the exponential of the matrix of heaters, sensors and driver, from each
    time at which a command arrives to the next."""
    model = jt.linearize(twin, duty=[0.5, 0.5])
    delay, lag = float(model.delay_s), float(model.lag_s)
    A, B, rate = np.asarray(model.A), np.asarray(model.B), 1 / lag if lag else 0.0
    generator = np.zeros((8, 8))
    generator[:4] = np.hstack([A, B if lag else np.zeros((4, 2)), np.zeros((4, 2))])
    generator[4:6] = np.hstack([np.zeros((2, 4)), -rate * np.eye(2), rate * np.eye(2)])
    if not lag:
        generator[:4, 6:] = B
    arrivals = time[:-1] + delay
    at = np.unique(np.concatenate([time, arrivals[arrivals < time[-1]]]))
    state, rows = np.zeros(8), []
    for first, last in pairwise(at):
        number = int(np.searchsorted(arrivals, (first + last) / 2)) - 1
        state[6:] = duty[number] if number >= 0 else 0.0
        state = expm(generator * (last - first)) @ state
        if last in time:
            rows.append(ROOM + np.asarray(model.C) @ state[:4])
    return np.stack(rows)
