"""The picture of a closed loop shows its signals: outputs, references, duty in per cent, power."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.lines import Line2D
from small_results import fit

from jaxtwin import ControlError, Twin, linearize, plots, simulate_closed_loop
from jaxtwin.control import PID


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def drawn(lines: list[Line2D]) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), float) for line in lines]


@pytest.mark.slow
def test_the_signals_of_a_closed_loop_are_drawn():
    run = simulate_closed_loop(fit().twin, PID(Kp=0.1, Ki=0.001), 25.0, duration=20)
    above, duty, power = plots.plot_closed_loop(run).axes
    reference, *outputs = drawn(list(above.lines))
    np.testing.assert_array_equal(reference, np.full(21, 25.0))
    np.testing.assert_array_equal(outputs, run.output.T)
    np.testing.assert_allclose(drawn(list(duty.lines)), 100 * run.duty.T)
    *cells, total = drawn(list(power.lines))
    np.testing.assert_array_equal(cells, run.power.T)
    np.testing.assert_allclose(total, run.power.sum(axis=1))
    (plate,) = above.collections
    heights = np.asarray(plate.get_paths()[0].vertices)[:, 1]
    elements = np.asarray(run.loop.plate)
    assert (heights.min(), heights.max()) == pytest.approx((elements.min(), elements.max()))
    assert duty.get_ylabel() == "duty, %"
    assert power.get_ylabel() == "power, W"


@pytest.mark.slow
def test_the_range_of_the_plate_is_drawn_for_each_loop_beside_the_best():
    twin = fit().twin
    runs = {
        text: simulate_closed_loop(twin, PID(Kp=0.1, Ki=0.001), text, duration=20)
        for text in ("0:25", "0:20,ramp 20:25")
    }
    best = linearize(twin, duty=0.2).operating_point
    above, below = plots.plot_plate_range(runs, best).axes
    *ranges, least = drawn(list(below.lines))
    for run, mean, width in zip(runs.values(), drawn(list(above.lines)), ranges, strict=True):
        np.testing.assert_array_equal(mean, run.run.temperatures.mean(axis=1))
        np.testing.assert_array_equal(width, np.ptp(np.asarray(run.loop.plate), axis=1))
    elements = np.asarray(best.nodes)[: twin.wiring.elements]
    np.testing.assert_allclose(least, np.ptp(elements))
    legend = above.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(runs)
    with pytest.raises(ControlError, match="runs: expected at least one closed loop, got none"):
        plots.plot_plate_range({})


@pytest.mark.slow
def test_the_plate_is_drawn_beside_what_its_channels_see():
    """The hottest and the coldest element are written out, and every reading."""
    twin = fit().twin
    best = linearize(twin, duty=0.2).operating_point
    figure = plots.plot_plate_seen(twin.rig, best)
    elements, channels = figure.axes[:2]
    plate = np.asarray(best.nodes)[: twin.wiring.elements]
    written = {text.get_text() for text in elements.texts}
    assert {f"{plate.max():.1f}", f"{plate.min():.1f}"} <= written
    seen = [text.get_text() for text in channels.texts]
    assert seen == [f"{reading:.1f}" for reading in best.outputs]
    assert elements.get_title("right") == f"range {np.ptp(plate):.1f} K"
    assert channels.get_title("right") == f"range {np.ptp(best.outputs):.1f} K"
    run = simulate_closed_loop(twin, PID(Kp=0.1, Ki=0.001), 25.0, duration=5)
    at_end = plots.plot_plate_seen(twin.rig, run).axes[0]
    assert at_end.get_title("right") == f"range {run.range[-1]:.1f} K"
    with pytest.raises(ControlError, match="plot_plate_seen: expected a rig with a plate"):
        plots.plot_plate_seen(Twin("tclab").rig, best)
