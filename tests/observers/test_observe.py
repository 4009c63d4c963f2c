"""A recording that the filter of its own twin follows: innovations, forecasts and smoothing."""

import dataclasses
import math
from collections.abc import Callable

import jax
import numpy as np
import pytest

from jaxtwin import Experiment, Stepper, Twin, simulate
from jaxtwin.observers import Estimates, Observed, ProcessNoise, observe
from jaxtwin.observers._filter_run import following, samples_of
from jaxtwin.observers._observe import filter_for

# The noise of a reading, K.
SIZE = 0.15
USUAL = ProcessNoise(reading=SIZE, heat=0.02, disturbance=0.05, common=0.1)

# The noise of a rig that is its twin, whose readings are white.
EXACT = ProcessNoise(
    reading=SIZE,
    reading_time=1e-7,
    heat=1e-7,
    command_time=1e-7,
    disturbance=1e-7,
    room=1e-7,
    common=1e-7,
    channel=1e-7,
)

# The samples without any reading.
MISSING = slice(60, 80)


def changed(recording: Experiment, readings: np.ndarray) -> Experiment:
    """A recording with other readings."""
    return Experiment(
        recording.time,
        recording.duty,
        channels=recording.channels,
        temperatures=readings,
        ambient=recording.ambient,
        name=recording.name,
    )


def true_nodes(twin: Twin, drive: Experiment, start: np.ndarray | None = None) -> np.ndarray:
    """The temperatures of heaters and sensors at each sample, a second apart, degC."""
    stepper = Stepper(twin, 1.0)
    states = [stepper.start(start)]
    for duty in drive.duty[:-1]:
        states.append(stepper.step(states[-1], duty))
    return np.stack([np.asarray(state.nodes) for state in states])


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


@pytest.fixture(scope="module")
def whole(twin: Twin) -> Experiment:
    """A recording without any missing reading."""
    drive = Experiment.schedule("0:0.5/0,40:0.2/0.8,90:0.7/0.3", duration=160, cells=2)
    return simulate(twin, drive).to_recording(noise=SIZE, seed=1, name="bench")


@pytest.fixture(scope="module")
def recording(whole: Experiment) -> Experiment:
    """The same with readings missing: of one sensor for some time, and of both."""
    assert whole.temperatures is not None
    readings = whole.temperatures.copy()
    readings[MISSING] = np.nan
    readings[30:35, 1] = np.nan
    return changed(whole, readings)


@pytest.fixture(scope="module")
def observed(twin: Twin, recording: Experiment) -> Observed:
    return observe(twin, recording, USUAL)


@pytest.fixture(scope="module")
def smoothed(observed: Observed) -> Estimates:
    return observed.smooth()


@pytest.mark.slow
def test_innovations_of_a_right_twin_are_white_and_of_variance_one(twin: Twin, whole: Experiment):
    """Over 20 recordings, in the bands in which 95 % of such numbers lie."""
    runs, count, settled = 20, len(whole.time), 30
    random = np.random.default_rng(0)
    truth = simulate(twin, whole).temperatures
    many = truth + random.normal(0.0, SIZE, (runs, *truth.shape))
    kalman = filter_for(twin, whole, EXACT)
    samples, _ = samples_of(kalman, whole)
    with jax.enable_x64(True):
        start = kalman.init(23.0, np.zeros(2))

        def whitened(readings: jax.Array) -> jax.Array:
            run = following(kalman, start, samples._replace(readings=readings))[0]
            return run.states.whitened

        found = np.asarray(jax.vmap(whitened)(jax.numpy.asarray(many)))[:, settled:]
    total = runs * (count - settled) * 2
    assert abs(np.mean(found**2) - 1) < 1.96 * math.sqrt(2 / total)
    assert abs(np.mean(found)) < 1.96 / math.sqrt(total)
    assert abs(np.mean(found[:, 1:] * found[:, :-1])) < 1.96 / math.sqrt(total)
    of_each = np.mean(found**2, axis=(1, 2))
    inside = np.abs(of_each - 1) < 1.96 * math.sqrt(2 * runs / total)
    assert inside.sum() >= 17


