"""Priors, the camera as an instrument, uncertainty: on recordings whose truth is known."""

import re
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from matplotlib import pyplot

from jaxtwin import (
    Experiment,
    Fit,
    Twin,
    match,
    match_many,
    plots,
    prediction_band,
    profile,
    simulate,
)
from jaxtwin.errors import MatchError
from jaxtwin.matching import FittedParameters, Huber, _noise_model, named_recordings
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._fitted_parameters import near_bound, parameter_warnings
from jaxtwin.matching._jacobian import residual_jacobian
from jaxtwin.matching._noise_model import initial_noise_model
from jaxtwin.matching._objective import make_objective
from jaxtwin.matching._problem import ParameterChoice, choose_unknowns, make_match_problem
from jaxtwin.matching._residuals import residuals
from jaxtwin.matching._uncertainty import VectorEntries, uncertainty

# No recording here has the channel T26.
FREE = ["h_A", "R_pc1_row2", "g_T26", "g_T11", "T_amb"]
TRUTH = {"h_A": 20.0, "R_pc1_row2": 0.4, "g_T11": 0.95, "T_amb": 17.0}
CHANNELS = ("T11", "T12", "TAM")
EVENTS = (90.0, 210.0)


def recording(seed: int, camera: bool, name: str) -> Experiment:
    """A run of the true twin with noise, and with two corrections of the camera."""
    rng = np.random.default_rng(seed)
    drive = Experiment.schedule("0:0.5,150:0.8", duration=300, cells=2, channels=CHANNELS)
    seen = simulate(Twin("dual-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * rng.standard_normal(seen.shape)
    if camera:
        for event, jump in zip(EVENTS, (1.0, -0.8), strict=True):
            after = np.maximum(drive.time - event, 0)
            seen += (np.where(drive.time >= event, jump, 0) * np.exp(-after / 25))[:, None]
    return Experiment(drive.time, drive.duty, channels=CHANNELS, temperatures=seen, name=name)


@pytest.fixture(scope="module")
def start() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="module")
def disturbed(start: Twin) -> Fit:
    return match(start, [recording(0, True, "day 1"), recording(1, True, "day 2")], free=FREE)


@pytest.fixture(scope="module")
def calm(start: Twin) -> Fit:
    return match(start, [recording(2, False, "day 1"), recording(3, False, "day 2")], free=FREE)


@pytest.mark.slow
def test_corrections_are_found_and_the_plate_keeps_its_dynamics(disturbed: Fit):
    for camera in disturbed.camera.values():
        np.testing.assert_allclose(camera.events, EVENTS, atol=2)
    for name, value in TRUTH.items():
        row = disturbed[name]
        # Four standard errors: one false alarm in ten thousand.
        assert abs(row.value - value) < 4 * row.standard_error
        assert row.standard_error < 0.1 * abs(value)
    assert disturbed.rmse < 0.1


@pytest.mark.slow
def test_a_saved_fit_has_the_cameras_error_again(disturbed: Fit, tmp_path: Path):
    """From the fitted twin's run and the corrections in the file; the match's own steps differ."""
    disturbed.save(tmp_path / "fit.toml")
    loaded = Fit.load(tmp_path / "fit.toml", experiments=disturbed.experiments)
    for name, camera in disturbed.camera.items():
        assert loaded.camera[name].events == camera.events
        np.testing.assert_allclose(loaded.camera[name].error, camera.error, atol=1e-3)


@pytest.mark.slow
def test_without_corrections_none_are_found_and_the_cameras_error_is_below_0_3_kelvin(calm: Fit):
    for camera in calm.camera.values():
        assert camera.events == ()
        assert np.abs(camera.error).max() < 0.3
    for name, value in TRUTH.items():
        row = calm[name]
        assert abs(row.value - value) < 4 * row.standard_error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "limit"), [pytest.param(1.0, 2e-5, marks=pytest.mark.long), (0.5, 2e-6)]
)
def test_the_jacobian_is_that_of_the_residuals(
    start: Twin, monkeypatch: pytest.MonkeyPatch, part: float, limit: float
):
    """The Jacobian is integrated with the solver's steps, not differentiated through them: both
    have the same limit, and differ by an error of fourth order."""
    for name, usual in (("FIRST_STEP", 0.25), ("GROWTH", 0.2), ("LARGEST_STEP", 32.0)):
        monkeypatch.setattr(f"jaxtwin.simulation._time_grid.{name}", part * usual)
    runs = [recording(4, True, "a"), recording(5, False, "b")]
    unknowns = choose_unknowns(start, (0, 0), ParameterChoice(FREE))
    problem = make_match_problem(start, named_recordings(start, runs), unknowns)
    objective = make_objective(problem, initial_noise_model(problem))
    with jax.enable_x64(True):
        vector = jnp.asarray(unknowns.start()) + 0.1
        flat = jax.jit(lambda v: ravel_pytree(residuals(v, objective)[0])[0])
        ours = np.asarray(jax.jit(residual_jacobian)(vector, objective))
        for entry in range(vector.size):
            step = jnp.zeros_like(vector).at[entry].set(1e-4)
            slope = (flat(vector + step) - flat(vector - step)) / 2e-4
            scale = float(jnp.abs(slope).max())
            np.testing.assert_allclose(ours[:, entry], slope, atol=limit * scale)


