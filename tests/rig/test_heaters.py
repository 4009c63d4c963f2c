"""Heaters and rigs without a plate in rig files."""
# ruff: noqa: E501  (a table of cases reads best with one case a line)

import math
import tomllib

import pytest
from heated_box import TEXT, heated_box
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.data import data_folder
from jaxtwin.errors import RigError
from jaxtwin.physics import build_netlist
from jaxtwin.rig import Heater, Rig, Value, json_schema, load_rig, rig_from_tables

LIST = 'contacts = ["air"]'
TABLE = 'contacts = { air = "0.8 K/W", ambient = "20 K/W" }'

# id: (text that stands in the file, text in its place, field, what else the message says)
MISTAKES = {
    "no power": ('power = "12 W"\n', "", "heaters[bulb]", "either a power or an electrical_resistance, got neither"),
    "power and resistance": ('power = "12 W"', 'power = "12 W"\nelectrical_resistance = "2 ohm"', "heaters[bulb]", "got both"),
    "a power that cools": ('power = "12 W"', 'power = "-12 W"', "heaters[bulb].power", "above 0", "'-12 W'"),
    "a power in joules": ('power = "12 W"', 'power = "12 J"', "heaters[bulb].power", "a power above 0", "'J'"),
    "no contacts": (LIST, "", "heaters[bulb].contacts", "a list of one name", "got none"),
    "two heated nodes": (LIST, 'contacts = ["air", "wall"]', "heaters[bulb].contacts", "one name", "got 2", "needs a capacitance"),
    "no heated node": (LIST, "contacts = []", "heaters[bulb].contacts", "one name", "got 0"),
    "an unknown node": (LIST, 'contacts = ["sky"]', "heaters[bulb].contacts", "one of the bodies air, wall, heater", "'sky'"),
    "the room": (LIST, 'contacts = ["ambient"]', "heaters[bulb].contacts", "'ambient'"),
    "a number for contacts": (LIST, "contacts = 3", "heaters[bulb].contacts", "a list of one name", "got 3"),
    "resistances without a capacitance": (LIST, 'contacts = { air = "1 K/W" }', "heaters[bulb].contacts", "give it a capacitance too"),
    "names beside a capacitance": (TABLE, LIST, "heaters[heater].contacts", "a table of resistances beside a capacitance"),
    "contact with itself": ("{ air =", "{ heater =", "heaters[heater].contacts", "'heater'"),
    "a start without a capacitance": (LIST, LIST + '\ninitial_temperature = "30 degC"', "heaters[bulb].initial_temperature", "a capacitance beside it"),
    "a heater named like a body": ('name = "heater"', 'name = "air"', "heaters[air].name", "is one itself"),
    "two heaters of one name": ('name = "bulb"', 'name = "heater"', "heaters", "each name once", "'heater'"),
    "a heater as the room": ('name = "heater"', 'name = "ambient"', "heaters[ambient].name", "'ambient'"),
    "an isolated heater": (TABLE + "\n", "", "heaters[heater]", "a path for its heat to ambient"),
    "an infinite contact": (TABLE, 'contacts = { air = "inf K/W" }', "heaters[heater]", "a path for its heat to ambient"),
    "an infinite power": ('power = "12 W"', 'power = "inf W"', "heaters[bulb].power", "'inf W'"),
    "an infinite resistance in watts": ('"1.5 K/W"', '"inf W"', "links[inf W].resistance", "'inf W'", "a thermal resistance"),
    "no driver for a resistance": ('power = "12 W"', 'electrical_resistance = "2 ohm"', "driver.supply_voltage", "heaters with an electrical_resistance need it"),
    "a zone without a plate": ('nodes = ["air"]', 'x = ["0 cm", "1 cm"], y = ["0 cm", "1 cm"]', "channels[T_air]", "the rig has no [plate]"),
    "reversed counts": ("[[heaters]]", "[driver]\npolarity = -1\n\n[[heaters]]", "driver.polarity", "expected 1 in a rig with heaters"),
    "an element without a plate": ('nodes = ["air"]', 'nodes = ["V11"]', "channels[T_air].nodes", "one of the bodies air, wall, heater", "'V11'"),
    "a camera without a plate": ('sensors = { noise = "0.05 K" }', 'camera = { resolution = [8, 6], noise = "0.1 K", view = { x = [0, 8], y = [0, 6] } }', "camera", "none in a rig without a [plate]", "[sensors]"),
    "a circuit without a plate": ("[[bodies]]", '[circuit]\ncapacitance = "1 J/K"\nlinks = [{ resistance = "1 K/W", between = ["V11-ambient"] }]\n\n[[bodies]]', "circuit", "none in a rig without a [plate]"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_with_file_field_and_what_is_allowed(mistake: tuple[str, ...]):
    old, new, field, *fragments = mistake
    with pytest.raises(RigError) as caught:
        heated_box((old, new))
    message = str(caught.value)
    assert message.startswith(f"box.toml: {field}: ")
    for fragment in fragments:
        assert fragment in message
    assert "\n" not in message
    assert len(message) < 500


def test_a_rig_without_cells_and_heaters_is_refused():
    document = tomllib.loads(TEXT)
    del document["heaters"]
    with pytest.raises(
        RigError, match=r"cells: expected \[\[cells\]\] or \[\[heaters\]\], got neither"
    ):
        rig_from_tables(document, "box.toml")


def test_a_rig_says_what_it_has():
    rig = heated_box()
    assert not rig.has_plate
    assert rig.heaters == (
        Heater("heater", "heater", power=Value(1.0, (("P", 1.0),))),
        Heater("bulb", "air", power=Value(12.0)),
    )
    assert [body.name for body in rig.bodies] == ["air", "wall", "heater"]
    assert rig.driven == ("heater", "bulb")
    assert rig.lowest_duty == (0.0, 0.0)
    for text in (str(rig), repr(rig), rig._repr_html_()):
        assert "bulb on air (12 W)" in text
        assert "plate" not in text


def test_a_heater_stands_behind_the_cells_of_a_rig():
    text = (data_folder() / "rigs" / "single-cell.toml").read_text()
    document = tomllib.loads(text)
    document["heaters"] = [{"name": "foil", "power": "5 W", "contacts": ["V11"]}]
    rig = rig_from_tables(document, "both")
    assert rig.driven == ("P1", "foil")
    assert rig.lowest_duty == (-1.0, 0.0)
    assert [cell.is_heater for cell in build_netlist(rig).cells] == [False, True]


def test_starts_of_heaters():
    """That of the first body that it touches, its own, or that of the rig."""

    def start(*changes: tuple[str, str]) -> float:
        nodes = build_netlist(heated_box(*changes)).nodes
        (node,) = [node for node in nodes if node.name == "heater"]
        return node.initial_temperature.factor - 273.15

    warm = ('capacitance = "60 J/K"', 'capacitance = "60 J/K"\ninitial_temperature = "30 degC"')
    own = (TABLE, TABLE + '\ninitial_temperature = "50 degC"')
    assert start() == pytest.approx(20)
    assert start(warm) == pytest.approx(30)
    assert start(warm, own) == pytest.approx(50)


@given(st.sets(st.sampled_from(["heater-air", "heater-ambient", "air-wall", "wall-ambient"])))
def test_a_rig_loads_if_and_only_if_heat_finds_its_way_out(absent: set[str]):
    """Any of the four paths of the box may be infinite, as long as each body reaches the room:
    heater - air, heater - room, air - wall, wall - room."""
    texts = {
        "heater-air": ('air = "0.8 K/W"', 'air = "inf K/W"'),
        "heater-ambient": ('ambient = "20 K/W"', 'ambient = "inf K/W"'),
        "air-wall": (
            'resistance = "R_film"\nbetween = ["air-wall"]',
            'resistance = "inf K/W"\nbetween = ["air-wall"]\n[[links]]\nresistance = "R_film"\nbetween = ["wall-ambient"]',
        ),
        "wall-ambient": ('"1.5 K/W"', '"inf K/W"'),
    }
    changes = [texts[path] for path in absent]
    wall = "wall-ambient" not in absent or "air-wall" in absent  # which moves R_film there
    pairs = [tuple(path.split("-")) for path in texts if path not in absent]
    reached = {"ambient", "wall"} if wall else {"ambient"}
    for _ in range(3):
        reached |= {end for pair in pairs for end in pair if reached.intersection(pair)}
    if reached == {"ambient", "air", "wall", "heater"}:
        netlist = build_netlist(heated_box(*changes))
        assert len(netlist.links) == 4 - len(absent) + ("air-wall" in absent)
    else:
        with pytest.raises(RigError, match="a path for its heat"):
            heated_box(*changes)


@given(
    power=st.floats(1e-3, 1e4),
    unit=st.sampled_from(["W", "mW", "kW"]),
    capacitance=st.none() | st.floats(1e-3, 1e6),
)
def test_any_power_and_capacitance_are_read(power: float, unit: str, capacitance: float | None):
    contacts = LIST
    if capacitance is not None:
        contacts = f'capacitance = "{capacitance} J/K"\ncontacts = {{ air = "1 K/W" }}'
    rig = heated_box(('power = "12 W"', f'power = "{power} {unit}"'), (LIST, contacts))
    heater = rig.heaters[1]
    scale = {"W": 1.0, "mW": 1e-3, "kW": 1e3}[unit]
    assert heater.power is not None
    assert heater.power.factor == pytest.approx(power * scale)
    assert heater.node == ("air" if capacitance is None else "bulb")
    nodes = {node.name: node.capacitance.factor for node in build_netlist(rig).nodes}
    assert nodes.get("bulb") == (None if capacitance is None else pytest.approx(capacitance))


def test_a_cell_may_touch_bodies_and_have_no_sink():
    """Both sides of the cell give their heat away through the body."""
    cell = """
[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "10 J/K"
contacts = { air = "0.3 K/W" }
"""
    driver = '[driver]\nsupply_voltage = "12 V"\non_resistance = "0.1 ohm"\ncounts = 255\n'
    driver += 'polarity = 1\naveraging = "on-off"\n'
    netlist = build_netlist(heated_box(("[[heaters]]", cell + driver + "[[heaters]]")))
    ends = {(link.a, link.b) for link in netlist.links if "P1" in link.a + link.b}
    assert ends == {("air", "P1.TC"), ("P1.TC", "P1.TH")}


def test_a_cell_without_any_way_out_is_refused():
    cell = """
[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "10 J/K"
contacts = { air = "inf K/W" }
"""
    with pytest.raises(RigError, match=r"cells\[P1\].contacts: expected a finite resistance"):
        heated_box(("[[heaters]]", cell + "[[heaters]]"))


@pytest.mark.parametrize("key", ["supply_voltage", "on_resistance", "counts", "polarity"])
def test_cells_need_the_keys_of_a_driver(key: str):
    text = (data_folder() / "rigs" / "single-cell.toml").read_text()
    document = tomllib.loads(text)
    del document["driver"][key]
    with pytest.raises(RigError, match=f"driver.{key}: missing, every rig with cells needs it"):
        rig_from_tables(document, "single-cell")
    del document["driver"]
    with pytest.raises(RigError, match="driver: missing, every rig with cells needs it"):
        rig_from_tables(document, "single-cell")


def test_the_schema_for_editors_knows_heaters():
    schema = json_schema()
    (contacts,) = [schema["$defs"]["HeaterTable"]["properties"]["contacts"]]
    assert [kind["type"] for kind in contacts["anyOf"]] == ["array", "object"]
    assert set(schema["required"]) == {"format", "name", "channels", "ambient"}


def test_rigs_that_differ_in_a_heater_differ():
    first: Rig = heated_box()
    second = heated_box(('power = "12 W"', 'power = "13 W"'))
    assert first != second
    assert first.fingerprint != second.fingerprint
    assert first == heated_box()
    assert hash(first) == hash(heated_box())


def test_a_heater_has_no_solder_that_melts():
    assert load_rig("tclab").maximum_side_temperatures == (math.inf, math.inf)
    assert load_rig("single-cell").maximum_side_temperatures == (138 + 273.15,)
