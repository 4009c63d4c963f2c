"""Bodies beside plate and cells: second plates, heat pipes, coolant."""

import re

import numpy as np
import pytest
from hand_rig import (
    AMBIENT,
    BODIES,
    CAPACITANCE,
    LINKS,
    SINK,
    TO_AIR,
    after,
    hand_rig,
    heater_power,
    linear_network,
)
from jaxtyping import Float
from scipy.integrate import trapezoid
from small_rigs import MakeRig
from small_rigs import make_rig as make_rig

import jaxtwin as jt
from jaxtwin import Experiment, Stepper, Twin, simulate, simulate_batch
from jaxtwin.errors import RigError

DUTY = 0.6
EXPERIMENT = Experiment.schedule(f"0:{DUTY}", duration=100)
WATER = 12.0


def by_hand(
    time: float, water: float = WATER, room: float = AMBIENT
) -> Float[np.ndarray, " nodes"]:
    """Temperatures of V11, V12, the heater's sides, block and pipe, degC: a matrix exponential."""
    links = LINKS | {(3, 4): SINK, (4, 5): 0.3, (1, 5): 0.8}
    C, G = linear_network(np.array([*CAPACITANCE, 80.0, 5.0]), links, TO_AIR | {4: 0.3})
    heat = np.zeros(6)
    heat[2:4] = heater_power(DUTY) / 2
    heat[4] = (water - room) / 0.3
    # Counted from the room, and from the start: what is left of the start decays.
    start = np.full(6, AMBIENT) - room
    start[3] = start[4] = 18.0 - room
    matrix, drive = -np.linalg.solve(C, G), np.linalg.solve(C, heat)
    return room + start + after(matrix, drive + matrix @ start, time)


@pytest.mark.slow
@pytest.mark.parametrize("room", [None, 26.0])
def test_a_cooled_block_and_a_heat_pipe_are_as_by_hand(room):
    """The coolant keeps its temperature in a room of another one; the heater's far side and the
    block start at the block's 18 degC."""
    twin = Twin(hand_rig(cell='sink = "block"', more=BODIES))
    run = simulate(twin, Experiment(EXPERIMENT.time, EXPERIMENT.duty, ambient=room))
    assert run.nodes == ("V11", "V12", "P1.TC", "P1.TH", "block", "pipe")
    for time in (0, 1, 7, 40, 100):
        expected = by_hand(time, room=AMBIENT if room is None else room)
        assert run.states[time] == pytest.approx(expected, abs=1e-6)


def test_the_uniformity_of_the_plate_leaves_out_bodies():
    """The block and the pipe are colder than both elements of the plate."""
    run = simulate(Twin(hand_rig(cell='sink = "block"', more=BODIES)), EXPERIMENT)
    assert run.plate_uniformity.places == ("V11", "V12")
    expected = np.ptp(by_hand(40)[:2])
    assert run.plate_uniformity.range[40] == pytest.approx(expected, abs=1e-6)


def test_channels_read_bodies():
    """The mean of V12 and the pipe."""
    rig = hand_rig(cell='sink = "block"', more=BODIES, read='["V12", "pipe"]')
    reading = simulate(Twin(rig), EXPERIMENT).channel("T1")[40]
    assert reading == pytest.approx(by_hand(40)[[1, 5]].mean(), abs=1e-6)


@pytest.mark.slow
def test_a_sensor_on_a_body_begins_at_its_temperature_and_lags_behind_it():
    """The block's temperature is known by hand; the sensor's is the integral over its past."""
    rig = hand_rig(cell='sink = "block"', more=BODIES, read='["block"]', channel='lag = "6 s"')
    run = simulate(Twin(rig), EXPERIMENT)
    assert run.channel("T1")[0] == pytest.approx(18.0, abs=1e-9)
    past = np.linspace(0, 30, 1201)
    block = np.array([by_hand(time)[4] for time in past])
    weights = np.exp((past - 30) / 6) / 6
    expected = 18.0 * np.exp(-30 / 6) + trapezoid(weights * block, past)
    assert run.channel("T1")[30] == pytest.approx(expected, abs=1e-4)


COOLANT_PARAMETER = """
[parameters]
T_water = { value = 12.0, unit = "degC", bounds = [0.0, 40.0], free = true, scope = "recording" }
"""


def twin_on_unknown_water() -> Twin:
    """The twin whose coolant is the parameter `T_water`."""
    bodies = BODIES.replace('"12 degC"', '"T_water"') + COOLANT_PARAMETER
    return Twin(hand_rig(cell='sink = "block"', more=bodies))


@pytest.mark.slow
def test_draws_have_a_coolant_each():
    water = np.array([5.0, 9.0, 30.0])
    drawn = simulate_batch(twin_on_unknown_water(), EXPERIMENT, {"T_water": water})
    for readings, temperature in zip(drawn, water, strict=True):
        assert readings[70, 0] == pytest.approx(by_hand(70, temperature)[1], abs=1e-4)


@pytest.mark.slow
def test_a_match_finds_the_coolant():
    """A recording of V12 made by hand, cooled by water of 9 degC."""
    readings = np.array([[by_hand(time, 9.0)[1]] for time in range(101)])
    recording = Experiment(
        EXPERIMENT.time, EXPERIMENT.duty, channels=["T1"], temperatures=readings, ambient=AMBIENT
    )
    fit = jt.match(twin_on_unknown_water(), [recording])
    (values,) = fit.recording_values.values()
    assert values["T_water"] == pytest.approx(9.0, abs=1e-3)


