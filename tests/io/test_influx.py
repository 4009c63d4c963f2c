"""Exports of InfluxDB: a row for each value of each field."""

import contextlib
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import RecordingError
from jaxtwin.io import read_recording
from jaxtwin.io._long_form import widened

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
