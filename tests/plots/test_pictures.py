"""Pictures show the numbers that they are given; read back from matplotlib's own objects."""

import io
import math
import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from scipy.stats import norm
from small_results import analysis, fit, recordings

from jaxtwin import Experiment, plots
from jaxtwin._number_text import interval_text, short_number
from jaxtwin.control import StateSpace
from jaxtwin.errors import ControlError, SimulationError
from jaxtwin.matching import FitDifference, FittedParameters, ParameterDifference
from jaxtwin.physics import ThermoelectricModule
from jaxtwin.plots._fit import _position
from jaxtwin.plots._layers import space_apart
from jaxtwin.plots._style import symbol
from jaxtwin.rig import load_module
from jaxtwin.simulation import Run


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


def heights(line: Line2D) -> np.ndarray:
    return np.atleast_1d(np.asarray(line.get_ydata(), float))


def places(line: Line2D) -> np.ndarray:
    return np.atleast_1d(np.asarray(line.get_xdata(), float))


def texts(axes: Axes) -> list[str]:
    titles = [axes.get_title(loc=loc) for loc in ("left", "center", "right")]
    return [*titles, *(text.get_text() for text in axes.texts)]


def test_recordings_are_drawn_as_they_are():
    figure = plots.plot_recordings(recordings())
    above, below = figure.axes[:2], figure.axes[2:]
    for axes, experiment in zip(above, recordings(), strict=True):
        drawn = np.column_stack([heights(line) for line in axes.lines])
        np.testing.assert_array_equal(drawn, experiment.temperatures)
        assert set(experiment.channels) <= set(texts(axes))
    for axes, experiment in zip(below, recordings(), strict=True):
        np.testing.assert_array_equal(heights(axes.lines[0]), 100 * experiment.duty[:, 0])


def gappy(run: Run) -> Run:
    """The run with the first channel recorded in part and the second not at all."""
    recorded = np.array(run.experiment.temperatures)
    recorded[5:9, 0] = recorded[:, 1] = np.nan
    experiment = Experiment(
        run.time,
        run.experiment.duty,
        channels=run.channels,
        temperatures=recorded,
        name=run.experiment.name,
    )
    return replace(run, experiment=experiment)


@pytest.mark.slow
def test_missing_samples_are_gaps():
    run = gappy(next(iter(fit().runs.values())))
    above = plots.plot_recordings([run.experiment]).axes[0]
    assert np.flatnonzero(np.isnan(heights(above.lines[0]))).tolist() == [5, 6, 7, 8]
    assert run.channels[0] in texts(above)
    assert run.channels[1] not in texts(above)
    first, second, *_ = plots.plot_comparison([run]).axes
    assert np.isnan(heights(first.lines[0])[5:9]).all()
    assert f"{run.fit_percent[run.channels[0]]:.1f} %" in texts(first)
    assert "no sample" in texts(second)
    axes = plots.plot_residuals([run], weights=[run.experiment.sampled.astype(float)]).axes[0]
    mean = heights(axes.lines[len(run.channels)])
    assert np.isfinite(mean).all() == (len(run.channels) > 2)
    assert not [patch for patch in axes.patches if patch.get_gid() == "masked"]
    low, high = run.temperatures - 1, run.temperatures + 1
    assert "no sample" in texts(plots.plot_bands(run, low, high).axes[1])
    with pytest.raises(
        SimulationError,
        match=f"channel {run.channels[1]}: expected at least 10 samples for a test, got 0",
    ):
        plots.plot_residual_tests([run])
    plots.plot_residual_tests(
        [
            replace(
                run,
                channels=run.channels[:1],
                temperatures=run.temperatures[:, :1],
                experiment=run.experiment.select(run.channels[:1]),
            )
        ]
    )
    deviation = plots.plot_uniformity([run]).axes[0].lines[0]
    assert np.isnan(heights(deviation)).all()


def test_what_was_simulated_or_planned_is_not_called_a_recording():
    plan = Experiment(np.arange(4.0), np.full((4, 1), 0.5))
    rest = np.full((4, 1), 20.0)
    run = Run(plan, ("T",), rest, ("V11",), rest, "bench", 1)
    assert run.plot().axes[0].get_title(loc="left") == "bench, simulated"
    named = replace(run, experiment=replace(plan, name="plan"))
    assert named.plot().axes[0].get_title(loc="left") == "plan, simulated"
    (axes,) = plan.plot().axes
    assert axes.get_title(loc="left") == "schedule"


