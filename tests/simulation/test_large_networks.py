"""Few modes of a large network give the temperatures that all of its modes give."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, load_rig
from jaxtwin.simulation import _reduced_modes, _simulate, simulate
from jaxtwin.simulation._simulate import is_large

SIDE = 12


@pytest.fixture
def twin(make_rig, monkeypatch) -> Twin:
    """A plate of 144 elements, which counts as large here, with a cell off its centre lines."""
    monkeypatch.setattr(_simulate, "LARGE", 100)
    rig = make_rig(
        ["1 cm"] * SIDE,
        ["1 cm"] * SIDE,
        [{"V3_4": "0.8 K/W", "V3_5": "0.8 K/W", "V4_4": "1.2 K/W"}],
        thickness="1 mm",
        more_of_plate='film_exponent = "0.25"\nemissivity = "0.3"',
        channels='[[channels]]\nname = "T"\nnodes = ["V3_4"]\n'
        '[[channels]]\nname = "far"\nnodes = ["V11_11"]',
    )
    return Twin(rig)


def both(twin: Twin, experiment: Experiment, monkeypatch, **options):
    """The run in few modes and that in all."""
    assert is_large(twin, None)
    few = simulate(twin, experiment, **options)
    monkeypatch.setattr(_simulate, "LARGE", 10**6)
    return few, simulate(twin, experiment, **options)


@pytest.mark.slow
def test_a_run_is_that_of_all_modes(twin, monkeypatch):
    few, every = both(twin, Experiment.schedule("0:0.8,300:-0.4", duration=600), monkeypatch)
    assert np.ptp(every.temperatures) > 20
    np.testing.assert_allclose(few.temperatures, every.temperatures, rtol=0, atol=5e-4)
    np.testing.assert_allclose(few.states, every.states, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_an_uneven_start_and_an_ambient_that_changes(twin, monkeypatch):
    """A hot corner, a room that warms up in a step, and no drive."""
    time = np.arange(0.0, 301.0)
    ambient = np.where(time < 100, 20.0, 23.0)
    experiment = Experiment(time, np.zeros((301, 1)), ambient=ambient)
    start = np.full(len(twin.netlist.nodes), 20.0)
    start[:14] = 60.0
    few, every = both(twin, experiment, monkeypatch, initial=start)
    np.testing.assert_allclose(few.temperatures, every.temperatures, rtol=0, atol=5e-4)
    np.testing.assert_allclose(few.states, every.states, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_all_modes_are_taken_where_the_residual_of_few_is_too_large(twin, monkeypatch):
    monkeypatch.setattr(_reduced_modes, "MAX_RESIDUAL", 0.0)
    few, every = both(twin, Experiment.schedule("0:0.8", duration=60), monkeypatch)
    np.testing.assert_array_equal(few.states, every.states)


@pytest.mark.parametrize("name", ["paper-2024", "dual-cell", "single-cell"])
def test_the_bundled_rigs_take_all_of_their_modes(name):
    assert not is_large(Twin(load_rig(name)), None)
