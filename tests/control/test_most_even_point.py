"""The most even point beside a search over all differences of the duty."""

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import most_even_point
from jaxtwin.errors import ControlError


@pytest.fixture(scope="module")
def uneven() -> Twin:
    """One cell presses less well on the plate, as on the authors' rig."""
    return jt.Twin("dual-cell", {"R_pc2_row2": 4.0})


@pytest.mark.slow
def test_no_other_duty_holds_the_mean_more_evenly(uneven: Twin):
    best = most_even_point(uneven, 40, limits=(0, 1))
    elements = uneven.wiring.elements
    assert np.mean(best.outputs) == pytest.approx(40, abs=1e-3)
    found = np.ptp(np.asarray(best.nodes)[:elements])
    assert best.duty[0] < best.duty[1] - 0.05
    # Along the line of equal mean, near the optimum and far from it.
    gain = np.asarray(jt.linearize(uneven, duty=best.duty).dcgain).mean(axis=0)
    along = np.array([1.0, -gain[0] / gain[1]])
    for distance in (-0.1, -0.01, -1e-3, 1e-3, 0.01, 0.1):
        duty = np.asarray(best.duty) + distance * along
        other = jt.linearize(uneven, duty=duty).operating_point
        # What the mean is off by, because the line is straight.
        off = abs(float(np.mean(other.outputs)) - 40)
        assert np.ptp(np.asarray(other.nodes)[:elements]) > found - off - 1e-6


@pytest.mark.slow
def test_the_most_even_duty_is_within_its_limits(uneven: Twin):
    free = most_even_point(uneven, 40)
    limit = float(free.duty[1]) - 0.03
    held = most_even_point(uneven, 40, limits=(0, limit))
    assert float(np.max(held.duty)) == pytest.approx(limit)
    assert np.mean(held.outputs) == pytest.approx(40, abs=1e-3)


@pytest.mark.slow
def test_a_mean_out_of_reach_is_refused(uneven: Twin):
    with pytest.raises(ControlError, match=r"expected a mean that duty cycles from 0 to 0\.2"):
        most_even_point(uneven, 40, limits=(0, 0.2))
    with pytest.raises(ControlError, match="temperatures: expected some that duty"):
        most_even_point(uneven, 400)