@pytest.mark.slow
def test_a_parameter_without_effect_stays_at_its_prior(calm: Fit):
    row = calm["g_T26"]
    assert row.prior_to_data_ratio == 0
    assert "no effect" in row.warnings
    assert calm.uncertainty.insensitive == ("g_T26",)
    assert row.value == pytest.approx(0.9)
    assert row.standard_error == pytest.approx(0.15 * 0.9)


@pytest.mark.slow
def test_intervals_are_in_the_scale_of_the_match(calm: Fit):
    """Of a logarithm v exp(+- 1.96 s), with s of the optimiser's own vector; else v +- 1.96 s."""
    known = calm.uncertainty
    row = calm["h_A"]
    entry = known.labels.index("h_A")
    s = np.sqrt(known.vector_covariance[entry, entry])
    assert row.relative_standard_error == pytest.approx(s, rel=1e-12)
    ends = row.value * np.exp([-1.96 * s, 1.96 * s])
    assert row.interval == pytest.approx(ends, rel=1e-4)
    room = calm["T_amb"]
    assert np.isnan(room.relative_standard_error)
    reach = 1.96 * room.standard_error
    assert room.interval == pytest.approx((room.value - reach, room.value + reach), rel=1e-4)


@pytest.mark.slow
def test_a_summary_shows_intervals(calm: Fit):
    h_A = replace(calm["h_A"], interval=(1e-9, 2.5), value=1.605e-5)
    rows = FittedParameters({**calm.parameters, "h_A": h_A})
    for style in ("text", "markdown", "latex"):
        text = replace(calm, parameters=rows).summary(style)
        assert "1e-9 to 2.5" in text
        assert "std. error" not in text


@pytest.mark.slow
def test_what_the_recordings_leave_open_is_remarked_on(calm: Fit):
    """Half as sharp as before: the prior's value where there is one, else nobody's."""
    row = next(row for row in calm.parameters.values() if row.name == "h_A")
    told, open_ = replace(row, prior_to_data_ratio=2.0), replace(row, prior_to_data_ratio=0.5)
    assert parameter_warnings(told, calm.uncertainty, is_recorded=False) == ()
    assert parameter_warnings(open_, calm.uncertainty, is_recorded=False) == ("prior only",)
    without = replace(open_, prior_spread=None)
    assert parameter_warnings(without, calm.uncertainty, is_recorded=False) == ("not determined",)
    endless = replace(told, standard_error=np.inf)
    assert parameter_warnings(endless, calm.uncertainty, is_recorded=False) == ("not determined",)


