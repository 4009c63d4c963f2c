"""The simple models, on systems of their own kind."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxtwin.identification._baselines import fit_first_order, fit_two_capacities

TIME = np.arange(0.0, 2000.0, 5.0)
DUTY = np.where((TIME > 200) & (TIME < 900), 1.0, 0.0) + np.where(TIME > 1300, 0.6, 0.0)
EVERY = np.ones(len(TIME), dtype=bool)


def test_a_first_order_system_with_a_delay_comes_back():
    late = np.interp(TIME - 20.0, TIME, DUTY, left=0.0)
    state, states = 0.0, []
    for input_ in late:
        states.append(state)
        state += (1 - np.exp(-5.0 / 150.0)) * (30.0 * input_ - state)
    first = fit_first_order(DUTY[:, None], 20.0 + np.array(states), EVERY, 5.0)
    assert first.time_constant == pytest.approx(150.0, rel=0.01)
    assert first.delay == pytest.approx(20.0, abs=1.0)
    assert first.gains[0] == pytest.approx(30.0, rel=0.01)
    assert first.rest == pytest.approx(20.0, abs=0.05)


def test_two_capacities_are_fitted():
    def slope(time, state):
        duty = DUTY[min(int(time // 5.0), len(DUTY) - 1)]
        fast, slow = state
        between = 0.02 * (fast - slow)
        return [0.2 * duty - between - 0.004 * (fast - 20), 0.4 * between - 0.001 * (slow - 20)]

    solution = solve_ivp(slope, (0, TIME[-1]), [20.0, 20.0], t_eval=TIME, max_step=1.0, rtol=1e-8)
    readings = solution.y[0]
    first = fit_first_order(DUTY[:, None], readings, EVERY, 5.0)
    predicted = fit_two_capacities(DUTY[:, None], readings, EVERY, 5.0, first)
    assert np.abs(predicted - readings).max() < 0.1
    assert np.abs(first.predicted - readings).max() > 0.5
