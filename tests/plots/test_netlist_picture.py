"""The picture of a network shows the network: sizes, widths, numbers, and labels one can read."""

from collections.abc import Iterator
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle
from matplotlib.text import Text

from jaxtwin import ParameterError
from jaxtwin.physics import Twin
from jaxtwin.plots import plot_netlist

RIGS = ("paper-2024", "dual-cell")


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def figure_of(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def texts(axes: Axes) -> list[Text]:
    return [text for text in axes.texts if text.get_text()]


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("heated", [False, True])
def test_no_label_lies_on_another_or_outside_of_the_figure(rig, heated):
    twin = Twin(rig)
    temperatures = np.linspace(-18.8, 188.8, len(twin.netlist.nodes)) if heated else None
    axes = plot_netlist(twin, temperatures)
    figure = figure_of(axes)
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts(axes)]
    for (one, a), (other, b) in combinations(boxes, 2):
        assert not a.overlaps(b), (one, other)
    for text, box in boxes:
        assert figure.bbox.containsx(box.x0), text
        assert figure.bbox.containsx(box.x1), text
        assert figure.bbox.containsy(box.y0), text
        assert figure.bbox.containsy(box.y1), text


@pytest.mark.parametrize("rig", RIGS)
def test_elements_have_their_true_size(rig):
    """In cm, from the top left corner, x and y to the same scale."""
    twin = Twin(rig)
    plate = twin.rig.plate
    axes = plot_netlist(twin)
    assert axes.get_aspect() == 1
    drawn = sorted(
        (*patch.get_xy(), patch.get_width(), patch.get_height())
        for patch in axes.patches
        if isinstance(patch, Rectangle)
    )
    extents = [plate.extent(name) for name in plate.element_names]
    true = sorted((x0, y0, x1 - x0, y1 - y0) for x0, x1, y0, y1 in extents)
    np.testing.assert_allclose(drawn, 100 * np.array(true), atol=1e-9)


def test_links_are_as_wide_as_they_conduct():
    """0.307 K/W between columns 1 and 2, 0.491 between 2 and 3, 1.964 down column 1."""
    axes = plot_netlist(Twin("paper-2024"))
    widths = {
        tuple(
            np.round(np.asarray(line.get_xydata(), float), 6).ravel().tolist()
        ): line.get_linewidth()
        for line in axes.lines
        if len(np.atleast_1d(line.get_xdata())) == 2
    }
    first = widths[0.5, 2, 3, 2]
    assert widths[3, 2, 7, 2] / first == pytest.approx(0.30681 / 0.49090, rel=1e-4)
    assert widths[0.5, 2, 0.5, 6] / first == pytest.approx(0.30681 / 1.96359, rel=1e-4)


def test_heat_capacities_and_resistances_stand_beside_what_they_belong_to():
    labels = [text.get_text() for text in texts(plot_netlist(Twin("paper-2024")))]
    assert labels.count("28.4") == 24 - 6  # the narrow columns say name and value in one
    assert sum("V21" in label and label.endswith("28.4") for label in labels) == 1
    assert labels.count("plate side, 17 J/K") == labels.count("far side, 17 J/K") == 2
    for resistance in ("0.09 K/W", "1.86 K/W", "0.6 K/W"):
        assert labels.count(resistance) == 2
    assert labels.count("air, 15 °C") == 2


def test_a_scale_of_colours_only_where_elements_differ():
    """The authors gave all elements one heat capacity; by geometry they differ."""
    equal, different = plot_netlist(Twin("paper-2024")), plot_netlist(Twin("dual-cell"))
    assert len(figure_of(equal).axes) == 1
    legend = equal.get_legend()
    assert legend is not None
    assert "heat capacity, J/K" in [text.get_text() for text in legend.get_texts()]
    assert len(figure_of(different).axes) == 2


def test_temperatures_stand_in_the_picture():
    twin = Twin("dual-cell")
    temperatures = 20.0 + np.arange(len(twin.netlist.nodes))
    labels = [text.get_text() for text in texts(plot_netlist(twin, temperatures))]
    assert f"{temperatures[twin.netlist.index['V24']]:.1f}" in labels
    assert f"sink, {temperatures[twin.netlist.index['P2.SINK']]:.1f} °C" in labels


@pytest.mark.parametrize("rig", RIGS)
def test_a_box_for_each_node_behind_the_plate(rig):
    twin = Twin(rig)
    boxes = [p for p in plot_netlist(twin).patches if isinstance(p, FancyBboxPatch)]
    assert len(boxes) == len(twin.netlist.nodes) - len(twin.rig.plate.element_names)


def test_axes_that_are_given_are_drawn_into_and_settings_left_alone():
    before = dict(matplotlib.rcParams)
    _, given = pyplot.subplots()
    assert plot_netlist(Twin("dual-cell"), ax=given) is given
    assert dict(matplotlib.rcParams) == before


def test_temperatures_of_the_plate_alone_are_refused():
    with pytest.raises(ParameterError, match=r"found shape \(24,\), .* 30 nodes of dual-cell"):
        plot_netlist(Twin("dual-cell"), np.full(24, 20.0))
