"""MPC and LQI with an observer of the twin: what it knows, and loops without offset."""

from collections.abc import Callable

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
    LiveLoop,
    StateSpace,
    design_lqi,
    design_mpc,
    save_controller,
)
from jaxtwin.control.controllers._design_model import outputs_of
from jaxtwin.control.controllers._kalman import TwinEstimator, kalman_filter, twin_estimator
from jaxtwin.errors import ControlError
from jaxtwin.live import Moment
from jaxtwin.observers import (
    ExtendedKalmanFilter,
    Gaussian,
    MovingHorizonEstimator,
    live_observer,
    measurement_update,
)

OUTPUTS = ["TAM", "TCM"]


@pytest.fixture(scope="module")
def linear(twin: Twin) -> StateSpace:
    return linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0})


@pytest.fixture(scope="module")
def model(linear: StateSpace) -> StateSpace:
    return linear.reduce(4).discretise(1.0)


@pytest.fixture(scope="module")
def observer(twin: Twin) -> ExtendedKalmanFilter:
    return live_observer(twin)


def estimator_of(model: StateSpace, observer: ExtendedKalmanFilter) -> TwinEstimator:
    (plant,) = outputs_of(model, [(name,) for name in OUTPUTS])
    kalman = kalman_filter("test", plant, np.full(2, 0.1), np.full(2, 0.1))
    return twin_estimator("test", observer, model, plant, kalman)


def known_at_rest(
    estimator: TwinEstimator,
    nodes: np.ndarray,
    channels: np.ndarray,
    room: float,
    measured: float = np.nan,
) -> np.ndarray:
    """What the observer adds to the plant with the rig at given temperatures, and a room of which
    it is certain, or one that is measured."""
    with jax.enable_x64(True):
        readings = jnp.concatenate([jnp.zeros(2), channels, jnp.full(1, jnp.nan)])
        start = estimator.init(jnp.zeros(2), readings)
        kalman = estimator.observer
        assert isinstance(kalman, ExtendedKalmanFilter)
        state = kalman.init(nodes, estimator.duty)
        place = kalman.model.layout.of("room")
        warmer = state.mean.at[place].set(kalman.model.from_degC(jnp.asarray(room)))
        state = eqx.tree_at(lambda s: s.mean, state, warmer)
        nothing = jnp.full(len(channels), jnp.nan)
        silent = jnp.concatenate([jnp.zeros(2), nothing, jnp.full(1, measured)])
        found = eqx.filter_jit(estimator.update)(start._replace(twin=state), silent)
        return np.asarray(found.known)