def test_innovations_are_readings_less_what_was_expected(observed: Observed, recording: Experiment):
    assert recording.temperatures is not None
    expected = np.asarray(observed.filtered.expected)
    np.testing.assert_allclose(observed.innovations, recording.temperatures - expected, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(observed.innovations), np.isnan(recording.temperatures))


def test_nis_is_that_of_all_readings_of_a_sample(observed: Observed):
    r"""$\nu^T S^{-1} \nu$, divided by their number; of those that there are."""
    for k in (3, 32, 100):
        there = np.isfinite(observed.innovations[k])
        one, S = observed.innovations[k, there], observed.innovation_covariance[k]
        nis = one @ np.linalg.solve(S[np.ix_(there, there)], one) / there.sum()
        np.testing.assert_allclose(observed.nis[k], nis, rtol=1e-9)
    assert np.isnan(observed.nis[MISSING]).all()
    assert np.isnan(observed.standardised[32, 1])


def test_the_log_likelihood_is_that_of_the_innovations(observed: Observed):
    total = 0.0
    for innovation, S in zip(observed.innovations, observed.innovation_covariance, strict=True):
        there = np.isfinite(innovation)
        if there.any():
            one, S_there = innovation[there], S[np.ix_(there, there)]
            total -= 0.5 * one @ np.linalg.solve(S_there, one)
            total -= 0.5 * np.linalg.slogdet(2 * np.pi * S_there)[1]
    np.testing.assert_allclose(observed.log_likelihood, total, rtol=1e-9)


def test_a_wrong_start_is_forgotten(twin: Twin, whole: Experiment):
    """One heater is 7 K warmer than the first reading, which is all that the filter starts from,
    and the other 3 K colder. A minute of readings shows it."""
    truth = true_nodes(twin, whole, np.array([30.0, 20.0, 23.0, 23.0]))
    noise = np.random.default_rng(5).normal(0.0, SIZE, (len(truth), 2))
    found = observe(twin, changed(whole, truth[:, 2:] + noise), USUAL).estimates
    error = np.abs(found.moments.nodes.mean - truth)
    assert error[0, 0] > 5
    assert error[60:].max() < 0.5


def test_bands_grow_without_readings_and_shrink_with_the_next(observed: Observed):
    band = observed.estimates.node("H1")
    width = band.upper - band.lower
    during = width[MISSING.start - 1 : MISSING.stop]
    assert (np.diff(during) > 0).all()
    assert during[-1] > 1.8 * during[0]
    assert width[MISSING.stop] < 0.8 * during[-1]
    assert width[MISSING.stop + 10] < 1.1 * during[0]


def test_a_sensor_without_readings_is_known_from_the_other(observed: Observed):
    """The band of its channel grows, that of the other stays."""
    widths = [
        one.upper - one.lower for one in (observed.estimates.channel(name) for name in ("T1", "T2"))
    ]
    assert widths[1][34] > 1.1 * widths[1][29]
    assert widths[0][34] < 1.05 * widths[0][29]


def test_a_gap_in_time_is_a_time_without_readings(
    twin: Twin, recording: Experiment, observed: Observed
):
    """The duty is the same throughout the gap."""
    kept = np.r_[0 : MISSING.start, MISSING.stop : len(recording.time)]
    assert recording.temperatures is not None
    gap = Experiment(
        recording.time[kept],
        recording.duty[kept],
        channels=recording.channels,
        temperatures=recording.temperatures[kept],
        ambient=recording.ambient,
    )
    found = observe(twin, gap, USUAL)
    np.testing.assert_array_equal(found.time, recording.time[kept])
    np.testing.assert_allclose(found.expected.mean, observed.expected.mean[kept], atol=1e-9)
    np.testing.assert_allclose(found.expected.spread, observed.expected.spread[kept], atol=1e-9)
    np.testing.assert_allclose(found.log_likelihood, observed.log_likelihood, atol=1e-8)


