"""Pictures of global analyses, of a function that takes no time."""

from functools import cache

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes

from jaxtwin.errors import ParameterError
from jaxtwin.plots._index_curves import _limits
from jaxtwin.sensitivity_analysis import (
    METHODS,
    GlobalSensitivity,
    Inputs,
    MethodName,
    Normal,
    Output,
    indices_of,
)

NAMES = [f"R_{letter}" for letter in "abcdefgh"]
TIMES = np.linspace(10.0, 100.0, 5)


@cache
def analysis(method: MethodName) -> GlobalSensitivity:
    """A cost that is quadratic in all parameters, and a temperature to which one after the other
    contributes; a temperature at the start that is always the same."""
    by_name = METHODS[method]
    inputs = Inputs({name: Normal(1.0, 0.25) for name in NAMES})
    design = by_name.design(inputs, 64, 1, by_name.default_samples)
    share = np.exp(-((TIMES / 100 - np.linspace(0, 1, 8)[:, None]) ** 2) * 10)
    cost = ((design.samples - 1) ** 2) @ np.arange(8.0)
    start = np.full(len(cost), 15.0)
    values = np.column_stack([cost, start, 15 + design.samples @ share])
    slopes = np.zeros((*values.shape, 8))
    slopes[:, 0], slopes[:, 2:] = 2 * (design.samples - 1) * np.arange(8.0), share.T
    indices, counted = indices_of(by_name, design, values, slopes, 1)
    outputs = [Output("temperature", "TAM", time, "A", "degC") for time in (0.0, *TIMES.tolist())]
    return GlobalSensitivity(
        rig="made", method=by_name, design=design,
        outputs=(Output("cost", "mean", unit="K2"), *outputs), indices=indices, values=values,
        counted=counted, failed=np.zeros(len(cost), bool), seed=1, wall_time=0.0,
    )  # fmt: skip


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_a_picture(method: MethodName):
    found = analysis(method)
    axes = found.plot()
    assert axes.get_title("left") == "cost mean"
    assert f"{len(found.failed):,}".replace(",", " ") in axes.get_title("right")
    if method != "morris":
        names = [label.get_text() for label in axes.get_yticklabels()]
        assert names[0] == rf"$R_\mathrm{{{found.ranking()[0][2:]}}}$"
    own = pyplot.figure().subplots()
    assert found.plot("temperature TAM at 100 s", ax=own) is own


def test_bars_are_the_indices():
    found = analysis("sobol")
    axes = found.plot("temperature TAM at 100 s")
    row = found.row("temperature TAM at 100 s")
    widths = [bar.get_width() for bar in axes.patches]  # pyright: ignore[reportAttributeAccessIssue]
    order = [found.names.index(name) for name in found.ranking("temperature TAM at 100 s")]
    np.testing.assert_allclose(widths[:8], found["ST"][row, order])
    np.testing.assert_allclose(widths[8:], found["S1"][row, order])


def test_the_plane_has_a_point_for_each_parameter_and_names_for_those_that_act():
    found = analysis("morris")
    axes = found.plot()
    x, y = axes.lines[0].get_data()
    np.testing.assert_allclose(np.asarray(x), found["mu_star"][0])
    np.testing.assert_allclose(np.asarray(y), found["sigma"][0])
    assert len(words(axes)) == 8  # one parameter does nothing; the diagonal is named, too
    assert r"$R_\mathrm{a}$" not in words(axes)


def words(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize("method", METHODS)
def test_indices_over_time_have_a_line_for_each_parameter(method: MethodName):
    found = analysis(method)
    axes = found.plot_over_time("TAM")
    assert axes.get_title("left") == f"{found.method.main} of temperature TAM"
    assert axes.get_title("right") == "2 weaker parameters in grey"
    drawn = {tuple(np.asarray(line.get_ydata())[1:].tolist()) for line in axes.lines}
    for column in found[found.method.main][2:].T:
        assert tuple(column.tolist()) in drawn
    legend = axes.get_legend()
    assert legend is not None
    assert len(legend.get_texts()) == 6


def test_what_has_no_times_cannot_be_drawn_over_time():
    found = analysis("sobol")
    with pytest.raises(ParameterError, match=r"one of TAM with several times, got 'T11'"):
        found.plot_over_time("T11")
    with pytest.raises(ParameterError, match="expected one of S1"):
        found.plot_over_time(index="mu")


def test_convergence_is_the_analysis_of_the_first_draws():
    found = analysis("sobol")
    axes = found.plot_convergence()
    ranked = [found.names.index(name) for name in found.ranking()]
    lines = {line.get_label(): line for line in axes.lines}
    line = lines[rf"$R_\mathrm{{{found.ranking()[0][2:]}}}$"]
    assert np.asarray(line.get_xdata()).tolist() == [8, 16, 32, 64]
    assert np.asarray(line.get_ydata())[-1] == pytest.approx(found["ST"][0, ranked[0]])
    part = found.design.of_blocks(np.arange(64) < 16)
    first, _ = indices_of(found.method, part, found.values[: len(part.unit), :1], seed=1)
    assert np.asarray(line.get_ydata())[1] == pytest.approx(first["ST"][0, ranked[0]])
    legend = axes.get_legend()
    assert legend is not None
    assert len(legend.get_texts()) == 6


@pytest.mark.parametrize("method", ["pearson", "morris", "shapley", "src", "prcc", "pce"])
def test_convergence_of_other_methods_ends_at_their_index(method: MethodName):
    found = analysis(method)
    axes = found.plot_convergence("temperature TAM at 100 s")
    row = found.row("temperature TAM at 100 s")
    ends = sorted(float(np.asarray(line.get_ydata())[-1]) for line in axes.lines[:-1])
    np.testing.assert_allclose(ends, np.sort(found[found.method.main][row]), atol=1e-12)


@pytest.mark.parametrize(("first", "top"), [(1.0, 1.0), (5.0, 1.2), (np.nan, 0.7)])
def test_convergence_shows_what_few_draws_say_unless_it_is_far_off(first: float, top: float):
    values = np.array([[first, 0.1], [0.6, 0.2]])
    low, high = np.array([[-3.0], [-0.1]]), np.array([[3.0], [0.7]])
    # From -0.1 to the top, with 8 % of that on both sides; 1.2 is twice the last value.
    room = 0.08 * (top + 0.1)
    assert _limits(values, low, high) == pytest.approx((-0.1 - room, top + room))


@pytest.mark.parametrize("method", ["oat", "dgsm"])
def test_a_method_without_a_first_part_has_no_convergence(method: MethodName):
    with pytest.raises(ParameterError, match=f"analysis by themselves.* got {method}"):
        analysis(method).plot_convergence()


def test_convergence_is_of_an_index_of_single_parameters():
    with pytest.raises(ParameterError, match="expected one of S1"):
        analysis("sobol").plot_convergence(index="mu")


def test_lines_of_the_grid_stand_at_values_and_not_at_parameters():
    axes = analysis("sobol").plot()
    assert axes.xaxis.get_gridlines()[0].get_visible()
    assert not axes.yaxis.get_gridlines()[0].get_visible()
