"""A simulated loop that does not come to rest says so, in a sentence for each output."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxtwin import Twin, simulate_closed_loop
from jaxtwin.control import PID, Relay
from jaxtwin.control.loops._closed_loop_run import unsettled

LEFT, RIGHT = ["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]


def loop(error: np.ndarray, reference: Any = 30.0) -> Any:
    return SimpleNamespace(
        output=(30.0 + error)[:, None],
        reference=np.broadcast_to(reference, error.shape)[:, None],
    )


def test_swings_and_errors_that_stay_are_told_from_an_approach():
    time = np.arange(1000)
    assert unsettled(loop(0.02 * np.sin(time)), ["y"]) == ()
    assert unsettled(loop(3 * np.sin(time / 9)), ["y"]) == ("y swings by 6.0 K at the end",)
    assert unsettled(loop(-2.0 + 0 * time), ["y"]) == ("y stays 2.0 K below its reference",)
    assert unsettled(loop(1e-2 * np.exp(time / 150)), ["y"]) == (
        "y stays 7.8 K above its reference",
    )
    assert unsettled(loop(-20 * np.exp(-time / 400)), ["y"]) == ()  # on its way
    late = np.where(time < 700, 20.0, 30.0)
    assert unsettled(loop(-2.0 + 0 * time, late), ["y"]) == ()


def test_a_slow_drift_is_found_by_its_slope():
    """1.06 K after 1500 s and 2.2 K after 3000 s, once called settled. Noise is no drift."""
    time = np.arange(1501)
    noise = np.random.default_rng(0).normal(0.0, 0.1, 1501)
    (said,) = unsettled(loop(0.76e-3 * time - 0.08 + noise), ["y"])
    assert re.match(r"y drifts, now 1\.1 K above its reference and 2\.[1-3] K after", said)
    assert unsettled(loop(-(0.76e-3 * time - 0.08)), ["y"])[0].startswith(
        "y drifts, now 1.1 K below"
    )
    assert unsettled(loop(noise), ["y"]) == ()
    assert unsettled(loop(0.9 - 0.3e-3 * time + noise), ["y"]) == ()  # towards the reference
    assert unsettled(loop(0.2 + 0.2e-3 * time), ["y"]) == ()  # 0.8 K after as long again


@pytest.mark.slow
def test_gains_that_are_too_large_are_named(twin: Twin):
    run = simulate_closed_loop(twin, PID(1.5, 0.01, limits=(0, 1)), 35.0, duration=400)
    (said,) = run.unsettled
    assert said.startswith("mean of all swings by ")
    assert f"; {said}; loop_margins says whether the loop is stable" in repr(run)


@pytest.mark.slow
def test_cells_that_follow_the_output_of_the_other_are_named(twin: Twin):
    """Each cell heats its own half most: the pairs are swapped."""
    swapped = PID([0.1, 0.1], [0.001, 0.001], measured=[RIGHT, LEFT], limits=(0, 1))
    right = PID([0.1, 0.1], [0.001, 0.001], measured=[LEFT, RIGHT], limits=(0, 1))
    wrong = simulate_closed_loop(twin, swapped, "0:35/37", duration=1200)
    assert len(wrong.unsettled) == 2
    assert not simulate_closed_loop(twin, right, "0:37/35", duration=1200).unsettled


@pytest.mark.slow
def test_a_sample_time_of_a_minute_is_too_long_for_gains_of_a_second(twin: Twin):
    slow = PID(0.1, 0.001, limits=(0, 1), sample_time_s=60.0)
    (said,) = simulate_closed_loop(twin, slow, 40.0, duration=3600).unsettled
    assert "swings" in said


def test_a_relay_swings_and_has_no_margins(twin: Twin):
    relay = Relay(amplitude=0.1, bias=0.4, hysteresis=0.1, limits=(0, 1))
    run = simulate_closed_loop(twin, relay, 40.0, duration=900)
    assert "mean of all swings by" in repr(run)
    assert "loop_margins" not in repr(run)