def test_a_report_says_once_what_the_ratio_means():
    """Recordings see a + 2 b with 44.7 times what was known, and across it a tenth (by hand)."""
    together = np.array([[400.0, 800.0], [800.0, 1600.05]])
    pair = VectorEntries(("a", "b"), np.eye(2), np.ones(2), np.ones(2), np.ones(2, bool))
    known = uncertainty(pair, together, together)
    report = known.report()
    assert report.count("below 1 the prior says more") == 1
    (direction,) = known.unidentifiable
    assert str(direction) == "+0.89 a -0.45 b (ratio 0.1)"
    assert f"unidentifiable: {direction}" in report.splitlines()
    single = VectorEntries(("a",), np.eye(1), np.ones(1), np.ones(1), np.ones(1, bool))
    clear = uncertainty(single, 9 * np.eye(1), 9 * np.eye(1))
    assert "ratio" not in clear.report()


def test_a_report_does_not_count_what_the_recordings_replace():
    """Nothing depends on the room, because it was recorded."""
    seen = np.diag([9.0, 0.0])
    labels = ("a", "T_amb[monday]")
    pair = VectorEntries(labels, np.eye(2), np.ones(2), np.ones(2), np.ones(2, bool))
    known = uncertainty(pair, seen, seen)
    assert "insensitive: T_amb[monday]" in known.report()
    first, *others = known.report(["T_amb"]).splitlines()
    assert re.match("of 1 directions .* determine none less well than the priors", first)
    assert others == ["replaced by what was recorded: T_amb[monday]"]


@pytest.mark.slow
def test_masked_spans_do_not_count(start: Twin):
    clean = recording(2, False, "day 1")
    assert clean.temperatures is not None
    broken = clean.temperatures.copy()
    broken[200:240, 0] += 5.0
    spoiled = Experiment(
        clean.time, clean.duty, channels=CHANNELS, temperatures=broken, name="day 1"
    )
    fit = match(
        start,
        [spoiled, recording(3, False, "day 2")],
        free=FREE,
        events="none",
        masks={"day 1": [(200.0, 239.0)]},
    )
    assert fit.weights["day 1"][210, 0] == 0.0
    assert abs(fit["h_A"].value - 20.0) < 4 * fit["h_A"].standard_error


@pytest.mark.slow
def test_with_hubers_loss_outliers_do_not_bias_the_match(start: Twin):
    clean = recording(2, False, "day 1")
    assert clean.temperatures is not None
    broken = clean.temperatures.copy()
    broken[::25, 1] += 8.0
    spoiled = Experiment(
        clean.time, clean.duty, channels=CHANNELS, temperatures=broken, name="day 1"
    )
    runs = [spoiled, recording(3, False, "day 2")]
    fit = match(start, runs, free=FREE, events="none", loss=Huber(2.0))
    assert fit.weights["day 1"][25, 1] < 0.2
    assert np.median(fit.weights["day 1"]) == 1.0
    for name, value in TRUTH.items():
        row = fit[name]
        assert abs(row.value - value) < 4 * row.standard_error


@pytest.mark.slow
@pytest.mark.parametrize("size", [pytest.param(8.0, marks=pytest.mark.long), 5000.0])
def test_an_outlier_is_worth_no_more_than_a_missing_sample(start: Twin, size: float):
    """A reading that is wrong by 8 K, or by the 5000 K of a broken line."""
    clean = recording(2, False, "day 1")
    assert clean.temperatures is not None
    spoiled, missing = clean.temperatures.copy(), clean.temperatures.copy()
    spoiled[140, 1] += size
    missing[140, 1] = np.nan
    found, expected = (
        match(
            start,
            [Experiment(clean.time, clean.duty, channels=CHANNELS, temperatures=t, name="day 1")],
            free=FREE,
            events="none",
            loss=loss,
        )
        for t, loss in ((spoiled, Huber(3.0)), (missing, None))
    )
    for name in FREE:
        row, other = found[name], expected[name]
        assert row.standard_error == pytest.approx(other.standard_error, rel=0.15)
        assert abs(row.value - other.value) < 0.3 * other.standard_error


