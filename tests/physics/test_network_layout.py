"""The drawing of a network: what is driven is first, links lead to a column beside, nothing lies on
something else."""

import pytest

from jaxtwin import Twin, bundled_rigs, load_rig
from jaxtwin.physics._network_layout import network_layout

PLATELESS = [name for name in bundled_rigs() if not load_rig(name).has_plate]


@pytest.mark.parametrize("rig", PLATELESS)
def test_every_node_has_a_place_of_its_own_beside_its_links(rig: str) -> None:
    netlist = Twin(rig).netlist
    layout = network_layout(netlist)
    names = [node.name for node in netlist.nodes if node.kind != "sensor"]
    assert sorted(layout.places) == sorted([*names, *(one.name for one in netlist.reservoirs)])
    assert len(set(layout.places.values())) == len(layout.places)
    columns, rows = layout.size
    assert all(0 <= x < columns and 0 <= y < rows for x, y in layout.places.values())
    for a, b in layout.links:
        assert abs(layout.places[a][0] - layout.places[b][0]) <= 1
    driven = {cell.cold for cell in netlist.cells}
    if columns > 1 and rows > 1:
        assert {name for name, (column, _) in layout.places.items() if column == 0} == driven


def test_the_heater_of_the_box_stands_between_air_and_wall() -> None:
    layout = network_layout(Twin("heated-box").netlist)
    assert layout.places == {"heater": (0.0, 0.5), "air": (1.0, 0.0), "wall": (1.0, 1.0)}
    assert set(layout.lost) == {"air", "wall"}


def test_heaters_of_one_column_stand_side_by_side() -> None:
    assert network_layout(Twin("tclab").netlist).places == {"H1": (0.0, 0.0), "H2": (1.0, 0.0)}
