"""The picture of a network shows the network: sizes, widths, numbers, and labels one can read."""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hand_rig import rig_of_many_parts
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle
from matplotlib.text import Text

from jaxtwin import load_rig
from jaxtwin.errors import ParameterError
from jaxtwin.physics import Twin
from jaxtwin.plots import plot_netlist
from jaxtwin.plots._netlist_parts import WIDEST, netlist_layout
from jaxtwin.rig import Plate, Value

RIGS = ("paper-2024", "dual-cell")

PLATE = """
format = 1
name = "plate"
[plate]
columns = {sizes}
rows = {sizes}
thickness = "1 mm"
density = "8960 kg/m^3"
specific_heat = "390 J/(kg K)"
conductivity = "401 W/(m K)"
film_coefficient = "15 W/(m^2 K)"
[driver]
supply_voltage = "12 V"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"
[camera]
resolution = [80, 60]
noise = "0.1 K"
view = {{ x = [0, 80], y = [10, 50] }}
[[channels]]
name = "T1"
nodes = ["V11"]
[ambient]
temperature = "20 degC"
[initial]
temperature = "20 degC"
"""
CELL = """
[[cells]]
name = "P{number}"
module = "TEC1-12706"
side_capacitance = "17 J/K"
contacts = {{ {contacts} }}
sink_resistance = "0.5 K/W"
"""

# Name -> elements along a side, and the elements that each cell touches.
PLATES = {
    "2 x 2, one cell": (2, [("V11", "V12", "V21", "V22")]),
    "2 x 2, a cell each": (2, [("V11",), ("V12",), ("V21",), ("V22",)]),
    "5 x 5, nine cells": (5, [(f"V{row}{column}",) for row in (1, 3, 5) for column in (1, 3, 5)]),
    "1 x 1, two cells": (1, [("V11",), ("V11",)]),
}


def square(path: Path, elements: int, cells: list[tuple[str, ...]]) -> Twin:
    """A copper plate of 4 cm squares."""
    text = PLATE.format(sizes=["4 cm"] * elements)
    for number, names in enumerate(cells, start=1):
        contacts = ", ".join(f'{name} = "0.6 K/W"' for name in names)
        text += CELL.format(number=number, contacts=contacts)
    path.write_text(text, encoding="utf-8")
    return Twin(load_rig(path))


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


@pytest.mark.slow
@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("heated", [False, True])
def test_no_label_lies_on_another_or_outside_of_the_figure(rig, heated):
    twin = Twin(rig)
    temperatures = np.linspace(-18.8, 188.8, len(twin.netlist.nodes)) if heated else None
    assert_legible(plot_netlist(twin, temperatures))


@pytest.mark.parametrize("name", PLATES)
def test_square_plates_can_be_read_too(name, tmp_path):
    """Nothing on anything else, no warning of matplotlib, and a size that a slide can show."""
    axes = plot_netlist(square(tmp_path / "plate.toml", *PLATES[name]))
    assert_legible(axes)
    width, height = figure_of(axes).get_size_inches()
    assert 5 < width < 13
    assert 5 < height < 15


def test_a_long_plate_is_as_wide_as_its_elements_need():
    """Eight elements of 1 cm: 11 inches, between the least and the most that an element takes."""
    plate = Plate(columns=(0.01,) * 8, rows=(0.01,) * 2, thickness=Value(1e-3))
    layout = netlist_layout(plate, cells=1)
    left, right, _, _ = layout.plate
    assert (right - left) / layout.inch == pytest.approx(WIDEST)


def test_sensors_and_bodies_can_be_read_with_their_numbers():
    axes = plot_netlist(Twin(rig_of_many_parts("on-off")))
    assert_legible(axes)
    written = {text.get_text() for text in texts(axes)}
    assert {"block", "water", "pipe", "held at 12 °C", "body, 80 J/K"} <= written
    assert {"T1\n4 s", "T1, 4 s behind", "0.3 K/W to water", "0.8 K/W to V12"} <= written


@pytest.mark.parametrize("rig", ["heated-box", "oven", "water-bath", "battery-pack", "tclab"])
def test_a_network_without_a_plate_has_its_lines_and_can_be_read(rig: str) -> None:
    twin = Twin(rig)
    axes = plot_netlist(twin)
    assert_legible(axes)
    written = {text.get_text() for text in texts(axes)}
    assert {node.name for node in twin.netlist.nodes if node.kind != "sensor"} <= written
    assert not any("e+" in text for text in written)
    between = {
        frozenset((link.a, link.b))
        for link in twin.netlist.links
        if link.role not in ("sensor", "convection", "radiation") and link.b != "ambient"
    }
    assert sum(len(np.asarray(line.get_xydata())) == 2 for line in axes.lines) >= len(between)


def assert_legible(axes: Axes) -> None:
    figure = figure_of(axes)
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts(axes)]
    for (name, a), (other, b) in combinations(boxes, 2):
        assert not a.overlaps(b), (name, other)
    legend = axes.get_legend()
    if legend is not None:
        key = legend.get_window_extent()
        assert figure.bbox.x0 <= key.x0
        assert key.x1 <= figure.bbox.x1
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
    for cell, element in (("P1", "V23"), ("P2", "V26")):
        assert labels.count(f"{cell}\n0.09 K/W") == labels.count(f"on {element}") == 1
    for resistance in ("1.86 K/W", "0.6 K/W"):
        assert labels.count(resistance) == 2
    assert labels.count("air, 15 °C") == 2


def test_the_counts_are_those_of_the_command_line():
    """`jaxtwin netlist`: 83 resistances on the plate, as in the model file."""
    labels = [text.get_text() for text in texts(plot_netlist(Twin("paper-2024")))]
    assert "28 states, 24 plate elements, 83 resistances on the plate" in labels
    assert "circuit given, 83 resistances on the plate" in str(load_rig("paper-2024"))


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


@pytest.mark.parametrize("rig", RIGS)
def test_each_box_holds_the_name_of_its_node_and_a_line_about_it(rig):
    axes = plot_netlist(Twin(rig))
    figure_of(axes).canvas.draw()
    written = [(text.get_text(), text.get_window_extent()) for text in texts(axes)]
    held = []
    for patch in axes.patches:
        if isinstance(patch, FancyBboxPatch):
            box = patch.get_window_extent()
            inside = [
                text
                for text, extent in written
                if box.containsx(extent.x0)
                and box.containsx(extent.x1)
                and box.containsy(extent.y0)
                and box.containsy(extent.y1)
            ]
            assert len(inside) == 2
            held.append(inside[0])
    plate = Twin(rig).rig.plate.element_names
    assert sorted(held) == sorted({node.name for node in Twin(rig).netlist.nodes} - set(plate))


def test_axes_that_are_given_are_drawn_into_and_settings_left_alone():
    before = dict(matplotlib.rcParams)
    _, given = pyplot.subplots()
    assert plot_netlist(Twin("dual-cell"), ax=given) is given
    assert dict(matplotlib.rcParams) == before


def test_temperatures_of_the_plate_alone_are_refused():
    with pytest.raises(ParameterError, match=r"30 nodes of dual-cell, got shape \(24,\)"):
        plot_netlist(Twin("dual-cell"), np.full(24, 20.0))