def test_cells_with_the_same_drive_share_a_label():
    time = np.arange(4.0)
    same = Experiment(time, np.full((4, 2), 0.5))
    other = Experiment(time, np.column_stack([np.full(4, 0.5), np.full(4, -0.2)]))
    for experiment, labels in ((same, {"P1, P2"}), (other, {"P1", "P2"})):
        (axes,) = plots.plot_recordings([experiment]).axes
        assert {text.get_text() for text in axes.texts} == labels


@pytest.mark.parametrize(
    ("lowest", "highest", "ticks"),
    [
        (0.0, 1.0, [0, 50, 100]),
        (0.1, 0.37, [0, 20, 40]),
        (-0.37, 0.4, [-40, -20, 0, 20, 40]),
        (-1.0, 1.0, [-100, 0, 100]),
        (0.0, 0.0, [0, 50, 100]),
    ],
)
def test_the_axis_of_the_duty_is_fitted_to_the_data_and_0(
    lowest: float, highest: float, ticks: list[int]
):
    drive = Experiment(np.arange(4.0), np.array([[lowest], [highest], [highest], [highest]]))
    (axes,) = plots.plot_recordings([drive]).axes
    assert axes.get_yticks().tolist() == pytest.approx(ticks)
    room = 0.04 * (ticks[-1] - ticks[0])
    assert axes.get_ylim() == pytest.approx((ticks[0] - room, ticks[-1] + room))


def test_each_drive_has_its_own_colour_and_dashes():
    drive = Experiment(np.arange(3.0), np.array([[0.4, -0.3], [0.1, 0.1], [0.1, 0.1]]))
    (axes,) = plots.plot_recordings([drive]).axes
    first, second = axes.lines
    assert first.get_color() != second.get_color()
    assert first.get_linestyle() != second.get_linestyle()
    np.testing.assert_array_equal(heights(second), [-30, 10, 10])
    named = {text.get_text(): text.get_color() for text in axes.texts}
    assert named == {"P1": first.get_color(), "P2": second.get_color()}


@pytest.mark.slow
def test_a_recording_is_seen_on_both_sides_of_the_twin():
    for axes in plots.plot_comparison(list(fit().runs.values())).axes:
        recorded, twin = axes.lines
        assert recorded.get_linewidth() >= 3 * twin.get_linewidth()
        assert recorded.get_color() != twin.get_color()
        assert recorded.get_zorder() <= twin.get_zorder()


@pytest.mark.slow
def test_each_panel_of_a_comparison_carries_its_fit():
    """The numbers are `Run.fit_percent`, the definition of the paper's field."""
    runs = list(fit().runs.values())
    axes = plots.plot_comparison(runs).axes
    shown = {panel.get_title(loc="left"): panel.get_title(loc="right") for panel in axes}
    expected = {name: f"{value:.1f} %" for run in runs for name, value in run.fit_percent.items()}
    assert shown == expected


@pytest.mark.slow
def test_residuals_and_their_mean_are_recorded_less_simulated():
    run = fit().runs["synthetic-A"]
    (axes,) = plots.plot_residuals([run]).axes
    residual = run.experiment.temperatures - run.temperatures
    drawn = [heights(line) for line in axes.lines]
    np.testing.assert_array_equal(np.column_stack(drawn[:5]), residual)
    np.testing.assert_allclose(drawn[5], residual.mean(axis=1))
    assert axes.get_xlim() == (run.time[0], run.time[-1])


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plots.plot_comparison, plots.plot_residuals])
def test_runs_without_a_recording_cannot_be_compared(plot):
    run = fit().twin.simulate(Experiment.schedule("0:0.5", duration=10.0, cells=2))
    with pytest.raises(SimulationError, match="expected recorded temperatures"):
        plot([run])


def test_marks_of_a_dc_sweep_are_the_highest_points_of_its_curves():
    """The closed forms against the drawn curves, for the datasheet of the paper's Table 2."""
    module = ThermoelectricModule.from_datasheet("CP10-127-05")
    heat, cop = plots.plot_dc_sweep(module, T_hot=300.0, delta_T=[20.0, 40.0]).axes
    for axes in (heat, cop):
        curves = [line for line in axes.lines if len(places(line)) > 1]
        marks = [line for line in axes.lines if len(places(line)) == 1]
        for curve, mark in zip(curves, marks, strict=True):
            top = np.nanargmax(heights(curve))
            step = np.diff(places(curve))[0]
            assert places(mark)[0] == pytest.approx(places(curve)[top], abs=step)
            assert heights(mark)[0] == pytest.approx(heights(curve)[top], rel=2e-3)
            assert heights(mark)[0] >= heights(curve)[top]