def test_at_rest_the_heat_of_a_cell_goes_to_air_and_coolant():
    """Power in, less what V11 and V12 lose through 5 K/W each, is what flows through 0.3 K/W. The
    power of a cell of 0.05 V/K: 12 V and its own voltage through 2.3 ohm for 0.6 of the time, and
    its own voltage through 2.1 ohm for the rest."""
    rig = hand_rig(seebeck="0.05 V/K", cell='sink = "block"', more=BODIES)
    point = jt.linearize(Twin(rig), duty=DUTY).operating_point
    T = dict(zip(("V11", "V12", "TC", "TH", "block", "pipe"), np.asarray(point.nodes), strict=True))
    own = 0.05 * (T["TH"] - T["TC"])
    on, off = (-12.0 - own) / 2.3, -own / 2.1
    power = DUTY * (own * on + 2 * on**2) + (1 - DUTY) * (own * off + 2 * off**2)
    to_air = (T["V11"] + T["V12"] - 2 * AMBIENT) / 5
    assert power == pytest.approx(to_air + (T["block"] - WATER) / 0.3, rel=1e-9)


def test_mirror_images_on_coolants_of_their_own_stay_apart():
    """Two mirrored elements, one cooled to 10 degC, one heated to 30, through the same resistance;
    the symmetric rig is solved with equal nodes made one."""
    rig = hand_rig(
        more="""
        [[bodies]]
        name = "cold"
        temperature = "10 degC"
        [[bodies]]
        name = "warm"
        temperature = "30 degC"
        [[links]]
        resistance = "0.1 K/W"
        between = ["V11-cold", "warm-V12"]
        """
    )
    nodes = simulate(Twin(rig), Experiment.schedule("0:0", duration=600)).states[-1]
    assert nodes[0] < 12 < 28 < nodes[1]


@pytest.mark.long
def test_a_plate_of_many_elements_feels_coolant_below_it(make_rig: MakeRig):
    """Such plates run in a few modes of the network, which must know the coolant; `Stepper` takes
    all modes."""
    size = 25
    links = ", ".join(f'"V{n}_{n}-water"' for n in range(1, size + 1))
    rig = make_rig(
        ["4 mm"] * size,
        ["4 mm"] * size,
        [{"V3_3": "0.5 K/W"}],
        channels='[[channels]]\nname = "T"\nnodes = ["V3_3"]',
        parameters=f"""
        [[bodies]]
        name = "water"
        temperature = "5 degC"
        [[links]]
        resistance = "20 K/W"
        between = [{links}]
        """,
    )
    twin = Twin(rig)
    run = simulate(twin, Experiment.schedule("0:0.4", duration=60, cells=1))
    stepper = Stepper(twin)
    state = stepper.step(stepper.start(), [0.4], steps=60)
    elements = np.asarray(state.nodes)[: size**2]
    assert elements.min() < AMBIENT - 1
    assert run.states[-1][: size**2] == pytest.approx(elements, abs=2e-3)


BEAD = '[[bodies]]\nname = "bead"\ncapacitance = "1 J/K"\n'
COLD = '[[bodies]]\nname = "cold"\ntemperature = "5 degC"\n'


def link(between: str, resistance: str = "1 K/W") -> str:
    return f'[[links]]\nresistance = "{resistance}"\nbetween = ["{between}"]\n'


@pytest.mark.parametrize(
    ("more", "field", "words"),
    [
        (BEAD, "bodies[bead]", "expected a path for its heat .* got none; add a link"),
        (BEAD + BEAD, "bodies", "expected each name once, got 'bead' twice"),
        (BEAD.replace("bead", "V11"), "bodies[V11].name", "neither an element .* got 'V11'"),
        (BEAD.replace("bead", "a bead"), "bodies[a bead].name", "letters, digits and _"),
        (BEAD.replace("bead", "ambient"), "bodies[ambient].name", "got 'ambient'"),
        (BEAD + 'temperature = "5 degC"', "bodies[bead]", "either a capacitance or .* got both"),
        ('[[bodies]]\nname = "bead"', "bodies[bead]", "got neither"),
        (BEAD.replace("J/K", "J"), "bodies[bead].capacitance", "a heat capacity .* got '1 J'"),
        (COLD + 'initial_temperature = "5 degC"', "bodies[cold].initial_temperature", "none"),
        (COLD.replace("degC", "K/W"), "bodies[cold].temperature", "expected a temperature"),
        (BEAD + link("bead-V19"), "links[1 K/W].between", "V11 to V12, or one of the bodies bead"),
        (BEAD + link("bead-bead"), "links[1 K/W].between", "two different nodes"),
        (BEAD + link("bead"), "links[1 K/W].between", "expected two nodes"),
        (COLD + link("cold-ambient"), "links[1 K/W].between", "an end .* not held, got"),
        (BEAD + link("bead-V11", "0 K/W"), "links[0 K/W].resistance", "above 0 .* got '0 K/W'"),
    ],
)  # fmt: skip
def test_a_wrong_body_or_link_is_refused_by_its_field(more, field, words):
    with pytest.raises(RigError, match=rf"^hand\.toml: {re.escape(field)}: .*{words}"):
        hand_rig(more=more)


@pytest.mark.parametrize(
    ("cell", "field", "words"),
    [
        ('sink = "blok"', "sink", r"unknown body 'blok', did you mean 'block'"),
        ('sink = "block"\nsink_capacitance = "9 J/K"', "sink_capacitance", "give it to the body"),
    ],
)
def test_a_wrong_sink_is_refused_by_its_field(cell, field, words):
    with pytest.raises(RigError, match=rf"hand\.toml: cells\[P1\]\.{field}: .*{words}"):
        hand_rig(cell=cell, more=BODIES)


def test_a_channel_that_reads_coolant_is_refused():
    with pytest.raises(
        RigError, match=r"channels\[T1\]\.nodes: .* bodies block, pipe, got 'water'"
    ):
        hand_rig(read='["water"]', cell='sink = "block"', more=BODIES)
