"""Exports of InfluxDB: a row for each value of each field."""

import contextlib
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RecordingError
from jaxtwin.io import read_recording
from jaxtwin.io._delimited import widened

ANNOTATIONS = """#group,false,false,true,true,false,false,true,true
#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string
#default,mean,,,,,,,
"""
NAMES = ",result,table,_start,_stop,_time,_value,_field,_measurement\n"
SPAN = "2020-09-18T12:00:00Z,2020-09-18T13:00:00Z"


def _table(field: str, number: int, values: dict[str, str]) -> str:
    rows = [
        f",,{number},{SPAN},2020-09-18T12:00:{second}Z,{value},{field},box"
        for second, value in values.items()
    ]
    return NAMES + "\n".join(rows) + "\n"


@pytest.mark.parametrize("annotations", ["", ANNOTATIONS])
def test_an_export_is_read_with_names_for_its_fields(tmp_path, annotations):
    path = tmp_path / "box.csv"
    tables = [
        _table("t1", 0, {"00": "21.5", "03": "21.625"}),
        _table("heater_on", 1, {"00": "false", "03": "true"}),
    ]
    path.write_text("\n".join(annotations + table for table in tables))
    experiment = read_recording(path, columns={"t1": "T1", "heater_on": "duty_P1"})
    assert experiment.time.tolist() == [0.0, 3.0]
    assert experiment.duty[:, 0].tolist() == [0.0, 1.0]
    assert experiment.temperatures is not None
    assert experiment.temperatures[:, 0].tolist() == [21.5, 21.625]


def test_a_value_that_is_missing_at_a_time_is_a_missing_sample(tmp_path):
    path = tmp_path / "box.csv"
    tables = [
        _table("t1", 0, {"00": "21.5", "06": "21.625"}),
        _table("heater", 1, {"00": "0", "03": "1", "06": "1"}),
    ]
    path.write_text(NAMES + "".join(table.removeprefix(NAMES) for table in tables))
    experiment = read_recording(path, columns={"t1": "T1", "heater": "duty_P1"})
    assert experiment.temperatures is not None
    np.testing.assert_array_equal(experiment.temperatures[:, 0], [21.5, np.nan, 21.625])


def test_two_values_of_a_field_at_a_time_are_refused(tmp_path):
    path = tmp_path / "box.csv"
    path.write_text(_table("t1", 0, {"00": "21.5"}) + _table("t1", 1, {"00": "22"}))
    with pytest.raises(RecordingError, match=re.escape("expected one value of 't1' at 2020-09-18")):
        read_recording(path, columns={"t1": "T1"})


@given(st.text(max_size=200))
def test_other_text_stays_as_it_is(text):
    if not all(name in text for name in ("_time", "_field", "_value")):
        assert widened(text, ",") == text


@given(st.text('_timefldvau,\n"#0123', max_size=80))
def test_no_text_is_answered_with_another_error(text):
    with contextlib.suppress(RecordingError):
        widened(f"_time,_field,_value\n{text}", ",")


HOME_ASSISTANT = """entity_id,state,last_changed
sensor.tank,21.5,2024-03-05T14:03:20.000Z
switch.heater,off,2024-03-05T14:03:20.000Z
switch.heater,on,2024-03-05T14:03:30.000Z
sensor.tank,unavailable,2024-03-05T14:03:40.000Z
sensor.tank,21.9,2024-03-05T14:04:20.000Z
sensor.tank,22.4,2024-03-05T14:05:20.000Z
"""
TANK = {"sensor.tank": "T1", "switch.heater": "duty_P1"}


@pytest.mark.parametrize(
    "text",
    [
        HOME_ASSISTANT,
        HOME_ASSISTANT.replace(",", ";"),
        HOME_ASSISTANT.replace("entity_id,state,last_changed", "sensor,value,timestamp"),
        "# exported\n\n" + HOME_ASSISTANT,
    ],
    ids=["Home Assistant", "semicolons", "a database", "with a note"],
)
def test_states_are_held_until_they_change(tmp_path, text):
    path = tmp_path / "tank.csv"
    path.write_text(text)
    run = read_recording(path, columns=TANK)
    assert run.time.tolist() == [0, 10, 20, 60, 120]
    assert run.duty[:, 0].tolist() == [0, 1, 1, 1, 1]
    assert run.temperatures is not None
    np.testing.assert_array_equal(run.temperatures[:, 0], [21.5, np.nan, np.nan, 21.9, 22.4])
    assert run.notes == (
        "switch.heater: missing in 3 of 5 samples, held",
        "sensor.tank: missing in 1 of 5 samples, codes: unavailable (1)",
    )


def test_times_are_sorted_as_times_not_as_text(tmp_path):
    """As text, 20.4Z comes before 20Z; the readings before the first duty are left out."""
    path = tmp_path / "box.csv"
    tables = [
        _table("t1", 0, {"20": "21.5", "30": "21.6"}),
        _table("heater", 1, {"20.4": "0", "30.4": "1"}),
    ]
    path.write_text("\n".join(tables))
    run = read_recording(path, columns={"t1": "T1", "heater": "duty_P1"})
    np.testing.assert_allclose(run.time, [0, 9.6, 10])
    assert run.duty[:, 0].tolist() == [0, 0, 1]
    assert "left out before the first duty: 1 of 4 samples" in run.notes


def test_a_wide_table_with_such_titles_stays_wide(tmp_path):
    """Each row has a name of its own: `name` and `value` are two columns among others."""
    path = tmp_path / "wide.csv"
    rows = [f"2024-03-05 14:03:2{k},run{k},{k},0.5,{20 + k}" for k in range(3)]
    path.write_text("\n".join(["time,name,value,duty_P1,T1_degC", *rows]))
    run = read_recording(path, ignore=["name", "value"])
    assert run.duty[:, 0].tolist() == [0.5, 0.5, 0.5]