@pytest.mark.slow
def test_a_hand_before_the_camera_is_found_and_shaded(start: Twin):
    # Ten seconds in which all channels read a hand, each another part of it.
    clean = recording(2, True, "day 1")
    assert clean.temperatures is not None
    spoiled = clean.temperatures.copy()
    spoiled[120:130] += [8.0, 12.0, 4.0]
    hand = Experiment(clean.time, clean.duty, channels=CHANNELS, temperatures=spoiled, name="day 1")
    day_2 = recording(3, False, "day 2")
    fit = match(start, [hand, day_2], free=FREE, loss=Huber(3.0))
    masked = match(start, [hand, day_2], free=FREE, masks={"day 1": [(120.0, 129.0)]})
    weights = fit.weights["day 1"]
    assert weights[120:130].max() < 0.5
    assert np.mean(np.delete(weights, np.arange(120, 130), axis=0) == 1.0) > 0.98
    for name, value in TRUTH.items():
        row, other = fit[name], masked[name]
        assert abs(row.value - value) < 3 * row.standard_error
        assert abs(row.value - other.value) < 2 * other.standard_error
        assert row.standard_error < 1.6 * other.standard_error
    axes = plots.plot_camera_error(fit).axes[0]
    shades = [part for part in axes.patches if part.get_gid() == "masked"]
    pyplot.close("all")
    spans = [part.get_extents().transformed(axes.transData.inverted()) for part in shades]
    middle = [box for box in spans if box.x0 <= 125 < box.x1]
    assert len(middle) == 1


@pytest.mark.long
def test_a_profile_agrees_with_the_standard_error_where_the_model_is_nearly_linear(calm: Fit):
    row = calm["h_A"]
    told: set[int] = set()
    found = profile(calm, "h_A", points=7, on_progress=lambda iteration: told.add(iteration.start))
    assert told == set(range(7))
    assert found.excess.min() == pytest.approx(0.0, abs=0.2)
    expected = 2 * 1.96 * row.standard_error
    assert found.interval[1] - found.interval[0] == pytest.approx(expected, rel=0.35)
    for end, side in zip(found.interval, (-1, 1), strict=True):
        assert (end - row.value) * side == pytest.approx(expected / 2, rel=0.35)
    assert abs(row.value - TRUTH["h_A"]) < 4 * row.standard_error


@pytest.mark.slow
@pytest.mark.parametrize("points", [0, 1, 2])
def test_a_profile_has_three_points_at_least(calm: Fit, points: int):
    with pytest.raises(MatchError, match=f"points: expected .* at least 3, got {points}"):
        profile(calm, "h_A", points=points)


@pytest.mark.slow
def test_a_prediction_band_holds_the_true_run(calm: Fit):
    band = prediction_band(calm, "day 2")
    truth = simulate(Twin("dual-cell", TRUTH), calm.experiments[1]).temperatures
    inside = (band.lower <= truth) & (truth <= band.upper)
    assert inside.mean() > 0.9
    noise = 2 * 1.96 * np.hypot(calm.rmse, calm.camera_error)
    assert noise < np.median(band.upper - band.lower) < noise + 0.5


@pytest.mark.long
def test_many_sets_in_one_batch_have_honest_intervals(start: Twin):
    # Of 64 intervals of 95 %, 54 hold the truth but for one study in a thousand.
    sets = [
        [recording(100 + 2 * n, True, "day 1"), recording(101 + 2 * n, False, "day 2")]
        for n in range(16)
    ]
    fits = match_many(start, sets, free=FREE)
    kept = [fit for fit in fits if fit is not None]
    assert len(kept) == 16
    inside = [
        abs(fit[name].value - value) < 1.96 * fit[name].standard_error
        for fit in kept
        for name, value in TRUTH.items()
    ]
    assert np.sum(inside) >= 54
    assert all(fit.uncertainty.insensitive == ("g_T26",) for fit in kept)


@pytest.mark.slow
def test_a_batch_gives_what_single_matches_give(start: Twin, disturbed: Fit):
    days = [recording(0, True, "day 1"), recording(1, True, "day 2")]
    (fit, _) = match_many(start, [days, days[::-1]], free=FREE)
    assert fit is not None
    for name in FREE:
        assert fit[name].value == pytest.approx(disturbed[name].value, rel=1e-4)