def test_a_datasheets_numbers_are_points_beside_the_curves():
    """Table 2 of the paper: 33 W at 4 A without a difference. Eq. (10) makes the curve of the
    largest difference touch zero at the largest current, and knows nothing of the 33 W."""
    sheet = load_module("CP10-127-05")
    module = ThermoelectricModule.from_datasheet("CP10-127-05")
    heat = plots.plot_dc_sweep(module, T_hot=300.0, datasheet=sheet).axes[0]
    stated = [line for line in heat.lines if line.get_gid() == "datasheet"]
    assert [(places(line)[0], heights(line)[0]) for line in stated] == [(4.0, 0.0), (4.0, 33.0)]
    assert "33 W at 0 K" in [text.get_text() for text in heat.texts]
    curves = [line for line in heat.lines if len(places(line)) > 1]
    assert len(curves) == 8  # seven differences, and the largest
    assert max(heights(curves[-1])) == pytest.approx(0.0, abs=1e-3)
    unknown = replace(sheet, maximum_heat_flow=None)
    heat = plots.plot_dc_sweep(module, T_hot=300.0, datasheet=unknown).axes[0]
    assert len([line for line in heat.lines if line.get_gid() == "datasheet"]) == 1


@pytest.mark.parametrize("name", ["CP10-127-05", "TEC1-12706"])
def test_no_mark_of_a_dc_sweep_is_cut_off(name):
    """The bundled datasheets; with 10 K the second one's coefficient of performance is 4.03."""
    module = ThermoelectricModule.from_datasheet(name)
    for axes in plots.plot_dc_sweep(module, T_hot=323.0).axes:
        low, high = axes.get_ylim()
        marks = [heights(line)[0] for line in axes.lines if len(places(line)) == 1]
        assert len(marks) >= 6
        assert low < min(marks)
        assert max(marks) < low + 0.97 * (high - low)


def test_history_ends_at_the_fits_rmse_and_shows_each_free_parameter():
    figure = plots.plot_history(fit())
    cost, *panels = figure.axes
    assert heights(cost.lines[0])[-1] == pytest.approx(fit().rmse)
    shown = {panel.get_title(loc="left"): panel for panel in panels}
    assert set(shown) == {symbol(row.name) for row in fit().parameters.values() if row.free}
    last = heights(shown[symbol("R_E")].lines[0])[-1]
    assert last == pytest.approx(fit()["R_E"].value)
    own = [heights(line)[-1] for line in shown[symbol("T_amb")].lines]
    assert own == pytest.approx([values["T_amb"] for values in fit().recording_values.values()])


def test_parameters_stand_between_their_bounds_on_a_logarithmic_scale():
    row = fit()["R_E"]  # 1e-5 to 10 ohm
    assert _position(row.lower, row) == 0
    assert _position(row.upper, row) == 1
    assert _position(0.01, row) == pytest.approx(0.5)
    table, _ = plots.plot_parameters(fit()).axes
    assert short_number(row.value) in texts(table)


def test_intervals_and_warnings_stand_beside_the_parameters():
    """As far as the bounds reach: R_pc, which nothing tells, from one to the other."""
    rows = {row.name: row for row in fit().parameters.values() if row.free}
    rows["R_pc"] = replace(rows["R_pc"], interval=(0.0, np.inf), warnings=("not determined",))
    told = rows["R_E"] = replace(rows["R_E"], interval=(0.001, 0.1), warnings=())
    table, scale = plots.plot_parameters(replace(fit(), parameters=FittedParameters(rows))).axes
    assert {"unknown", interval_text(told.interval)} <= set(texts(table))
    assert "not determined" in texts(scale)
    spans = {
        list(rows)[int(heights(line)[0])]: places(line)
        for line in scale.lines
        if line.get_gid() == "interval"
    }
    np.testing.assert_array_equal(spans["R_pc"], [0, 1])
    np.testing.assert_allclose(spans["R_E"], [1 / 3, 2 / 3])  # of 1e-5 to 10 ohm


