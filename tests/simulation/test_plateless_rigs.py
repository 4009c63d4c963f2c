"""The bundled rigs without a plate, at rest and at the start, beside networks written down here."""

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Experiment, Twin

RIGS = ["battery-pack", "heated-box", "oven", "tclab", "water-bath"]


def _rise(links: dict[tuple[str, str], float], heat: dict[str, float]) -> dict[str, float]:
    """The temperatures above the room of a network at rest, K.

    - `links`: pairs of nodes -> W/K; `room` has the temperature 0.
    - `heat`: node -> W.
    """
    nodes = sorted({end for pair in links for end in pair} - {"room"})
    matrix, right = np.zeros((len(nodes), len(nodes))), np.zeros(len(nodes))
    for (a, b), conductance in links.items():
        for one, other in ((a, b), (b, a)):
            if one != "room":
                matrix[nodes.index(one), nodes.index(one)] += conductance
                if other != "room":
                    matrix[nodes.index(one), nodes.index(other)] -= conductance
    for node, watts in heat.items():
        right[nodes.index(node)] = watts
    return dict(zip(nodes, np.linalg.solve(matrix, right), strict=True))


def _at_rest(name: str, duty: str, **inputs: float | str) -> dict[str, float]:
    """The temperatures of the nodes above the room at the end of a long run, K."""
    twin = Twin(name)
    cells = len(twin.netlist.cells)
    run = jt.simulate(
        twin,
        Experiment.schedule(f"0:{duty}", duration=2e6, step=1e4, cells=cells).with_inputs(**inputs),
    )
    room = float(twin.values["T_amb"])
    return dict(zip(run.nodes, run.states[-1] - room, strict=True))


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_is_small_and_without_a_plate(name):
    rig = jt.load_rig(name)
    lines = [line for line in rig.text.splitlines() if line and not line.startswith("#")]
    assert len(lines) <= 45
    assert not rig.has_plate
    assert rig.references


@pytest.mark.slow
@pytest.mark.parametrize(("lid", "leak"), [("closed", 1 / 20), ("open", 1 / 0.2)])
def test_the_heated_box_at_rest(lid, leak):
    links = {
        ("heater", "air"): 1 / 0.3,
        ("heater", "wall"): 1 / 40,
        ("air", "wall"): 1 / 0.15,
        ("wall", "room"): 1 / 1.7,
        ("air", "room"): leak,
    }
    found = _at_rest("heated-box", "0.5", lid=lid)
    for node, rise in _rise(links, {"heater": 50.0}).items():
        assert found[node] == pytest.approx(rise, abs=2e-3)


@pytest.mark.slow
def test_the_heated_box_with_its_fan_off_heats_through_the_wall():
    links = {
        ("heater", "wall"): 1 / 40,
        ("air", "wall"): 1 / 0.15,
        ("wall", "room"): 1 / 1.7,
        ("air", "room"): 1 / 20,
    }
    found = _at_rest("heated-box", "0.1", fan=0.0)
    for node, rise in _rise(links, {"heater": 10.0}).items():
        assert found[node] == pytest.approx(rise, abs=5e-3)


@pytest.mark.slow
def test_the_oven_at_rest():
    links = {
        ("element", "chamber"): 1 / 0.15,
        ("chamber", "insulation"): 1 / 0.6,
        ("insulation", "room"): 1 / 0.6,
        ("chamber", "room"): 1 / 4.0,
    }
    found = _at_rest("oven", "0.2")
    for node, rise in _rise(links, {"element": 240.0}).items():
        assert found[node] == pytest.approx(rise, abs=0.02)


@pytest.mark.slow
def test_the_water_bath_at_rest_and_how_fast_it_warms():
    links = {("coil", "water"): 1 / 0.067 + 0.25**0.5 / 0.017, ("water", "room"): 1 / 0.19}
    found = _at_rest("water-bath", "0.2", stirrer=0.25)
    for node, rise in _rise(links, {"coil": 200.0}).items():
        assert found[node] == pytest.approx(rise, abs=5e-3)
    run = jt.simulate(Twin("water-bath"), Experiment.schedule("0:1", duration=600, step=10))
    water = run.states[:, run.nodes.index("water")]
    lost = (water[30:].mean() - 22.0) / 0.19
    assert (water[-1] - water[30]) / 300 == pytest.approx((1000 - lost) / (41800 + 240), rel=1e-3)


@pytest.mark.slow
def test_the_battery_pack_at_rest_with_half_the_flow():
    coolant = -7.0  # below the room
    flow = 0.5**0.8 / 0.05
    links = {
        ("cell_1", "plate"): 1 / 0.4,
        ("cell_2", "plate"): 1 / 0.4,
        ("cell_3", "plate"): 1 / 0.4,
        ("cell_1", "cell_2"): 1 / 1.5,
        ("cell_2", "cell_3"): 1 / 1.5,
        ("cell_1", "room"): 1 / 12,
        ("cell_2", "room"): 1 / 12,
        ("cell_3", "room"): 1 / 12,
        ("plate", "room"): flow,
    }
    heat = {"cell_1": 22.0, "cell_2": 0.0, "cell_3": 0.0, "plate": flow * coolant}
    found = _at_rest("battery-pack", "1/0/0", flow=0.5, T_coolant=15.0)
    for node, rise in _rise(links, heat).items():
        assert found[node] == pytest.approx(rise, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [RIGS[0], *(pytest.param(name, marks=pytest.mark.long) for name in RIGS[1:])],
)
def test_a_match_to_a_synthetic_recording_finds_other_values(name):
    twin = Twin(name)
    rng = np.random.default_rng(5)
    cells, spread = len(twin.netlist.cells), 0.15
    duty = (rng.random((12, cells)) > 0.5).repeat(40, axis=0) * 0.6
    experiment = Experiment(
        {"oven": 20.0, "water-bath": 30.0}.get(name, 5.0) * np.arange(480), duty, ambient=22.0
    ).with_inputs(
        **{one.name: one.states[0] if one.states else one.value for one in twin.rig.inputs}
    )
    free = [row.name for row in twin.rig.parameters.values() if row.free and row.lower > 0]
    truth = twin.with_values(
        {n: float(twin.values[n]) * np.exp(spread * rng.normal()) for n in free if n[0] in "RCP"}
    )
    recording = jt.simulate(truth, experiment).to_recording(noise=0.02, seed=1)
    fit = jt.match(twin, recording)
    assert fit.rmse < 1.1 * 0.02
