"""The picture of a closed loop shows its signals: outputs, references, duty in per cent, power."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from small_results import fit

from jaxtwin import Twin, linearize, plots, simulate_closed_loop
from jaxtwin.control import PID, DecoupledPI, LoopMargins, loop_margins
from jaxtwin.errors import ControlError, ParameterError


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def drawn(lines: list[Line2D]) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), float) for line in lines]


def test_the_legend_of_outputs_that_are_means_of_many_channels_does_not_squeeze_the_axes():
    """In the notebook on control two halves of seven channels left a fifth of the width."""
    twin = Twin("dual-cell")
    halves = [list(twin.channels[:7]), list(twin.channels[7:])]
    run = simulate_closed_loop(twin, PID(Kp=0.1, Ki=0.001, measured=halves), 25.0, duration=5)
    figure = plots.plot_closed_loop(run)
    figure.canvas.draw()
    assert figure.axes[0].get_position().width > 0.75


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


@pytest.mark.slow
def test_plates_of_several_loops_are_drawn_side_by_side_on_one_scale():
    twin = fit().twin
    runs = {
        name: simulate_closed_loop(twin, PID(Kp=gain, Ki=0.001), 25.0, duration=20)
        for name, gain in (("soft", 0.05), ("hard", 0.2))
    }
    figure = plots.plot_plates(twin.rig, runs, [5, 20])
    maps = figure.axes[:4]
    assert [axes.get_title("left") for axes in maps] == ["soft", "hard", "", ""]
    assert [axes.get_ylabel() for axes in maps] == ["5 s", "", "20 s", ""]
    ranges = [f"range {run.range[at]:.1f} K" for at in (5, 20) for run in runs.values()]
    assert [axes.get_title("right") for axes in maps] == ranges
    bar = figure.axes[4]
    plates = np.array([np.asarray(run.loop.plate)[[5, 20]] for run in runs.values()])
    assert bar.get_ylim() == pytest.approx((plates.min(), plates.max()))
    with pytest.raises(ParameterError, match="times: expected 0 to 20 s, the time of soft, got 21"):
        plots.plot_plates(twin.rig, runs, [21])
    with pytest.raises(ParameterError, match="times: expected at least one"):
        plots.plot_plates(twin.rig, runs, [])
    with pytest.raises(ParameterError, match="runs: expected at least one"):
        plots.plot_plates(twin.rig, {}, [5])


def disk_of(margins: LoopMargins) -> tuple[complex, float]:
    """The centre and the radius of the disk that is drawn."""
    (disk,) = (patch for patch in margins.plot().axes[0].patches if isinstance(patch, Circle))
    x, y = disk.center
    return complex(x, y), float(disk.radius)


@pytest.mark.slow
def test_a_loop_with_one_output_touches_the_disk_of_its_nyquist_plot():
    """That is what the disk margin means (Seiler, Packard and Gahinet, 2020)."""
    margins = loop_margins(Twin("single-cell"), PID(0.1, 0.002), 35.0)
    centre, radius = disk_of(margins)
    distance = np.abs(margins.response[:, 0, 0] - centre)
    assert distance.min() == pytest.approx(radius, rel=1e-3)
    assert margins.omega[distance.argmin()] == pytest.approx(margins.disk.omega, rel=0.02)
    low, high = margins.disk.gain
    assert abs(centre - radius + 1 / low) < 1e-9
    assert abs(centre + radius + 1 / high) < 1e-9


@pytest.mark.python_control
@pytest.mark.slow
def test_the_disk_is_that_of_python_control():
    """Of the loop written out in state space: the plant of `discretise` and the law of the PI."""
    import control

    twin = Twin("single-cell")
    margins = loop_margins(twin, PID(0.1, 0.002), 35.0)
    model = linearize(twin, temperatures={"T": 35.0}).discretise(1.0)
    plant = control.ss(*(np.asarray(part) for part in (model.A, model.B, model.C, model.D)), 1.0)
    loop = plant * control.tf2ss(control.tf([0.1, 0.002 - 0.1], [1.0, -1.0], 1.0))
    size, decibels, degrees = control.disk_margins(loop, margins.omega)
    assert margins.disk.margin == pytest.approx(size, rel=1e-3)
    assert margins.disk.phase_deg == pytest.approx(degrees, rel=1e-3)
    centre, radius = disk_of(margins)
    high = 10 ** (decibels / 20)
    assert (-centre.real - radius, -centre.real + radius) == pytest.approx(
        (1 / high, high), rel=1e-3
    )


@pytest.mark.slow
def test_the_eigenvalues_of_a_loop_with_two_outputs_stay_outside_of_the_disk():
    """Their distance from its centre is at least a smallest singular value."""
    pairs = DecoupledPI(0.05, 5e-4, 0.05, 5e-4, measured=[["TAM"], ["TCM"]], limits=(0, 1))
    margins = loop_margins(Twin("dual-cell"), pairs, 40.0)
    centre, radius = disk_of(margins)
    eigenvalues = np.linalg.eigvals(margins.response)
    assert np.abs(eigenvalues - centre).min() > radius * (1 - 1e-3)
