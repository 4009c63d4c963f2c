"""Pictures grow with what they show: some inches for each panel or row, and room for labels."""

from dataclasses import replace

import numpy as np
import pytest
import xarray
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from small_results import analysis, correlated_fit, fit, recordings

from jaxtwin import Fit, plots
from jaxtwin.control import StateSpace
from jaxtwin.matching import FitDifference, ParameterDifference


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    pyplot.close("all")


def inches(picture: Figure | Axes) -> tuple[float, float]:
    figure = picture.figure if isinstance(picture, Axes) else picture
    assert isinstance(figure, Figure)
    width, height = figure.get_size_inches().tolist()
    return round(width, 9), round(height, 9)


def model(inputs: int) -> StateSpace:
    return StateSpace([[-0.1]], [[0.1] * inputs], [[1.0]], [[0.0] * inputs])


@pytest.mark.parametrize(("inputs", "width"), [(1, 5.4), (2, 9.6)])
def test_bode_diagrams_have_4_2_inches_for_each_input(inputs, width):
    assert inches(plots.plot_bode({"plant": model(inputs)}, [0.01, 0.1])) == (width, 5.4)
    assert inches(plots.plot_bode_band(model(inputs), [model(inputs)], [0.01, 0.1])) == (width, 6.4)


@pytest.mark.slow
def test_two_recordings_of_five_channels():
    """Five panels of 2.35 inches in two rows, and pictures with a panel for each recording."""
    runs = list(fit().runs.values())
    assert [len(run.channels) for run in runs] == [5, 5]
    assert inches(plots.plot_recordings(recordings())) == (8.3, 5.0)
    assert inches(plots.plot_comparison(runs)) == (12.75, 4.7)
    assert inches(plots.plot_residuals(runs)) == (8.3, 3.4)
    assert inches(plots.plot_uniformity(runs)) == (8.3, 4.4)
    assert inches(plots.plot_residual_tests(runs)) == (12.6, 5.6)
    low, high = runs[0].temperatures - 1, runs[0].temperatures + 1
    assert inches(plots.plot_bands(runs[0], low, high)) == (13.5, 3.1)


def test_a_schedule_alone_takes_less_height():
    plan = replace(recordings()[0], temperatures=None)
    assert inches(plots.plot_recordings([plan])) == (4.6, 1.9)


def many_parameters(count: int) -> Fit:
    """The small fit, with its first free parameter `count` times."""
    known = fit().parameters
    free = next(parameter for parameter in known.values() if parameter.free)
    return replace(fit(), parameters=type(known)({f"{n}": free for n in range(count)}))


@pytest.mark.slow
def test_a_history_has_six_parameters_in_a_row():
    assert inches(plots.plot_history(fit())) == (12.6, 2.8)
    for count, height in ((6, 2.8), (7, 3.6), (12, 3.6), (13, 5.05)):
        assert inches(plots.plot_history(many_parameters(count))) == (12.6, height)


@pytest.mark.slow
def test_pictures_of_parameters_have_a_row_for_each():
    free = [parameter for parameter in fit().parameters.values() if parameter.free]
    assert inches(plots.plot_parameters(fit())) == (13.4, round(1.3 + 0.3 * len(free), 9))
    assert inches(plots.plot_tornado(analysis())) == (5.6, 2.36)
    rows, columns = analysis().correlation.shape
    size = (round(2.6 + 0.47 * columns, 9), round(1.3 + 0.31 * rows, 9))
    assert inches(plots.plot_sensitivity_matrix(analysis())) == size
    width, height = inches(plots.plot_correlation(correlated_fit()))
    assert (height - 1.6) == pytest.approx(0.86 * (width - 2.4))
    differences = [
        ParameterDifference(name, "ohm", 1.9, 2.0, 0.05, 1.0, ()) for name in ("R_E", "R_pc", "R_x")
    ]
    assert inches(FitDifference(tuple(differences), (), ()).plot()) == (5.6, 2.27)


def test_distributions_have_3_2_inches_for_each_quantity_and_0_24_for_each_channel():
    rng = np.random.default_rng(0)
    draws = xarray.Dataset(
        {
            "cost": ("draw", rng.normal(size=9)),
            "final": (("draw", "channel"), rng.normal(size=(9, 5))),
        },
        {"channel": list("abcde")},
    )
    assert inches(plots.plot_distributions(draws)) == (7.4, 2.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantities", "size"),
    [(1, (4.2, 1.54)), (3, (10.6, 1.54)), (4, (7.4, 2.78)), (5, (10.6, 2.78)), (12, (10.6, 5.26))],
)
def test_distributions_have_at_most_three_panels_side_by_side(quantities, size):
    draws = xarray.Dataset({f"{n}": ("draw", np.arange(3.0)) for n in range(quantities)})
    assert inches(plots.plot_distributions(draws)) == size
