"""Codes in place of readings: missing, with a count; temperatures of the same number stay."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxtwin import Experiment, read_recording
from jaxtwin.io._glitches import fault_codes

LOG = "time_s,duty_P1,T1_degC\n0,1,20\n1,1,{}\n2,1,20.5\n3,1,21\n"


def _read(folder, text: str, **options) -> Experiment:
    path = folder / "run.csv"
    path.write_text(text)
    return read_recording(path, **options)


@pytest.mark.parametrize(
    "field",
    [
        *("-127", "85", "85.0", "9.9e37", "9.91E+37", "-1e38", "3.4e38", "-999", "-9999"),
        *("unavailable", "unknown", "OL", "OVLD", "open", "Error", "#DIV/0!"),
    ],
)
def test_a_code_is_a_missing_sample_and_is_counted(tmp_path, field):
    run = _read(tmp_path, LOG.format(field))
    assert run.temperatures is not None
    np.testing.assert_array_equal(run.temperatures[:, 0], [20, np.nan, 20.5, 21])
    assert run.notes == (f"T1_degC: missing in 1 of 4 samples, codes: {field} (1)",)


def test_codes_in_degF_and_of_a_table(tmp_path):
    """The driver of a DS18B20 gives -196.6 degF, which are -127 degC."""
    text = LOG.replace("_degC", "_degF").format("-196.6")
    run = _read(tmp_path, text)
    assert run.sampled[:, 0].tolist() == [True, False, True, True]
    import pandas

    table = pandas.DataFrame({"time_s": range(4), "duty_P1": 1.0, "T1_degC": [20, -127, 20, 21]})
    of_table = Experiment.from_dataframe(table)
    assert of_table.sampled[:, 0].tolist() == [True, False, True, True]


@pytest.mark.parametrize(
    "readings",
    [
        [60.0, 85.0, 110.0],  # on its way up
        [84.5, 85.0, 85.0, 85.5],
        [85.0, 85.0, 85.0],  # a plate that is held there
        [-126.0, -127.0, -128.0],
        [70.0, 85.0, 95.0],
    ],
)
def test_a_temperature_of_the_same_number_stays(readings):
    assert not fault_codes(np.array(readings)).any()


@pytest.mark.parametrize(
    ("readings", "places"),
    [
        ([85.0, 21.0, 21.0], [0]),  # after it was switched on
        ([21.0, 21.0, 85.0], [2]),
        ([21.0, 85.0, 85.0, 21.5], [1, 2]),
        ([-127.0, -127.0, 21.0, 21.0], [0, 1]),
        ([-127.0, -127.0], [0, 1]),  # never connected
        ([np.nan, 85.0, 21.0, np.nan, 22.0], [1]),
        ([21.0, -127.0, 85.0, 21.0], [1, 2]),
        ([250.0, -127.0, 85.0, 248.0], [1, 2]),
    ],
)
def test_a_code_is_known_by_what_is_around_it(readings, places):
    assert np.flatnonzero(fault_codes(np.array(readings))).tolist() == places


@given(arrays(float, st.integers(0, 30), elements=st.floats(-60, 84)), st.data())
def test_readings_that_are_no_code_are_never_masked(values, data):
    assert not fault_codes(values).any()
    if values.size:
        place = data.draw(st.integers(0, values.size - 1))
        values[place] = data.draw(st.sampled_from([9.9e37, -1e38, -9999.0]))
        assert np.flatnonzero(fault_codes(values)).tolist() == [place]


def test_a_room_with_codes_is_interpolated(tmp_path):
    text = "time_s,duty_P1,ambient_degC\n0,0,20\n1,0,-127\n2,0,22\n"
    run = _read(tmp_path, text)
    assert np.asarray(run.ambient).tolist() == [20, 21, 22]
