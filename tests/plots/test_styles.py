"""Styles of pictures: for a column of a journal, print without colours, a dark notebook."""

from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from jaxtwin import Experiment, Twin, load_rig, plots
from jaxtwin.errors import ParameterError
from jaxtwin.physics import ThermoelectricModule
from jaxtwin.plots import (
    plot_dc_sweep,
    plot_netlist,
    plot_plate_map,
    plot_recordings,
    style,
    styled,
)
from jaxtwin.plots._style import DARK, GREY, Palette

MODULE = ThermoelectricModule.from_datasheet("TEC1-12706")


@pytest.fixture(autouse=True)
def _closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


@styled
def six_lines() -> Figure:
    figure = pyplot.figure(figsize=(5.0, 3.0), layout="constrained")
    axes = figure.subplots()
    for number in range(6):
        axes.plot([0, 1], [number, number], label=str(number))
    axes.legend()
    return figure


def recording() -> Figure:
    times = np.arange(50.0)
    return plot_recordings(
        [
            Experiment(
                times,
                np.full((50, 1), 0.5),
                channels=("T1", "T2"),
                temperatures=np.stack([times, times]).T,
            )
        ]
    )


def brightness(color: str) -> float:
    """Relative luminance, WCAG 2."""
    parts = np.array(to_rgb(color))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(first: str, second: str) -> float:
    low, high = sorted((brightness(first), brightness(second)))
    return (high + 0.05) / (low + 0.05)


def dashes(line: Line2D) -> str:
    return str(line._dash_pattern)  # pyright: ignore[reportAttributeAccessIssue]


def test_letters_and_lines_stand_out_from_every_ground():
    """WCAG 2 asks for 4.5 for text, and 3 for graphics."""
    for colors in (Palette(), GREY, DARK):
        assert contrast(colors.ink, colors.ground) > 7
        assert contrast(colors.muted, colors.ground) > 4
        assert min(contrast(c, colors.ground) for c in (colors.blue, colors.vermilion)) > 3


def test_grey_has_no_colours_and_no_two_lines_alike():
    assert all(len(set(to_rgb(color))) == 1 for color in GREY.cycle)
    with style("grey"):
        axes = six_lines().axes[0]
    looks = {(brightness(str(line.get_color())) > 0.05, dashes(line)) for line in axes.lines}
    assert len(looks) == 6
    legend = axes.get_legend()
    assert legend is not None
    shown = [dashes(line) for line in legend.get_lines()]
    assert shown == [dashes(line) for line in axes.lines]


def test_a_dark_notebook_has_a_dark_ground_and_light_letters():
    with style("dark"):
        figure = recording()
    assert to_hex(figure.get_facecolor()) == DARK.ground
    for axes in figure.axes:
        assert to_hex(axes.get_facecolor()) == DARK.ground
        labels = [axes.xaxis.label, *axes.get_xticklabels()]
        assert {to_hex(label.get_color()) for label in labels} == {DARK.ink}


def test_text_on_maps_is_the_same_in_the_dark():
    """The colours of temperatures do not change, so what is written on them must not."""
    rig = load_rig("dual-cell")
    maps = np.linspace(20, 40, 24)[None]

    def words(figure):
        return [to_hex(text.get_color()) for text in figure.axes[0].texts]

    usual = words(plot_plate_map(rig, maps, ["0 s"]))
    with style("dark"):
        assert words(plot_plate_map(rig, maps, ["0 s"])) == usual


def test_a_figure_for_a_column_is_no_wider_and_has_letters_of_eight_points():
    with style("paper"):
        figure = plot_dc_sweep(MODULE, T_hot=300.0)
    assert figure.get_size_inches()[0] == pytest.approx(3.5)
    with style("paper", width=7.2):
        figure = plot_dc_sweep(MODULE, T_hot=300.0)
    width, height = figure.get_size_inches()
    assert width == pytest.approx(7.2)
    assert height == pytest.approx(0.8 * 4.3)
    axes = figure.axes[0]
    assert axes.xaxis.label.get_fontsize() == pytest.approx(8.0)
    assert axes.get_xticklabels()[0].get_fontsize() == pytest.approx(7.2)
    # What a function writes itself is as much smaller as the rest.
    words = {text.get_text(): text.get_fontsize() for text in axes.texts}
    assert words["0 K"] == pytest.approx(0.8 * 9)


def test_a_figure_of_the_caller_keeps_its_size():
    with style("paper"):
        mine, axes = pyplot.subplots(figsize=(9.0, 2.0))

        @styled
        def draw():
            axes.plot([0, 1], [0, 1])
            return axes

        draw()
    assert tuple(mine.get_size_inches()) == (9.0, 2.0)


def test_a_network_keeps_its_size():
    """Its boxes and letters are placed to the inch."""
    usual = plot_netlist(Twin("single-cell")).get_figure(root=True)
    with style("paper"):
        narrow = plot_netlist(Twin("single-cell")).get_figure(root=True)
    assert usual is not None
    assert narrow is not None
    assert tuple(narrow.get_size_inches()) == tuple(usual.get_size_inches())


def test_styles_are_nested_and_end_with_their_block():
    settings = dict(matplotlib.rcParams)
    with style("paper"), style("grey"):
        figure = six_lines()
        assert matplotlib.rcParams["font.size"] == 8.0
    assert figure.get_size_inches()[0] == pytest.approx(3.5)
    assert to_hex(str(figure.axes[0].lines[0].get_color())) == GREY.blue
    assert dict(matplotlib.rcParams) == settings
    assert to_hex(str(six_lines().axes[0].lines[0].get_color())) == Palette().blue
    with pytest.raises(ZeroDivisionError), style("dark"):
        _ = 1 / 0
    assert dict(matplotlib.rcParams) == settings
    assert six_lines().get_size_inches()[0] == 5.0


def test_widths_that_have_no_meaning_are_refused():
    with pytest.raises(ParameterError, match="width: expected None beside 'grey'"):
        style("grey", width=3).__enter__()
    with pytest.raises(
        ParameterError, match=r"expected a number of at least 1, in inches, got 0\.5"
    ):
        style("paper", width=0.5).__enter__()


def test_the_page_of_pictures_names_every_function():
    page = (Path(__file__).parents[2] / "docs/pictures.md").read_text(encoding="utf-8")
    for name in plots.__all__:
        assert name == "styled" or name in page


def test_labels_that_curves_may_cross_have_a_rim_of_the_background():
    """The temperature differences of a module, each at the top of its curve."""
    heat, _ = plot_dc_sweep(MODULE, T_hot=300.0).axes
    labels = [text for text in heat.texts if text.get_text().endswith(" K")]
    assert labels
    for text in labels:
        (stroke,) = text.get_path_effects()
        assert isinstance(stroke, withStroke)