@pytest.mark.slow
def test_recordings_may_have_very_unequal_numbers_of_corrections(
    start: Twin, monkeypatch: pytest.MonkeyPatch
):
    """Forty corrections in one of four recordings take a second block of the camera's shapes."""
    runs = [recording(seed, seed == 0, f"{seed}") for seed in range(4)]
    many = tuple(np.arange(5.0, 285.0, 7.0))

    def detect(time: np.ndarray, common: np.ndarray, counted: np.ndarray) -> tuple[float, ...]:
        return many if np.abs(np.diff(common)).max() > 0.5 else ()

    monkeypatch.setattr(_noise_model, "detect_events", detect)
    fits = match_many(start, [runs[:2], runs[2:]], free=FREE, max_iterations=3)
    found = [camera.events for fit in fits if fit for camera in fit.camera.values()]
    assert found == [many, (), (), ()]


def test_sets_of_unequal_shape_are_refused(start: Twin):
    first, second = recording(0, False, "a"), recording(1, False, "b")
    with pytest.raises(MatchError, match="set 1 with recordings of other shapes"):
        match_many(start, [[first, second], [first]], free=FREE)
    with pytest.raises(MatchError, match=r"sets: .* got none"):
        match_many(start, [])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"events": {"day": [400.0]}}, "events: day: .*0 to 300 s, got 400 s"),
        ({"events": {"night": [10.0]}}, "events: expected some of the recordings day, got 'night'"),
        ({"masks": {"day": [(10.0, 400.0)]}}, "masks: day.*0 to 300"),
        ({"masks": {"day": [(0.0, 300.0)]}}, "at least one sample outside the masks"),
        ({"bounds": {"h_A": (15.5, 40.0)}}, "h_A"),
        (
            {"bounds": {"h_A": (0.0, 40.0)}},
            "h_A: expected bounds above 0.* got 0 to 40",
        ),
    ],
)
def test_bad_requests_say_what_is_allowed(start: Twin, options, words):
    with pytest.raises(MatchError, match=words):
        match(start, recording(2, False, "day"), free=FREE, **options)


def test_bounds_do_not_change_what_a_prior_means(start: Twin):
    """Below 0 allowed, a prior's spread is in the parameter's unit; above, it is relative."""
    table = start.rig.parameters
    below = replace(start.rig, parameters={**table, "h_A": replace(table["h_A"], lower=-1.0)})
    words = "h_A: expected bounds with a lower one of 0 or less.* got 1 to 40"
    with pytest.raises(MatchError, match=words):
        choose_unknowns(Twin(below), (0,), ParameterChoice(["h_A"], bounds={"h_A": (1.0, 40.0)}))


@pytest.mark.slow
def test_a_temperature_is_near_its_bound_on_its_own_scale(calm: Fit):
    """A lower bound of 5 degC is no reason to take logarithms."""
    row = calm["T_amb"]
    assert not row.is_logarithmic
    assert calm["h_A"].is_logarithmic
    assert near_bound(replace(row, lower=5.0, value=5.2, upper=35.0))
    assert not near_bound(replace(row, lower=5.0, value=5.4, upper=35.0))


@pytest.mark.slow
def test_results_are_equal_only_to_themselves_and_can_be_hashed(calm: Fit):
    solution = solution_of(calm)
    problem, noise_model = solution.problem, solution.noise_model
    copied = replace(solution, vector=solution.vector.copy())
    for value in (
        copied,
        replace(calm, _solution=copied),
        replace(problem, sample_weights=tuple(w.copy() for w in problem.sample_weights)),
        replace(
            noise_model,
            common_mode_weights=tuple(w.copy() for w in noise_model.common_mode_weights),
        ),
    ):
        assert value not in (calm, solution, problem, noise_model)
        assert value in {value}


@pytest.mark.slow
def test_tables_in_markdown_and_latex_have_a_row_for_each_free_parameter(disturbed: Fit):
    names = [row.name for row in disturbed.parameters.values() if row.free]
    markdown = disturbed.summary("markdown").splitlines()
    assert len(markdown) == 2 + len(names)
    assert len({line.count("|") for line in markdown}) == 1
    latex = disturbed.summary("latex")
    assert latex.count(r" \\") == 1 + len(names)
    assert r"R\_pc1\_row2" in latex
    assert "corrections of the camera" in disturbed.summary()
