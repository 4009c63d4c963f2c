"""Maps of the plate: one colour scale, elements in place, every channel and cell named."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Rectangle

from jaxtwin import load_rig
from jaxtwin.errors import ParameterError
from jaxtwin.plots import plot_plate_map
from jaxtwin.rig import Rig

RIGS = ("paper-2024", "dual-cell")


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def filled(patch: Rectangle) -> bool:
    return to_rgba(patch.get_facecolor())[3] == 1


def colours(axes: Axes, rig: Rig) -> dict[str, tuple[float, ...]]:
    """Colour at each element's place."""
    found = {}
    for patch in axes.patches:
        if isinstance(patch, Rectangle) and filled(patch):
            x, y = patch.get_xy()
            found[round(x, 6), round(y, 6)] = to_rgba(patch.get_facecolor())
    corners = {name: rig.plate.extent(name) for name in rig.plate.element_names}
    return {name: found[round(100 * e[0], 6), round(100 * e[2], 6)] for name, e in corners.items()}


@pytest.mark.parametrize("name", RIGS)
def test_panels_share_one_scale(name):
    """The same temperature has the same colour at all times, and what is hotter is brighter."""
    rig = load_rig(name)
    first = np.linspace(20, 40, 24)
    figure = plot_plate_map(rig, np.stack([first, first + 10]), ("100 s", "500 s"))
    early, late = (colours(axes, rig) for axes in figure.axes[:2])
    names = rig.plate.element_names
    bright = [sum(early[element][:3]) for element in names]
    assert np.all(np.diff(bright) > 0)
    at = np.interp(first[:11] + 10, first, np.arange(24))
    for element, place in zip(names, at, strict=False):
        below, above = early[names[int(np.floor(place))]], early[names[int(np.ceil(place))]]
        low, high = np.minimum(below, above), np.maximum(below, above)
        assert np.all(late[element] >= low - 1e-9)
        assert np.all(late[element] <= high + 1e-9)


@pytest.mark.parametrize("name", RIGS)
def test_last_panel_names_every_channel_and_cell(name):
    rig = load_rig(name)
    figure = plot_plate_map(rig, np.linspace(20, 40, 24)[None], ("500 s",))
    words = [text.get_text() for text in figure.axes[1].texts]
    expected = [channel.name for channel in rig.channels] + [cell.name for cell in rig.cells]
    assert sorted(words) == sorted(expected)


def test_cells_are_outlined_where_they_touch_the_plate():
    """P1 of paper-2024 on V23: 5 ... 9 cm by 4 ... 8 cm."""
    rig = load_rig("paper-2024")
    figure = plot_plate_map(rig, np.linspace(20, 40, 24)[None], ("500 s",))
    outlines = [p for p in figure.axes[0].patches if isinstance(p, Rectangle) and not filled(p)]
    boxes = [(*box.get_xy(), box.get_width(), box.get_height()) for box in outlines]
    np.testing.assert_allclose(boxes, [(5, 4, 4, 4), (16, 4, 4, 4)], atol=1e-9)


def test_titles_say_when_and_how_hot():
    rig = load_rig("dual-cell")
    figure = plot_plate_map(rig, np.linspace(20, 40, 24)[None], ("500 s",))
    assert figure.axes[0].get_title("left") == "500 s"
    assert figure.axes[0].get_title("right") == "20.0 … 40.0 °C"


def test_rows_of_panels_hold_all_maps():
    rig = load_rig("dual-cell")
    maps = np.linspace(20, 40, 24) + np.arange(5)[:, None]
    figure = plot_plate_map(rig, maps, [f"{n} s" for n in range(5)], columns=3)
    drawn = [axes.get_title("left") for axes in figure.axes if axes.get_title("left")]
    assert drawn == ["0 s", "1 s", "2 s", "3 s", "4 s", "channels and cells"]


def test_a_single_map_goes_into_given_axes():
    rig = load_rig("dual-cell")
    figure, (left, right) = pyplot.subplots(1, 2)
    first = np.linspace(20, 40, 24)
    assert plot_plate_map(rig, first[None], ("500 s",), ax=right) is right
    assert right.get_title("left") == "500 s"
    scale = figure.axes[-1]
    assert scale.get_ylim() == (20, 40)
    assert not left.has_data()
    (alone, *_) = plot_plate_map(rig, first[None], ("500 s",)).axes
    assert colours(right, rig) == colours(alone, rig)
    with pytest.raises(
        ParameterError, match="expected a single map to draw into given axes, got 2"
    ):
        plot_plate_map(rig, np.stack([first, first]), ("0 s", "500 s"), ax=left)


@pytest.mark.parametrize("shape", [(1, 30), (2, 24)])
def test_other_shapes_than_maps_of_the_plate_are_refused(shape):
    with pytest.raises(ParameterError, match=r"expected shape \(1, 24\) .* dual-cell, got"):
        plot_plate_map(load_rig("dual-cell"), np.full(shape, 20.0), ("500 s",))
