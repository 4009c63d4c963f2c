"""Which draws have a meaning, without a run of each."""

import numpy as np
from hand_rig import hand_rig
from placed_rig import MOVING, placed_rig

from jaxtwin import Twin
from jaxtwin.simulation._check_values import valid_draws


def test_draws_of_a_speed_not_above_zero_are_not_valid():
    """The power of a negative speed is no real number, and that of 0 is infinite."""
    fan = 'sink_capacitance = "50 J/K"\nsink_air_resistance = "0.4 K/W"\nfan = { speed = "n_fan" }'
    speed = '[parameters]\nn_fan = { value = 1.0, unit = "", bounds = [0.2, 2.0], free = true }'
    twin = Twin(hand_rig(cell=fan, more=speed))
    drawn = {"n_fan": np.array([0.5, -1.0, 0.0, 2.0])}
    assert valid_draws(twin, drawn).tolist() == [True, False, False, True]


def test_draws_of_a_place_beyond_its_bounds_are_not_valid():
    """Those of the rig file are 30 and 80 mm."""
    drawn = {"x_1": np.array([29.0, 30.0, 80.0, 81.0])}
    assert valid_draws(Twin(placed_rig(MOVING)), drawn).tolist() == [False, True, True, False]