def test_the_prior_stands_on_the_bar_of_the_bounds():
    """R_E lies between 1e-5 and 10 ohm, on a logarithmic scale of 6 decades; T_amb in degC."""
    rows = {row.name: row for row in fit().parameters.values() if row.free}
    quantile = norm.ppf(0.975)
    decade = np.log(10) / quantile
    rows["R_E"] = replace(rows["R_E"], prior_value=0.01, prior_spread=decade)
    rows["T_amb"] = replace(
        rows["T_amb"], prior_value=20.0, prior_spread=3.0, group_spread=4.0, lower=0.0, upper=40.0
    )
    rows["R_pc"] = replace(rows["R_pc"], prior_value=None, prior_spread=None)
    _, scale = plots.plot_parameters(replace(fit(), parameters=FittedParameters(rows))).axes
    spans = {
        list(rows)[int(heights(line)[0])]: places(line)
        for line in scale.lines
        if line.get_gid() == "prior"
    }
    assert set(spans) == {"R_E", "T_amb"}
    np.testing.assert_allclose(spans["R_E"], [1 / 3, 2 / 3])
    half = quantile * 5 / 40  # of a value of a group: the root of 3² + 4²
    np.testing.assert_allclose(spans["T_amb"], [0.5 - half, 0.5 + half])


def test_the_largest_difference_between_two_fits_is_on_top():
    """A parameter that has no standard error in either fit has no bar."""
    rows = [
        ParameterDifference("R_E", "ohm", 1.9, 2.0, 0.05, 1.03, ()),
        ParameterDifference("T_amb", "degC", 15.0, 16.0, math.nan, math.nan, ()),
        ParameterDifference("R_pc", "K/W", 0.5, 0.3, 0.1, -2.5, ()),
        ParameterDifference("alpha", "V/K", 0.05, 0.05, math.nan, 0.0, ()),
    ]
    axes = FitDifference(tuple(rows), (), ()).plot()
    assert [label.get_text() for label in axes.get_yticklabels()] == [symbol("R_pc"), symbol("R_E")]
    bars = [bar for bar in axes.containers[0] if isinstance(bar, Rectangle)]
    assert [bar.get_width() for bar in bars] == [-2.5, 1.03]
    assert bars[0].get_y() > bars[1].get_y()


@pytest.mark.slow
def test_tornado_sorts_the_correlations_and_spans_their_intervals():
    axes = plots.plot_tornado(analysis(), "TAM")
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == [symbol(name) for name in analysis().ranking("TAM")]
    widths = [bar.get_width() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert widths == sorted(widths, key=abs, reverse=True)
    row = analysis().correlation[analysis().channels.index("TAM")]
    assert sorted(widths) == pytest.approx(sorted(row))
    (lines,) = (lines for lines in axes.collections if isinstance(lines, LineCollection))
    spans = [segment[:, 0] for segment in lines.get_segments()]
    for (low, high), width in zip(spans, widths, strict=True):
        assert low < width < high


@pytest.mark.slow
def test_tornado_draws_into_given_axes():
    given_axes = pyplot.figure().subplots()
    assert analysis().tornado("mean", ax=given_axes) is given_axes


@pytest.mark.slow
def test_matrix_writes_a_number_where_the_interval_leaves_zero_out():
    axes = plots.plot_sensitivity_matrix(analysis())
    interval = analysis().interval
    told = (interval[..., 0] > 0) | (interval[..., 1] < 0)
    numbers = [text for text in axes.texts if re.fullmatch(r"-?1?\.\d\d", text.get_text())]
    assert len(numbers) == told.sum()


def test_a_picture_becomes_a_png_of_the_size_asked_for():
    figure = plots.plot_recordings(recordings())
    width, height = figure.get_size_inches()
    image = imread(io.BytesIO(plots.to_png(figure, dpi=50)))
    assert image.shape[:2] == (int(50 * height), int(50 * width))
    assert not pyplot.get_fignums()


def test_a_figure_that_was_changed_after_it_was_drawn_is_arranged_again():
    figure = plots.plot_recordings(recordings())
    axes = figure.axes[0]
    axes.set_ylabel("a label\nof several\nlines,\nwhich takes\nspace")
    before = axes.get_position().x0
    plots.to_png(figure, dpi=50)
    assert axes.get_position().x0 > before + 0.01


@pytest.mark.slow
def test_drawing_leaves_matplotlibs_settings_alone():
    before = dict(matplotlib.rcParams)
    plots.plot_tornado(analysis())
    plots.plot_recordings(recordings())
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("R_E", r"$R_\mathrm{E}$"),
        ("R_Tfx1", r"$R_\mathrm{Tfx1}$"),
        ("R_pc1_row2", r"$R_\mathrm{pc1\ row2}$"),
        ("alpha", r"$\alpha$"),
        ("mass", "mass"),
    ],
)
def test_names_are_set_as_symbols(name, shown):
    assert symbol(name) == shown