@pytest.mark.slow
def test_a_forecast_of_a_sample_ahead_is_what_the_filter_expected(observed: Observed):
    ahead = observed.ahead(1.0)
    np.testing.assert_array_equal(ahead.time, observed.time[1:])
    np.testing.assert_allclose(ahead.mean, observed.expected.mean[1:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ahead.spread, observed.expected.spread[1:], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("at", [40.0, 85.0])
def test_forecasts_ahead_of_each_reading_are_those_from_each_time(observed: Observed, at: float):
    """The covariance of the first goes backwards through the linearised steps along the filtered
    states, that of the second forwards along the forecast, which for a linear twin is the same."""
    ahead, forecast = observed.ahead(60.0), observed.forecast(60.0, at=at)
    place = int(np.flatnonzero(ahead.time == at + 60)[0])
    assert forecast.time[-1] == at + 60
    np.testing.assert_allclose(forecast.mean[-1], ahead.mean[place], rtol=0, atol=1e-6)
    np.testing.assert_allclose(forecast.spread[-1], ahead.spread[place], rtol=1e-6)


def test_a_forecast_goes_on_with_the_duty_that_is_given(observed: Observed):
    """As a number, one for each heater, or a row for each time; None is the recorded one."""
    held = observed.forecast(30.0)
    np.testing.assert_allclose(observed.forecast(30.0, duty=[0.7, 0.3]).mean, held.mean, atol=1e-9)
    off, rows = observed.forecast(30.0, duty=0.0), observed.forecast(30.0, duty=np.zeros((30, 2)))
    np.testing.assert_array_equal(off.mean, rows.mean)
    assert (off.mean[-1] < held.mean[-1] - 1).all()
    np.testing.assert_array_equal(held.time, 160.0 + np.arange(1, 31))
    assert held.recorded is None
    assert math.isnan(held.rmse)
    assert (np.diff(held.spread, axis=0) > -1e-6).all()


def test_smoothing_changes_nothing_at_the_last_sample(observed: Observed, smoothed: Estimates):
    for smooth, filtered_ in zip(smoothed.moments, observed.estimates.moments, strict=True):
        np.testing.assert_allclose(smooth.mean[-1], filtered_.mean[-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(smooth.spread[-1], filtered_.spread[-1], rtol=0, atol=1e-9)


def test_later_readings_make_nothing_less_certain(observed: Observed, smoothed: Estimates):
    for smooth, filtered_ in zip(smoothed.moments, observed.estimates.moments, strict=True):
        assert (smooth.spread <= filtered_.spread + 1e-9).all()
    # In a time without readings those after it say much.
    during = slice(MISSING.start + 5, MISSING.stop)
    before, after = (
        part.moments.nodes.spread[during, 0] for part in (observed.estimates, smoothed)
    )
    assert (after < 0.8 * before).all()


@pytest.mark.slow
def test_smoothing_is_that_of_rauch_tung_and_striebel(observed: Observed, smoothed: Estimates):
    """Their smoother inverts covariances and needs no adjoint (AIAA J. 3 (1965) 1445-1450)."""
    kalman, states, samples = observed.observer, observed.filtered.states, observed.samples
    with jax.enable_x64(True):

        @jax.jit
        @jax.vmap
        def step(state, duty, dt):
            found = kalman.linearised_step(state, duty, dt)[1]
            return found.slope, found.noise, found.mean

        earlier = jax.tree.map(lambda leaf: leaf[:-1], states)
        found = step(earlier, jax.numpy.asarray(samples.duty[1:]), samples.dt[1:])
    F, Q, predicted = (np.asarray(part) for part in found)
    means, covariances = np.asarray(states.mean), np.asarray(states.covariance)
    mean, P = means[-1], covariances[-1]
    rows = [(mean, P)]
    for k in reversed(range(len(F))):
        ahead = F[k] @ covariances[k] @ F[k].T + Q[k]
        gain = np.linalg.solve(ahead, F[k] @ covariances[k]).T
        mean = means[k] + gain @ (mean - predicted[k])
        P = covariances[k] + gain @ (P - ahead) @ gain.T
        rows.append((mean, P))
    of_modes = kalman.model.layout.of("modes")
    shapes = np.asarray(kalman.model.shapes)
    nodes = np.stack([shapes @ one[of_modes] for one, _ in rows[::-1]]) + 23.0
    spreads = np.stack(
        [np.sqrt(np.diag(shapes @ one[of_modes, of_modes] @ shapes.T)) for _, one in rows[::-1]]
    )
    np.testing.assert_allclose(smoothed.moments.nodes.mean, nodes, rtol=0, atol=1e-6)
    np.testing.assert_allclose(smoothed.moments.nodes.spread, spreads, rtol=0, atol=1e-6)


def test_bands_of_a_right_twin_contain_the_truth(
    twin: Twin, recording: Experiment, observed: Observed, smoothed: Estimates
):
    """Of the heaters, which no sensor touches, and of the room: the assumed noise is more than that
    of the recording."""
    truth = true_nodes(twin, recording)
    for estimates in (observed.estimates, smoothed):
        for number, heater in enumerate(("H1", "H2")):
            band = estimates.node(heater)
            true = truth[:, number]
            assert ((band.lower < true) & (true < band.upper)).mean() > 0.95
        assert ((estimates.room.lower < 23.0) & (estimates.room.upper > 23.0)).mean() > 0.95


def test_a_dataset_holds_estimates_and_innovations(observed: Observed, smoothed: Estimates):
    dataset = observed.to_xarray()
    assert dataset.attrs["status"] == "estimates, filtered"
    assert smoothed.to_xarray().attrs["status"] == "estimates, smoothed"
    residuals = (dataset["recorded"] - dataset["expected"]).values
    np.testing.assert_allclose(residuals, observed.innovations, atol=1e-12)
    np.testing.assert_array_equal(
        dataset["node"].sel(node_name="H2").values, observed.estimates.node("H2").mean
    )
    forecast = observed.ahead(60.0).to_xarray()
    assert forecast.attrs["lead_s"] == 60
    assert dict(forecast.sizes) == {"time": 101, "channel": 2}


def test_figures_have_a_panel_for_each_quantity_or_channel(
    twin: Twin, recording: Experiment, observed: Observed
):
    """Unexplained heat has one where it is outside its band."""
    always = ["channel, °C", "estimated, °C", "room, °C"]
    assert [axes.get_ylabel() for axes in observed.plot().axes] == always
    weak = twin.with_values({"P_1": 0.5})
    panels = [axes.get_ylabel() for axes in observe(weak, recording, USUAL).plot().axes]
    assert panels == [*always[:2], "unexplained heat, W", always[2]]
    forecast = observed.ahead(60.0).plot()
    assert len([axes for axes in forecast.axes if axes.lines]) == 2


@pytest.mark.slow
def test_a_figure_of_innovations_has_their_three_tests_and_the_errors_of_forecasts(
    observed: Observed,
):
    figure = observed.plot_innovations()
    assert len([axes for axes in figure.axes if axes.lines]) == 4


def test_texts_say_what_was_followed_and_how_well(observed: Observed, smoothed: Estimates):
    rmse = np.sqrt(np.nanmean(observed.innovations**2))
    assert f"bench: 161 samples, innovations of {rmse:.3f} K" in repr(observed)
    assert "H1, °C" in observed._repr_html_()
    assert repr(smoothed) == "<Smoothed estimates of 4 nodes at 161 times>"
    ahead = observed.ahead(60.0)
    assert "60 s ahead" in repr(ahead)
    assert "T1" in ahead._repr_html_()
    late = ahead.after(100.0)
    assert late.time[0] == 100
    assert dataclasses.asdict(late)["channels"] == ("T1", "T2")


def test_a_recording_of_another_length_needs_no_further_program(
    twin: Twin, compilations: Callable[[], int]
) -> None:
    def all_of(samples: int) -> None:
        drive = Experiment.schedule("0:0.5/0,40:0.2/0.8", duration=samples - 1, cells=2)
        observed = observe(twin, simulate(twin, drive).to_recording(noise=SIZE, seed=2), USUAL)
        assert len(observed.expected.mean) == len(observed.smooth().moments.nodes.mean) == samples
        assert len(observed.estimates.moments.nodes.mean) == samples
        assert len(observed.forecast(samples / 10).mean) == round(samples / 10)
        observed.ahead(samples / 10)

    all_of(171)
    compilations()
    all_of(175)
    assert compilations() == 0
