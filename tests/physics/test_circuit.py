"""`paper-2024` is the authors' circuit: counts, sums and every link, from their model file."""

import json
from collections import defaultdict
from pathlib import Path

import pytest

from jaxtwin.physics import Netlist, Twin

FACTS = json.loads(Path(__file__).with_name("circuit_facts.json").read_text())


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="module")
def netlist(twin) -> Netlist:
    return twin.netlist


@pytest.fixture(scope="module")
def values(twin) -> dict[str, float]:
    table = twin.rig.parameters
    return {name: table[name].to_si(float(value)) for name, value in twin.values.items()}


def test_counts_of_the_model_file(netlist):
    """24 plate capacitors, 83 plate resistances (21 + 16 conduction, 46 to air), 28 states."""
    kinds = [node.kind for node in netlist.nodes]
    roles = [link.role for link in netlist.links]
    assert kinds.count("plate") == 24
    assert len(netlist.nodes) == 28
    assert (roles.count("conduction"), roles.count("film")) == (21 + 16, 46)
    assert len(netlist.cells) == 2


def test_total_capacitance_and_conductance_of_the_plate(netlist, values):
    """681.7 J/K and 4.604 W/K: one lumped time constant of about 148 s."""
    assert netlist.capacitance(values, "plate") == pytest.approx(681.7, abs=0.05)
    assert netlist.ambient_conductance(values, "plate") == pytest.approx(4.604, abs=5e-4)


def test_every_plate_capacitance_equals_the_model_file(netlist, values):
    plate = {n.name: n.capacitance.evaluate(values) for n in netlist.nodes if n.kind == "plate"}
    assert plate == pytest.approx(FACTS["capacitances"], rel=1e-9)


def test_every_plate_link_equals_the_model_file(netlist, values):
    """Parallel links one by one: V18 has three to the surroundings."""
    expected, found = defaultdict(list), defaultdict(list)
    for a, b, resistance in FACTS["links"]:
        expected[frozenset((a, b))].append(resistance)
    for link in netlist.links:
        if link.role in ("conduction", "film"):
            found[frozenset((link.a, link.b))].append(link.resistance(values))
    assert found.keys() == expected.keys()
    for ends, resistances in expected.items():
        assert sorted(found[ends]) == pytest.approx(sorted(resistances), rel=1e-9)


def test_cells_stand_on_v23_and_v26_between_contact_and_sink(netlist, values):
    """0.09 K/W to the plate, 1.861 K/W between the sides, 0.6 K/W to the sink, 17.04 J/K a side."""
    for cell, element in (("P1", "V23"), ("P2", "V26")):
        ends = {(link.a, link.b): link.resistance(values) for link in netlist.links}
        assert ends[element, f"{cell}.TC"] == pytest.approx(0.09)
        assert ends[f"{cell}.TC", f"{cell}.TH"] == pytest.approx(1.86131, abs=5e-6)
        assert ends[f"{cell}.TH", "ambient"] == pytest.approx(0.6)
        sides = [node for node in netlist.nodes if node.name in (f"{cell}.TC", f"{cell}.TH")]
        assert [n.capacitance.evaluate(values) for n in sides] == pytest.approx([17.037, 17.037])
        assert [n.initial_temperature.evaluate(values) for n in sides] == [298.0, 298.0]


def test_netlists_are_equal_when_their_contents_are(netlist):
    same = Twin("paper-2024").netlist
    assert same == netlist
    assert hash(same) == hash(netlist)
    assert Twin("dual-cell").netlist != netlist


def test_netlist_prints_its_size(netlist):
    assert repr(netlist) == "<Netlist: 28 nodes, 89 links, 2 cells>"
