"""Distributions over draws: panels that can be read, whatever the numbers and their spread."""

import numpy as np
import pytest
import xarray
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtwin import plots

DRAWS = 200


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


def dataset(**quantities: np.ndarray) -> xarray.Dataset:
    return xarray.Dataset({name: ("draw", values) for name, values in quantities.items()})


def around(middle: float, spread: float) -> np.ndarray:
    return middle + spread * np.random.default_rng(0).normal(size=DRAWS)


def ticks(axes: Axes) -> list[str]:
    """The labels that can be seen below an axes."""
    low, high = axes.get_xlim()
    seen = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
    return [label.get_text() for at, label in seen if low <= at <= high]


def overlaps(figure: Figure) -> int:
    """The number of pairs of tick labels and axis labels of a figure that touch each other."""
    figure.canvas.draw()
    boxes = []
    for axes in figure.axes:
        low, high = axes.get_xlim()
        for at, label in zip(axes.get_xticks(), axes.get_xticklabels(), strict=True):
            if low <= at <= high:
                boxes.append(label.get_window_extent())
        boxes += [axes.title.get_window_extent(), axes.xaxis.label.get_window_extent()]
        boxes += [axes._left_title.get_window_extent()]  # pyright: ignore
        boxes += [axes.xaxis.get_offset_text().get_window_extent()]
    boxes = [box for box in boxes if box.width > 0]
    return sum(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


HARD = {
    "hottest_cell_side": around(43.07, 0.01),
    "peak_power": around(34.8185, 1e-6),
    "energy": around(123456.0, 30.0),
    "integral_time_absolute_error": around(2.3e7, 1e5),
    "small": around(2e-7, 1e-9),
    "about_zero": around(0.0, 0.3),
    "zero": np.zeros(DRAWS),
    "negative": around(-273.15, 0.01),
}


@pytest.mark.slow
@pytest.mark.parametrize("width", [None, 7.2])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8])
def test_no_label_covers_another(count, width):
    some = dict(list(HARD.items())[-count:])
    if width is None:
        figure = plots.plot_distributions(dataset(**some))
    else:
        with plots.style("paper", width=width):
            figure = plots.plot_distributions(dataset(**some))
    assert overlaps(figure) == 0


def test_ticks_are_whole_numbers_that_differ():
    """Not numbers to which 3.48185e1 has to be added."""
    figure = plots.plot_distributions(dataset(**HARD))
    for axes in figure.axes:
        labels = ticks(axes)
        assert 2 <= len(labels) <= 4
        assert len(set(labels)) == len(labels)
        assert axes.xaxis.get_offset_text().get_text() in ("", "1e7", "1e\N{MINUS SIGN}7")


def test_draws_that_are_nearly_the_same_are_a_dot():
    """A spread of 1e-6 W about 34.8 W is narrower than the dot, one of 0.01 K is not."""
    figure = plots.plot_distributions(dataset(**HARD))
    spans = {axes.get_title(loc="left"): axes.get_xlim() for axes in figure.axes}
    low, high = spans["peak_power"]
    assert (high - low) / high == pytest.approx(1e-4, rel=1e-3)
    assert low < HARD["peak_power"].min() < HARD["peak_power"].max() < high
    low, high = spans["hottest_cell_side"]
    assert high - low < 0.05


def test_infinite_values_are_counted_below_the_panel():
    """Loops that never settle are no failed draws."""
    some = np.where(np.arange(DRAWS) < 30, np.inf, around(80.0, 5.0))
    draws = dataset(some=some, all=np.full(DRAWS, np.inf), failed=np.full(DRAWS, np.nan))
    draws["some"].attrs["units"] = "s"
    some_axes, all_axes, failed = plots.plot_distributions(draws).axes
    assert some_axes.get_xlabel() == "s, infinite in 30 of 200"
    np.testing.assert_allclose(np.asarray(some_axes.lines[0].get_xdata()), np.median(some[30:]))
    assert all_axes.get_xlabel() == "infinite in 200 of 200"
    assert [text.get_text() for text in all_axes.texts] == ["no finite value"]
    assert failed.get_xlabel() == ""
    assert [text.get_text() for text in failed.texts] == ["no finite value"]


def test_a_trajectory_is_a_curve_with_bands():
    """600 samples would be 600 rows, 12 feet of paper."""
    samples, shift = np.linspace(20.0, 50.0, 600), np.linspace(-1.0, 1.0, 41)
    draws = xarray.Dataset({"output": (("draw", "time"), samples + shift[:, None])})
    figure = plots.plot_distributions(draws)
    assert figure.get_size_inches()[1] < 4
    (axes,) = figure.axes
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata()), samples)
    band = np.asarray(axes.collections[0].get_paths()[0].vertices)
    assert band[:, 1].min() == pytest.approx(20.0 - 0.9)
    assert band[:, 1].max() == pytest.approx(50.0 + 0.9)