@given(st.lists(st.floats(-2, 2), min_size=1, max_size=8), st.floats(0.01, 0.5))
def test_labels_keep_their_order_and_distance_and_move_no_more_than_needed(positions, spacing):
    """Least squares: labels already apart stay, and the mean of all does not move."""
    given_positions = np.array(positions)
    moved = space_apart(given_positions, spacing)
    order = np.argsort(given_positions, kind="stable")
    assert np.all(np.diff(moved[order]) >= spacing * (1 - 1e-9) - 1e-12)
    assert moved.mean() == pytest.approx(given_positions.mean(), abs=1e-9)
    if np.all(np.diff(given_positions[order]) >= spacing):
        np.testing.assert_allclose(moved, given_positions, atol=1e-9)


def test_a_bode_diagram_shows_the_mean_of_the_channels_and_their_range():
    """A first order of gain 4 and one of gain 2, behind a delay: 3 between 2 and 4."""
    model = StateSpace(
        np.diag([-0.1, -0.1]), [[0.4], [0.2]], np.eye(2), np.zeros((2, 1)), delay_s=1.0
    )
    frequencies = [0.001, 0.1, 1.0]
    figure = plots.plot_bode({"first": model, "second": model}, frequencies)
    gain, phase = figure.axes
    response = 1 / (10j * np.array(frequencies) + 1)
    np.testing.assert_allclose(heights(gain.lines[0]), 3 * np.abs(response))
    late = np.degrees(np.angle(response) - np.array(frequencies))
    np.testing.assert_allclose(heights(phase.lines[0]), late, atol=1e-9)
    assert [text.get_text() for text in gain.get_legend().get_texts()] == ["first", "second"]  # pyright: ignore
    band = gain.collections[0].get_paths()[0].vertices
    assert np.min(np.asarray(band)[:, 1]) == pytest.approx(2 * np.abs(response[-1]))
    assert np.max(np.asarray(band)[:, 1]) == pytest.approx(4 * np.abs(response[0]))


def test_a_bode_diagram_ends_where_the_gain_is_a_thousandth_of_the_largest():
    """A double pole at 0.1 rad/s has 1e-3 of its gain at 0.1 sqrt(999) rad/s; a delay of 2 s turns
    the phase by -6.3 rad there, and without end beyond."""
    block = np.array([[-0.1, 0.0], [0.1, -0.1]])
    model = StateSpace(block, [[1.0], [0.0]], [[0.0, 1.0]], np.zeros((1, 1)), delay_s=2.0)
    gain, phase = plots.plot_bode(model).axes
    end = places(gain.lines[0])[-1]
    assert end == pytest.approx(min(10.0, 0.1 * 999**0.5), rel=0.05)
    low, high = phase.get_ylim()
    shown = heights(phase.lines[0])
    assert low <= shown.min() < low + 100
    assert shown.max() <= high < shown.max() + 100


def test_a_bode_diagram_of_models_with_other_inputs_is_refused():
    single = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    double = StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]])
    with pytest.raises(ControlError, match="with the same inputs"):
        plots.plot_bode({"one": single, "two": double})


def test_a_bode_band_goes_over_the_draws():
    """Gains from 1 to 3 about a model of gain 2: nine tenths of them lie between 1.1 and 2.9."""
    gains = np.linspace(1.0, 3.0, 41)
    model, *draws = (StateSpace([[-0.1]], [[0.1 * g]], [[1.0]], [[0.0]]) for g in (2.0, *gains))
    frequencies = [0.001, 0.1, 1.0]
    gain, phase, ratio = plots.plot_bode_band(model, draws, frequencies).axes
    response = 1 / (10j * np.array(frequencies) + 1)
    np.testing.assert_allclose(heights(gain.lines[0]), 2 * np.abs(response))
    np.testing.assert_allclose(heights(phase.lines[0]), np.degrees(np.angle(response)))
    band = np.asarray(ratio.collections[0].get_paths()[0].vertices)[:, 1]
    assert band.min() == pytest.approx(1.1 / 2)
    assert band.max() == pytest.approx(2.9 / 2)


def test_a_bode_band_of_nothing_is_refused():
    model = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(ControlError, match="expected models with the inputs"):
        plots.plot_bode_band(model, [])