@pytest.mark.slow
def test_the_gain_of_a_controllers_filter_is_that_of_an_observer_at_rest(model: StateSpace):
    """The algebra of the observers, repeated until the covariance does not change."""
    (plant,) = outputs_of(model, [(name,) for name in OUTPUTS])
    drift, noise = np.array([0.2, 0.1]), np.array([0.1, 0.3])
    kalman = kalman_filter("test", plant, drift, noise)
    process = np.diag(np.r_[np.zeros(len(kalman.A) - 2), drift**2])
    with jax.enable_x64(True):
        A, C = jnp.asarray(kalman.A), jnp.asarray(kalman.C)
        at, both, variance = jnp.zeros(len(A)), jnp.ones(2, bool), jnp.asarray(noise**2)

        def seen(covariance: jax.Array, innovation: jax.Array) -> Gaussian:
            return measurement_update(
                Gaussian(at, covariance), innovation, C, variance, both, slice(0)
            )[0]

        def sample(_: int, covariance: jax.Array) -> jax.Array:
            after = seen(covariance, jnp.zeros(2))
            return A @ after.covariance @ A.T + process

        rest = jax.lax.fori_loop(0, 20_000, sample, jnp.eye(len(A)))
        gain = [seen(rest, innovation).mean for innovation in jnp.eye(2)]
    np.testing.assert_allclose(kalman.L, np.transpose(gain), rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_an_observer_adds_nothing_at_the_operating_point_and_the_room_beside_it(
    twin: Twin, linear: StateSpace, observer: ExtendedKalmanFilter
):
    """A room that is 0.3 K warmer warms the outputs at rest by what the twin's equations say."""
    point = linear.operating_point
    estimator = estimator_of(linear.discretise(1.0), observer)
    nodes, channels = np.asarray(point.nodes), np.asarray(point.outputs)
    room = float(point.ambient)
    np.testing.assert_allclose(known_at_rest(estimator, nodes, channels, room), 0.0, atol=2e-4)
    known = known_at_rest(estimator, nodes, channels, room + 0.3)
    warmer = linearize(twin, duty=np.asarray(point.duty), ambient=room + 0.3).operating_point
    rows = [twin.channels.index(name) for name in OUTPUTS]
    change = np.asarray(linear.C)[rows] @ (np.asarray(warmer.nodes) - nodes)
    # A linear model misses how losses grow with the temperature.
    np.testing.assert_allclose(known, change, rtol=0.02)
    # A measured room is taken as it is, whatever the observer has come to think of it.
    seen = known_at_rest(estimator, nodes, channels, room, measured=room + 0.3)
    np.testing.assert_allclose(seen, known, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("design", [design_mpc, design_lqi])
def test_heat_that_no_model_knows_leaves_no_offset(
    design: Callable[..., MPC | LQI],
    twin: Twin,
    model: StateSpace,
    observer: ExtendedKalmanFilter,
):
    """10 W beside the cells, as a hand on the plate; by the filter's integral of what it misses."""
    settings = {"measured": OUTPUTS, "limits": (0, 1), "reading_noise": 0.1}
    controller = design(model, observer=observer, **settings)
    hand = HeatInput(elements=("V14", "V15"), start=300, end=1200, heat=10.0)
    run = simulate_closed_loop(
        twin, controller, "0:40/40", duration=1200, noise=False, disturbances=[hand]
    )
    error = np.asarray(run.output) - 40.0
    time = np.asarray(run.time)
    assert np.abs(error[(time > 300) & (time < 400)]).max() > 0.2
    np.testing.assert_allclose(error[time > 1100].mean(axis=0), 0.0, atol=0.02)


@pytest.mark.slow
def test_a_measured_room_is_fed_forward():
    """Sensors that touch the rig, and a room that warms by 8 K within 5 minutes: the error is a
    third of that of a controller which must find it out, whose integral of error at rest is 0."""
    twin = Twin("tclab")
    model = linearize(twin, temperatures=40.0).discretise(5.0)
    controller = design_mpc(
        model, measured=["T1", "T2"], observer=live_observer(twin, sample_time=5.0)
    )
    errors = [
        np.abs(
            simulate_closed_loop(
                twin,
                controller,
                40.0,
                duration=1500,
                initial=40.0,
                ambient="0:23,600:23,ramp 900:31",
                room_is_measured=is_measured,
                noise=False,
            ).output[600:]
            - 40.0
        ).max()
        for is_measured in (False, True)
    ]
    assert errors[1] < errors[0] / 3


@pytest.mark.slow
def test_an_impossible_reading_moves_no_controller_with_an_observer(
    model: StateSpace, observer: ExtendedKalmanFilter, twin: Twin
):
    """For a sample, one of the two controlled channels reads as a sensor without a wire does."""
    duty = []
    for reading in (40.0, -127.0):
        mpc = design_mpc(model, measured=OUTPUTS, limits=(0, 1), observer=observer)
        loop = LiveLoop(twin, mpc, 40.0, duration=60.0)
        asked = None
        for second in range(12):
            readings = np.full(len(twin.channels), 40.0)
            readings[twin.channels.index("TAM")] = reading if second == 10 else 40.0
            moment = Moment(float(second), readings, np.zeros(15), np.zeros(2), None)
            asked = loop(moment)
        assert asked is not None
        duty.append(asked)
    np.testing.assert_allclose(duty[1], duty[0], atol=0.02)


@pytest.mark.slow
def test_a_live_loop_hands_a_measured_room_to_the_controller(
    model: StateSpace, observer: ExtendedKalmanFilter, twin: Twin
):
    """A warmer room lets it ask for less; None is a room that nothing measures."""
    controller = design_mpc(model, measured=OUTPUTS, limits=(0, 1), observer=observer)
    loop = LiveLoop(twin, controller, 40.0, duration=60.0)
    readings = np.full(len(twin.channels), 40.0)
    idle, fresh = np.zeros(2), np.zeros(len(readings))
    asked = []
    for room in (None, 16.0, 24.0):
        loop = LiveLoop(twin, controller, 40.0, duration=60.0)
        asked.append(loop(Moment(0.0, readings, fresh, idle, room)))
    assert all(np.isfinite(duty).all() for duty in asked)
    assert np.all(asked[2] < asked[1])


def test_a_room_is_measured_only_for_a_controller_that_reads_it(twin: Twin, model: StateSpace):
    mpc = design_mpc(model, measured=OUTPUTS)
    with pytest.raises(ControlError, match=r"room_is_measured: expected a controller that reads"):
        simulate_closed_loop(twin, mpc, 40.0, duration=10, room_is_measured=True)


def test_a_controller_with_an_observer_has_no_file_and_no_c(
    twin: Twin, model: StateSpace, observer: ExtendedKalmanFilter, tmp_path
):
    for design in (design_mpc, design_lqi):
        controller = design(model, measured=OUTPUTS, observer=observer)
        assert not controller.is_linear
        with pytest.raises(ControlError, match=r"export_c: model: expected one without"):
            export_c(controller, tmp_path, rig=twin.rig)
        with pytest.raises(ControlError, match=r"save_controller: controller: expected one witho"):
            save_controller(tmp_path / "loop.toml", controller, twin.rig)


def test_an_observer_of_another_rig_or_beside_a_foreign_model_is_refused(
    model: StateSpace, observer: ExtendedKalmanFilter
):
    other = live_observer(Twin("tclab"))
    with pytest.raises(ControlError, match=r"MPC: observer: expected one of dual-cell, got one of"):
        design_mpc(model, measured=OUTPUTS, observer=other)
    few = eqx.tree_at(lambda k: k.model.columns, observer, np.arange(3))
    with pytest.raises(ControlError, match=r"reads all 15 channels of dual-cell.*reads 3"):
        design_mpc(model, measured=OUTPUTS, observer=few)
    unknown = eqx.tree_at(lambda m: m.projection, model, None)
    with pytest.raises(ControlError, match=r"not made by linearize"):
        design_mpc(unknown, measured=OUTPUTS, observer=observer)


@pytest.mark.slow
def test_a_moving_horizon_without_bounds_informs_an_mpc_as_the_filter_does():
    """On a linear twin they are the same observer, so that the loops are the same."""
    twin = Twin("tclab")
    model = linearize(twin, temperatures=40.0).discretise(5.0)
    kalman = live_observer(twin, sample_time=5.0)
    runs = [
        simulate_closed_loop(
            twin,
            design_mpc(model, measured=[["T1"], ["T2"]], observer=observer),
            [40.0, 35.0],
            duration=200,
        )
        for observer in (kalman, MovingHorizonEstimator(kalman, 6))
    ]
    np.testing.assert_allclose(runs[0].duty, runs[1].duty, atol=1e-8)
