"""Natural convection, radiation, laws of the drive and full scales in rig files."""

import copy

import pytest
from hypothesis import given
from hypothesis import strategies as st
from radiating_rig import TABLE, radiating_rig

from jaxtwin.errors import RigError
from jaxtwin.physics import build_netlist
from jaxtwin.rig import Rig, rig_from_tables

# id: (list of tables, its number, what it gets, what it loses, words of the message)
MISTAKES = {
    "nothing carries heat": (
        "links",
        2,
        {},
        "radiating_area",
        "links[wall-shield]",
        "got none of them",
    ),
    "an exponent alone": (
        "links",
        2,
        {"convection_exponent": "0.3"},
        "",
        "links[wall-shield].convection_exponent",
        "expected convection beside it",
    ),
    "an emissivity alone": (
        "links",
        0,
        {},
        "radiating_area",
        "links[8 K/W].emissivity",
        "expected radiating_area beside it",
    ),
    "a fan alone": (
        "links",
        1,
        {"fan": {"speed": "1"}},
        "",
        "links[shield-ambient].fan",
        "expected resistance beside it",
    ),
    "a factor alone": (
        "links",
        1,
        {"factor": 2.0},
        "",
        "links[shield-ambient].factor",
        "expected a resistance beside it",
    ),
    "convection as a resistance": (
        "links",
        1,
        {"convection": "2 K/W"},
        "",
        "links[shield-ambient].convection",
        "a thermal conductance above 0",
        "'2 K/W'",
    ),
    "no area": (
        "links",
        1,
        {"radiating_area": "0 m^2"},
        "",
        "links[shield-ambient].radiating_area",
        "an area above 0",
    ),
    "an unknown drive": (
        "heaters",
        0,
        {"drive": "by square"},
        "",
        "heaters[H].drive",
        "'proportional' or 'quadratic'",
        "'by square'",
    ),
    "an exponent of 0": ("heaters", 0, {"drive": "0"}, "", "heaters[H].drive", "above 0"),
    "a law beside a resistance": (
        "heaters",
        0,
        {"electrical_resistance": "2 ohm"},
        "power",
        "heaters[H].drive",
        "a power beside it",
    ),
    "a law beside a relay": (
        "heaters",
        0,
        {"time_proportional": {"period": "20 s"}},
        "",
        "heaters[H].drive",
        "the heat of a relay is proportional",
    ),
    "a power beside a law": (
        "heaters",
        0,
        {"full_scale": "30 W"},
        "",
        "heaters[H].full_scale",
        "a voltage or a current",
        "'30 W'",
    ),
    "a full scale in kelvin": (
        "heaters",
        0,
        {"full_scale": "30 K"},
        "",
        "heaters[H].full_scale",
        "a power, a voltage or a current",
        "'30 K'",
    ),
    "a full scale of 0": (
        "heaters",
        0,
        {"full_scale": "0 V"},
        "",
        "heaters[H].full_scale",
        "a voltage above 0",
    ),
    "a number": ("heaters", 0, {"drive": 2}, "", "heaters[H].drive", "expected text"),
}


def changed(part: str, number: int, more: dict, lost: str = "") -> Rig:
    table = copy.deepcopy(TABLE)
    row = table[part][number]
    row |= more
    row.pop(lost, None)
    return rig_from_tables(table, "test.toml")


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_with_file_field_and_what_is_allowed(mistake):
    part, number, more, lost, *words = mistake
    with pytest.raises(RigError) as told:
        changed(part, number, more, lost)
    for word in ("test.toml", *words):
        assert word in str(told.value)


def test_an_end_whose_temperature_is_an_input_is_refused():
    table = copy.deepcopy(TABLE)
    table["inputs"] = [{"name": "T_wall", "value": 60.0, "unit": "degC"}]
    table["bodies"][2]["temperature"] = "T_wall"
    with pytest.raises(RigError, match=r"links\[wall-shield\].between: .* no input .* 'wall'"):
        rig_from_tables(table, "test.toml")


@given(st.text(max_size=12))
def test_any_drive_is_read_or_told(text: str):
    if text.strip() in ("quadratic", "p"):
        assert changed("heaters", 0, {"drive": text}).heaters[0].drive_exponent is not None
        return
    # Any other text is refused; of a law without a parameter, the parameter that nothing uses is.
    with pytest.raises(RigError, match=r"heaters\[H\].drive|parameters.p"):
        changed("heaters", 0, {"drive": text})


def test_radiation_alone_is_a_path_for_heat():
    links = [
        {"between": ["block-shield"], "radiating_area": "1 m^2", "emissivity": "eps"},
        {"between": ["shield-ambient"], "radiating_area": "1 m^2"},
    ]
    unused = {name: TABLE["parameters"][name] for name in ("eps", "p")}
    rig = rig_from_tables({**TABLE, "links": links, "parameters": unused}, "test.toml")
    # 4 sigma T^3 at 20 degC, by hand.
    conductance = build_netlist(rig).links[1].resistance({"eps": 0.8, "p": 2.0}) ** -1
    assert conductance == pytest.approx(4 * 5.670374e-8 * 293.15**3, rel=1e-6)


def test_only_a_law_of_the_drive_is_a_part_of_the_fingerprint():
    plain = radiating_rig().fingerprint
    assert changed("heaters", 0, {"full_scale": "12 V"}).fingerprint == plain
    table = copy.deepcopy(TABLE)
    table["heaters"][0]["drive"] = "1.5"
    del table["parameters"]["p"]
    other = copy.deepcopy(table)
    other["heaters"][0]["drive"] = "1.6"
    assert len({rig_from_tables(t, "r").fingerprint for t in (table, other)}) == 2
