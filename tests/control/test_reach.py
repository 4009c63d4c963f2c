"""Which references the duty can hold at rest."""

import numpy as np
import pytest

from jaxtwin import ControlError, Twin
from jaxtwin.control._reach import check_reach


def test_a_heater_holds_the_temperature_of_the_room_and_nothing_below():
    twin = Twin("printer-bed")
    system = twin.system()
    weights = np.eye(len(twin.channels))[:1]
    room = np.full((1, 1), float(system.ambient_temperature) - 273.15)
    check_reach(system, weights, room, np.zeros(1), room)
    with pytest.raises(ControlError, match="which the duty can hold, got"):
        check_reach(system, weights, room - 1.0, np.zeros(1), room)
