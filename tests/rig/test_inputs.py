"""The tables `[[inputs]]` of a rig file, and the fields that may name them."""

import copy
import re

import pytest
from boxes import box, box_table

from jaxtwin.errors import RigError
from jaxtwin.rig import rig_from_tables


def test_inputs_are_parts_of_the_rig():
    rig = box()
    lid, fan, volts, water = rig.inputs
    assert (lid.states, lid.value) == (("closed", "open"), 0.0)
    assert (fan.value, volts.unit) == (1.0, "V")
    assert water.scale * water.value + water.offset == pytest.approx(293.15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": [{"name": "lid", "states": ["closed"]}]}, "expected at least two states"),
        ({"inputs": [{"name": "lid", "states": ["a", "a"]}]}, "expected different names"),
        (
            {"inputs": [{"name": "lid", "states": ["closed", "open"], "value": "ajar"}]},
            "inputs[lid].value: expected one of closed, open, got 'ajar'",
        ),
        (
            {"inputs": [{"name": "lid", "states": ["closed", "open"], "unit": "V"}]},
            "inputs[lid].unit: expected none beside states",
        ),
        ({"inputs": [{"name": "fan"}]}, "inputs[fan].value: expected a number"),
        ({"inputs": [{"name": "fan", "value": 1, "unit": "parsnip"}]}, "inputs[fan].unit"),
        ({"inputs": [{"name": "R_air", "value": 1}]}, "inputs[R_air].name"),
        ({"inputs": [{"name": "ambient", "value": 1}]}, "inputs[ambient].name"),
        ({"inputs": [{"name": "a b", "value": 1}]}, "inputs[a b].name"),
        ({"inputs": [{"name": "lid", "value": 1}]}, "'lid', none, because it is a number"),
        ({"inputs": [{"name": "lid", "states": ["shut", "open"]}]}, "'lid', shut, open, got"),
    ],
)
def test_a_wrong_input_is_refused(change, message):
    table = copy.deepcopy(box_table())
    known = {one["name"]: one for one in table["inputs"]}
    table["inputs"] = list({**known, **{one["name"]: one for one in change["inputs"]}}.values())
    with pytest.raises(RigError, match=re.escape(message)):
        rig_from_tables(table, "box.toml")


def test_an_input_twice_and_one_that_nothing_uses_are_refused():
    table = box_table()
    table["inputs"].append({"name": "fan", "value": 1})
    with pytest.raises(RigError, match="expected each name once, got 'fan' twice"):
        rig_from_tables(table, "box.toml")
    table = box_table()
    table["inputs"].append({"name": "door", "value": 1})
    with pytest.raises(RigError, match=re.escape("inputs[door]: expected an input that a field")):
        rig_from_tables(table, "box.toml")


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("side_capacitance", "got the input 'fan'; an input may stand for a resistance"),
        ("sink_resistance", "got the input 'fan', a number without a unit does not measure"),
    ],
)
def test_an_input_in_a_field_that_cannot_change_is_refused(field, message):
    table = box_table()
    table["cells"][0][field] = "fan"
    with pytest.raises(RigError, match=re.escape(message)):
        rig_from_tables(table, "box.toml")


@pytest.mark.parametrize(
    ("resistance", "message"),
    [
        ({"closed": "1 K/W", "by": "lid"}, "expected a quantity, or one for each state"),
        ({"closed": "1 K/W", "ajar": "2 K/W", "by": "lid"}, "got closed, ajar"),
        ({"closed": "1 K/W", "open": "2 K/W", "by": "door"}, "'door'"),
        ({"closed": "1 K", "open": "2 K/W", "by": "lid"}, ".closed: expected a thermal"),
        ("lid", "expected a value for each state of 'lid'"),
    ],
)
def test_a_wrong_switch_is_refused(resistance, message):
    table = box_table()
    table["links"][1]["resistance"] = resistance
    with pytest.raises(RigError, match=re.escape(message)):
        rig_from_tables(table, "box.toml")
