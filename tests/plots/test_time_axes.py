"""Pictures over time begin at the first sample and end at the last, in all of their panels."""

from collections.abc import Callable, Iterator

import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure
from small_results import fit, recordings

from jaxtwin import plots, simulate_closed_loop
from jaxtwin.control import PID
from jaxtwin.simulation import Run


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    yield
    pyplot.close("all")


def runs() -> list[Run]:
    return list(fit().runs.values())


def closed_loop() -> Figure:
    return plots.plot_closed_loop(
        simulate_closed_loop(fit().twin, PID(Kp=0.1, Ki=0.001), 25.0, duration=20)
    )


def band() -> Figure:
    run = runs()[0]
    return plots.plot_bands(run, run.temperatures - 1, run.temperatures + 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "panels", "last"),
    [
        (lambda: plots.plot_recordings(recordings()), 4, 59.0),
        (lambda: plots.plot_comparison(runs()), 10, 59.0),
        (lambda: plots.plot_residuals(runs()), 2, 59.0),
        (lambda: plots.plot_uniformity(runs()), 4, 59.0),
        (band, 5, 59.0),
        (closed_loop, 3, 20.0),
    ],
    ids=["recordings", "comparison", "residuals", "uniformity", "band", "closed loop"],
)
def test_every_panel_spans_the_samples(draw: Callable[[], Figure], panels: int, last: float):
    spans = [axes.get_xlim() for axes in draw().axes if axes.lines]
    assert spans == [(0.0, last)] * panels
