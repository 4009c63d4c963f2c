"""Pictures of residuals, of the camera's error and of uniformity show the numbers of their fit."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from scipy.stats import norm
from small_results import fit

from jaxtwin import Experiment, Fit, plots
from jaxtwin._statistics import autocorrelation
from jaxtwin.errors import SimulationError
from jaxtwin.matching import CameraError, Comparison, solution_of
from jaxtwin.physics import plate_map


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


def heights(line: Line2D) -> np.ndarray:
    return np.asarray(line.get_ydata(), float)


def shaded(axes: Axes) -> list[tuple[float, float]]:
    """From and to of each span."""
    spans = [part for part in axes.patches if part.get_gid() == "masked"]
    assert all(isinstance(span, Rectangle) for span in spans)
    boxes = [span.get_extents().transformed(axes.transData.inverted()) for span in spans]
    return [(round(box.x0, 6), round(box.x1, 6)) for box in boxes]


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def disturbed() -> Fit:
    """The small fit with a camera that was corrected, and a masked span."""
    comparisons, weights = [], []
    for run in fit().runs.values():
        camera = CameraError((20.0,), -np.where(run.time >= 20, 0.7, 0.0))
        assert run.twin is not None
        comparisons.append(Comparison(run.twin, run.experiment, None, camera))
        weight = np.ones(run.temperatures.shape)
        weight[30:40] = 0.0
        weight[50:, 1] = 0.5
        weights.append(weight)
    solution = solution_of(fit())
    noise_model = replace(solution.noise_model, channel_weights=tuple(weights))
    solution = replace(solution, noise_model=noise_model)
    return replace(fit(), comparisons=tuple(comparisons), _solution=solution)


def test_the_cameras_error_is_shown_and_taken_away():
    result = disturbed()
    axes = plots.plot_camera_error(result).axes
    columns = len(result.runs)
    for above, below, (name, run) in zip(
        axes[:columns], axes[columns:], result.runs.items(), strict=True
    ):
        shared = (run.experiment.temperatures - run.temperatures).mean(axis=1)
        np.testing.assert_allclose(heights(above.lines[0]), shared)
        np.testing.assert_array_equal(heights(above.lines[1]), result.camera[name].offset)
        np.testing.assert_allclose(heights(below.lines[0]), shared - result.camera[name].offset)
        ticks = [line for line in above.lines if line.get_marker() == "v"]
        assert [list(np.atleast_1d(line.get_xdata())) for line in ticks] == [[20.0]]


@pytest.mark.slow
def test_masked_spans_are_visible_in_every_picture_of_residuals():
    result = disturbed()
    pictures = [
        plots.plot_camera_error(result),
        plots.plot_residuals(list(result.runs.values()), weights=list(result.weights.values())),
    ]
    for figure in pictures:
        for axes in figure.axes:
            assert shaded(axes) == [(30.0, 40.0), (50.0, 59.0)]
        assert "counted less" in legend_texts(figure)
    plain = plots.plot_residuals(list(result.runs.values()))
    assert all(shaded(axes) == [] for axes in plain.axes)
    assert "counted less" not in legend_texts(plain)


def test_residual_tests_show_residuals_autocorrelation_and_sorted_residuals():
    run = fit().runs["synthetic-A"]
    over_time, against_itself, against_normal = plots.plot_residual_tests([run]).axes
    residual = run.experiment.temperatures - run.temperatures
    for number, series in enumerate(residual.T):
        np.testing.assert_array_equal(heights(over_time.lines[number]), series)
        lags = len(series) // 2
        np.testing.assert_allclose(
            heights(against_itself.lines[number]), autocorrelation(series, lags)
        )
        expected = np.sort(series - series.mean()) / series.std()
        np.testing.assert_allclose(heights(against_normal.lines[number]), expected)
    # 95 % of the autocorrelations of n samples of white noise lie within 1.96 / sqrt(n).
    (band,) = [part for part in against_itself.patches if isinstance(part, Rectangle)]
    limit = norm.ppf(0.975) / np.sqrt(len(run.time))
    assert (band.get_y(), band.get_height()) == pytest.approx((-limit, 2 * limit))


def test_uniformity_is_drawn_recorded_and_simulated():
    runs = list(fit().runs.values())
    axes = plots.plot_uniformity(runs).axes
    for column, run in enumerate(runs):
        recorded, twin = axes[column].lines
        np.testing.assert_array_equal(heights(recorded), run.recorded_uniformity.range)
        np.testing.assert_array_equal(heights(twin), run.uniformity.range)
        recorded, twin = axes[len(runs) + column].lines
        np.testing.assert_array_equal(heights(recorded), run.recorded_uniformity.std)
        np.testing.assert_array_equal(heights(twin), run.uniformity.std)


def test_no_panel_of_uniformity_is_cut_off():
    """The last of them differs most between channels: panels of a row share their limits."""
    first = fit().runs["synthetic-A"]
    apart = np.linspace(0.0, 30.0, len(first.channels))
    last = replace(first, temperatures=first.temperatures + apart)
    for axes in plots.plot_uniformity([first, last]).axes:
        low, high = axes.get_ylim()
        assert low == 0
        assert all(heights(line).max() < high for line in axes.lines)


def test_the_plate_stands_beside_what_was_recorded_of_it():
    runs, rig = list(fit().runs.values()), fit().twin.rig
    figure = plots.plot_plate_beside(rig, runs, [10.0, 50.0])
    grid = np.array(figure.axes[:8]).reshape(4, 2)
    elements = len(rig.plate.element_names)
    for column, sample in enumerate((10, 50)):
        expected = plate_map(rig, runs[0].states[sample, :elements]).temperatures
        (image,) = grid[0, column].images
        np.testing.assert_allclose(np.asarray(image.get_array()), expected)
    # As many coloured places as both zones have channels' elements, and the outline.
    nodes = {c.name: len(c.sensor.outline(rig.plate)) for c in rig.channels}
    count = sum(nodes[name] for run in runs for name in run.channels) + 1
    assert {len(axes.patches) for axes in grid[1:].flat} == {count}
    colors = {to_hex(patch.get_facecolor()) for patch in grid[2, 1].patches[:-1]}
    assert len(colors) > 3
    for column, sample in enumerate((10, 50)):
        recorded = [np.asarray(run.experiment.temperatures)[sample] for run in runs]
        read = [run.temperatures[sample] for run in runs]
        apart = np.concatenate(recorded) - np.concatenate(read)
        title = grid[3, column].get_title(loc="right")
        assert title.replace("−", "-") == f"{apart.min():.1f} … {apart.max():.1f} K"


def test_a_band_is_drawn_and_says_how_much_lies_inside():
    run = fit().runs["synthetic-A"]
    recorded = run.experiment.temperatures
    assert recorded is not None
    low, high = recorded - 1.0, recorded + 1.0
    high[:15] = recorded[:15] - 0.5  # a quarter of the samples above the band
    axes = plots.plot_bands(run, low, high).axes
    for number, (panel, channel) in enumerate(zip(axes, run.channels, strict=True)):
        assert panel.get_title(loc="left") == channel
        assert panel.get_title(loc="right") == "75 % inside"
        (band,) = panel.collections
        corners = band.get_paths()[0].vertices
        assert np.asarray(corners)[:, 1].min() == low[:, number].min()
        np.testing.assert_array_equal(heights(panel.lines[1]), run.temperatures[:, number])


def test_what_cannot_be_drawn_says_why():
    run, rig = fit().runs["synthetic-A"], fit().twin.rig
    bare = fit().twin.simulate(Experiment.schedule("0:0.5", duration=10.0, cells=2))
    with pytest.raises(SimulationError, match="expected recorded"):
        plots.plot_residual_tests([bare])
    with pytest.raises(SimulationError, match="expected recorded"):
        plots.plot_plate_beside(rig, [bare], [5.0])
    with pytest.raises(SimulationError, match="expected 0 to 59 s, got 99 s"):
        plots.plot_plate_beside(rig, [run], [99.0])
    with pytest.raises(SimulationError, match=r"low: expected shape .* got \(60, 4\)"):
        plots.plot_bands(run, run.temperatures[:, 1:], run.temperatures[:, 1:])
