"""The bundled rigs that are not the paper's, against calculations by hand.

Sizes and constants are written out here again, from handbooks and datasheets.
"""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.data import data_folder
from jaxtwin.rig import Value, load_rig
from jaxtwin.simulation import Run

ZERO = 273.15

# J/(m^3 K).
ALUMINIUM = 2702 * 903


def driven(rig: str, text: str, duration: float, step: float = 1.0) -> Run:
    twin = Twin(rig)
    drive = Experiment.schedule(text, duration=duration, step=step, cells=len(twin.rig.driven))
    return simulate(twin, drive)


@pytest.mark.parametrize("name", ["pcr-block", "printer-bed", "dew-point-mirror"])
def test_what_a_recording_can_tell_is_free_and_has_a_prior(name):
    rig = load_rig(name)
    assert all(row.free and row.prior_spread for row in rig.parameters.values())
    assert rig.references
    assert rig.limits is not None


@pytest.mark.parametrize("name", ["pcr-block", "printer-bed", "dew-point-mirror"])
def test_forty_lines_of_toml_describe_it(name):
    text = (data_folder() / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(lines) <= 40


def test_what_a_file_does_not_say_is_that_of_its_material_and_its_room():
    """Incropera and DeWitt, Table A.1; the specific heat is a parameter of the file."""
    rig = load_rig("printer-bed")
    assert rig.plate.density == Value(2702.0)
    assert rig.plate.conductivity == Value(237.0)
    assert rig.plate.specific_heat == Value(1.0, (("c_plate", 1),))
    assert load_rig("dew-point-mirror").plate.specific_heat == Value(385.0)
    assert rig.initial_temperature == rig.ambient_temperature


@pytest.mark.slow
def test_the_pcr_block_ramps_as_its_heat_capacity_and_its_cells_say():
    """Full heating from the room's 25 degC, cooling from 95 degC on."""
    run = driven("pcr-block", "0:1,13.5:-1", 21, step=0.1)
    capacity = 0.06 * 0.04 * 0.006 * ALUMINIUM + 2 * 2.5  # block, and a side of each cell
    assert capacity == pytest.approx(40.1, abs=0.1)
    alpha, R_E, R_Th, R_pc = 0.053, 1.36, 1.24, 0.055

    def ramp(block: float, sink: float, sign: float) -> float:
        """K/s with 12 V on both cells. The contacts see the heat, and so shift both sides."""
        side, far, into_block = block, sink, 0.0
        for _ in range(30):
            current = (-sign * 12 - alpha * (far - side)) / (R_E + 0.02 + 0.1)
            joule = 0.5 * R_E * current**2
            back = (far - side) / R_Th
            into_block = joule + back - alpha * current * (side + ZERO)
            into_sink = joule - back + alpha * current * (far + ZERO)
            # The side's own part of the capacity takes its share of the heat.
            side = block + R_pc * into_block * (1 - 2 * 2.5 / capacity)
            far = sink + R_pc * into_sink
        return 2 * into_block / capacity

    block, sink = run.channel("T_left"), run.node("left.SINK")
    rate = np.gradient(block, run.time)
    for at in (60.0, 80.0):
        up = int(np.argmax(block > at))
        down = len(block) - int(np.argmax(block[::-1] > at))
        assert rate[up] == pytest.approx(ramp(block[up], sink[up], 1), rel=0.03)
        assert rate[down] == pytest.approx(ramp(block[down], sink[down], -1), rel=0.03)
        # Thermal cyclers of this size: some kelvin a second both ways.
        assert 3 < rate[up] < 8
        assert -8 < rate[down] < -3


@pytest.mark.slow
def test_the_printer_bed_settles_where_its_losses_take_up_the_power():
    """A bed of 12 V and 1.2 ohm reaches 110 degC, slowly."""
    run = driven("printer-bed", "0:1", 3600, step=20)
    power = 12**2 * 1.2 / (1.2 + 0.05 + 0.01) ** 2
    assert power == pytest.approx(109, abs=0.5)
    # Both faces and the edges.
    area = 2 * 0.214**2 + 4 * 0.214 * 0.003

    def loss(plate: float) -> float:
        rise = plate - 22
        convection = 4 * (rise / 20) ** 0.25 * rise
        radiation = 0.9 * 5.67e-8 * ((plate + ZERO) ** 4 - (22 + ZERO) ** 4)
        return area * (convection + radiation) + rise / 50

    low, high = 22.0, 200.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if loss(middle) < power else (low, middle)
    widths = np.array([1, 6.5, 6.4, 6.5, 1]) / 21.4
    plate = run.states[:, :25] @ np.outer(widths, widths).ravel()
    assert plate[-1] == pytest.approx(low, abs=2)
    assert 103 < plate[-1] < 110
    # Before it loses anything it takes up all.
    heat = 0.214**2 * (0.003 * ALUMINIUM * (plate[1] - 22))
    heat += 240 * (run.node("heater")[1] - 22)
    assert heat == pytest.approx(power * 20, rel=0.02)
    # Where no track runs it is colder.
    assert 1 < run.channel("T_middle")[-1] - run.channel("T_corner")[-1] < 4
    # On a ramp the thermistor is behind by its 5 s.
    middle = run.node("V33")
    ramp = np.gradient(middle, run.time)[10]
    assert middle[10] - run.channel("T_middle")[10] == pytest.approx(5 * ramp, rel=0.02)


@pytest.mark.slow
def test_the_dew_point_mirror_is_as_far_below_ambient_as_its_cell_can_pump():
    """Steady states: the cell's balance against what warms the mirror and what the sink gives off.

    A single stage reaches some 40 K, and the last fifths of the voltage hardly more: their Joule
    heat warms the sink.
    """
    alpha, R_E, R_Th, R_pc, R_sink, room = 0.0127, 0.343, 5.65, 0.06, 1.5, 22.0
    # One face and the edges.
    film = 30 * (0.02**2 + 4 * 0.02 * 0.002)
    depression = {}
    for duty in (0.4, 0.6, 0.8, 1.0):
        cold, hot, load = room, room, 0.0
        for _ in range(200):
            current = (3.3 * duty - alpha * (hot - cold)) / (R_E + 0.02 + 0.05 * duty)
            load = film * (room - cold) / (1 + film * R_pc)
            joule = R_E * current**2
            power = joule + alpha * current * (hot - cold)
            hot = room + (R_pc + R_sink) * (load + power)
            pumped = alpha * current + 1 / R_Th
            cold = (joule / 2 + (hot + ZERO) / R_Th + load) / pumped - ZERO * (
                alpha * current / pumped + 1 / R_Th / pumped
            )
        mirror = cold + R_pc * load
        run = driven("dew-point-mirror", f"0:-{duty}", 3000, step=20)
        assert run.temperatures[-1, 0] == pytest.approx(mirror, abs=0.2)
        depression[duty] = room - mirror
    assert depression[0.4] == pytest.approx(30, abs=2)
    assert 38 < depression[0.8] < 45
    assert abs(depression[1.0] - depression[0.8]) < 1
