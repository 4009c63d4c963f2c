"""Recordings as text."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as hst

import jaxtwin as jt
from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, read_recording, write_recording
from jaxtwin.io._timestamps import times_of_fields

GOOD = "time_s,duty_P1,T11_degC\n0,0.5,20\n1,0.5,21\n2,-1,22\n"


@pytest.fixture
def read(tmp_path):
    """Reads a recording from the text of a file."""

    def read(text: str | bytes, **options) -> Experiment:
        path = tmp_path / "run.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return read_recording(path, **options)

    return read


def test_columns_by_name_and_unit(read):
    experiment = read(
        "time_s,ambient_degC,T11_degC,duty_P2,TAM_K,duty_P1\n"
        "10,15,20,0.1,293.15,1\n"
        "11,16,21,0.2,300,-1\n"
    )
    np.testing.assert_array_equal(experiment.time, [10, 11])
    np.testing.assert_array_equal(experiment.duty, [[1, 0.1], [-1, 0.2]])
    assert experiment.channels == ("T11", "TAM")
    np.testing.assert_allclose(experiment.temperatures, [[20, 20], [21, 26.85]], atol=1e-12)
    np.testing.assert_array_equal(experiment.ambient, [15, 16])
    assert experiment.name == "run"


def test_counts_with_their_full_scale_and_polarity(read):
    text = "time_s,pwm_P1,duty_P2\n0,255,1\n1,-51,1\n"
    np.testing.assert_array_equal(read(text, counts=255).duty, [[1, 1], [-0.2, 1]])
    np.testing.assert_array_equal(read(text, counts=510, polarity=-1).duty, [[-0.5, 1], [0.1, 1]])


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        "# a bench note, with a comma\n\n" + GOOD + "\n\n",
        GOOD.replace(",", " , "),
        GOOD.replace("20", '"2e1"'),
        GOOD.rstrip("\n"),
    ],
    ids=["plain", "CRLF", "byte order mark", "comment", "blanks", "quotes", "no last newline"],
)
def test_forms_of_the_same_text(read, text):
    assert read(text) == read(GOOD)


DEGREES = "time [s],duty_P1 [-],T11 (\u00b0C)\n0,0.5,20\n1,0.5,21\n2,-1,22\n"


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace(",", ";"),
        GOOD.replace(",", ";").replace("0.5", "0,5"),
        GOOD.replace(",", "\t"),
        '"time_s","duty_P1","T11_degC"\n' + GOOD.split("\n", 1)[1],
        GOOD + ",,\n,,\n",
        GOOD.replace("\n", ",\n"),
        ",time_s,duty_P1,T11_degC\n0,0,0.5,20\n1,1,0.5,21\n2,2,-1,22\n",
        GOOD.encode("utf-16"),
        DEGREES,
        DEGREES.encode("cp1252"),
        "time_ms,duty_P1 [%],T11_degC\n0,50,20\n1000,50,21\n2000,-100,22\n",
    ],
    ids=[
        "semicolons",
        "decimal comma",
        "tabs",
        "quoted names",
        "lines of blank fields",
        "separator at the end of lines",
        "index of pandas",
        "UTF-16",
        "units in brackets",
        "Windows-1252",
        "milliseconds and per cent",
    ],
)
def test_forms_that_other_programs_write(read, text):
    assert read(text) == read(GOOD)


def test_the_example_of_the_page_is_read(read):
    page = Path(__file__).parents[2] / "docs" / "recordings.md"
    (text,) = re.findall(r"```csv\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    found = read(text)
    np.testing.assert_array_equal(found.time, [0, 1, 2])
    np.testing.assert_array_equal(found.duty[:, 0], [0.5, 0.5, 0.5])
    np.testing.assert_array_equal(found.temperatures, [[21.5], [np.nan], [21.9]])
    np.testing.assert_array_equal(found.ambient, [20.1, 20.1, 20.2])


def test_time_stamps_with_a_comma_stand_beside_numbers_with_a_point(read):
    """As Python's logging writes them."""
    rows = ["2024-03-05 14:03:21,500;0.5;20.5", "2024-03-05 14:03:22,500;0.5;21.5"]
    found = read("\n".join(["time;duty_P1;T11_degC", *rows, ""]))
    np.testing.assert_array_equal(found.time, [0, 1])
    np.testing.assert_array_equal(found.temperatures, [[20.5], [21.5]])


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_line_that_names_the_separator_is_passed_over(read, separator):
    text = f"sep={separator}\n{GOOD.replace(',', separator)}"
    assert read(text) == read(GOOD)


@pytest.mark.parametrize(
    ("title", "hint"),
    [
        ("T12", "is it a temperature without its unit, T12_degC?"),
        ("duty P2 [%]", "is it duty_P2_%?"),
        ("P2", "is it duty_P2?"),
        ("pwm_2", "is it pwm_P2?"),
        ("duty 02", "is it duty_P2?"),
        ("cell 2", "is it duty_P2?"),
        ("duty heater", "is it duty_P1?"),
        ("fan", "'fan'; the speed of a fan is an input that the rig file declares in [[inputs]]"),
        ("fan [%]", "the speed of a fan is an input"),
        ("setpoint", "'setpoint'; references of a controller are no part of a recording"),
    ],
)
def test_another_name_of_a_column_is_answered_with_what_it_may_mean(read, title, hint):
    with pytest.raises(RecordingError, match=re.escape(hint)):
        read(f"time_s,duty_P1,T11_degC,{title}\n0,0.5,20,1\n1,0.5,20,1\n")


def test_a_column_of_no_known_kind_has_no_hint(read):
    with pytest.raises(RecordingError, match=r"got '12\.5 V'; columns= gives it a name"):
        read("time_s,duty_P1,T11_degC,12.5 V\n0,0.5,20,1\n1,0.5,20,1\n")


@pytest.mark.parametrize(
    "field", ["", " ", "nan", "NaN", "NA", "N/A", "#N/A", "null", "None", "-", "---"]
)
def test_a_missing_temperature_is_nan(read, field):
    experiment = read(GOOD.replace("21", field))
    np.testing.assert_array_equal(experiment.temperatures, [[20], [np.nan], [22]])


def test_a_channel_without_any_sample_stays_beside_others(read):
    experiment = read("time_s,duty_P1,a_degC,b_degC\n0,0,,1\n1,0,,1\n")
    np.testing.assert_array_equal(experiment.temperatures, [[np.nan, 1], [np.nan, 1]])


def test_a_slow_ambient_sensor_is_interpolated_and_a_blank_one_unknown(read):
    slow = "time_s,duty_P1,ambient_degC\n0,0,\n1,0,15\n2,0,\n3,0,17\n4,0,\n"
    np.testing.assert_array_equal(read(slow).ambient, [15, 15, 16, 17, 17])
    assert read("time_s,duty_P1,ambient_degC\n0,0,\n1,0,\n").ambient is None


def test_without_temperatures_steps_may_be_of_any_length(read):
    """A schedule has lost no samples, however long it holds its duty."""
    experiment = read("time_s,duty_P1,T11_degC\n0,0.5,\n1,0.5,\n2,1,\n1000,0,\n")
    assert experiment.temperatures is None
    assert experiment.channels == ("T11",)


def test_the_header_that_is_written(tmp_path, experiment):
    path = write_recording(experiment, tmp_path / "run.csv")
    first, second, *_ = path.read_text().splitlines()
    assert first == "time_s,duty_P1,duty_P2,T12_degC,T11_degC,TAM_degC,ambient_degC"
    assert second == "0.1,0.0,1.0,21.0,21.414213562373096,21.73205080756888,15.0"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("\n", "is empty: expected at least 2 samples"),
        ("time_s,duty_P1\n", "is empty: expected at least 2 samples"),
        ("time_s,duty_P1\n0,0\n", "empty: expected at least 2 samples, got 1"),
        ("# Recordings\n\nA page of text.\n", "is no recording: .* got 'A page of text.'"),
        ("0,0.5,20\n1,0.5,21\n", "must name the columns"),
        ("time,duty_P1\n0,0\n1,0\n", "line 2, column time: .*numbers need a unit, such as time_s"),
        ("time_s,duty_P1,T11\n0,0,20\n1,0,20\n", "columns: expected time_s, .* got 'T11'"),
        ("time_s,duty_P1,duty_P1\n0,0,0\n1,0,0\n", "each name once, got duty_P1 more than once"),
        ("time_s,duty_P1,pwm_P1\n0,0,0\n1,0,0\n", "one for the drive of P1, got two"),
        ("time_s,duty_P1,T_K,T_degC\n0,0,300,0\n1,0,300,0\n", "one for the temperature T, got two"),
        ("time_s,duty_P1,duty_P3\n0,0,0\n1,0,0\n", "cells P1, P2, ... without a gap, got P1, P3"),
        ("time_s,T11_degC\n0,20\n1,20\n", "drives of the cells P1, .* got none"),
        ("time_s,duty_cycle\n0,0\n1,0\n", "columns: expected time_s, .* got 'duty_cycle'"),
        (
            GOOD.replace("\n1,", "\n,"),
            "line 3, column time_s: expected a number in every line.* got ''",
        ),
        (GOOD.replace("21", "inf"), "line 3, column T11_degC: .* got 'inf'"),
        (GOOD.replace("21", "-300"), "line 3: temperature T11: .* got -300 degC"),
        (GOOD.replace("21", "2_1"), "line 3, column T11_degC: .* got '2_1'"),
        ("#\n\n" + GOOD.replace("-1", "off"), "line 6, column duty_P1: .* got 'off'"),
        (GOOD.replace(",21", ""), "line 3: expected 3 fields, one for each column, got 2"),
        (GOOD.replace("21", "21,3"), "line 3: expected 3 fields, one for each column, got 4"),
        (GOOD.replace("21", '"21'), "line 4 is no line of a .csv file"),
        (GOOD.replace("-1", "-1.2"), "line 4: duty of P1: .* got -1.2 at sample 2"),
        (
            GOOD.replace("2,", "1,", 1).replace("\n1,", "\n2,", 1),
            "line 4: time: expected increasing times",
        ),
        ("time_s,pwm_P1\n0,0\n1,300\n", "column pwm_P1: expected the counts of full duty, such as"),
        ("time_s,Time [s],duty_P1\n0,0,0\n1,1,0\n", "got two columns for the time"),
        ("time_s,duty_P1,\n0,0,a\n1,0,b\n", "got no name for column 3"),
        (
            "time_s;duty_P1;T_degC\n0;0;2,5\n1;0;2.5\n",
            "line 3, column T_degC: .*decimal.* got '2.5'",
        ),
        ("time_s;duty_P1;T_degC\n0;0;1.002,5\n1;0;2\n", "line 2, column T_degC: .* got '1.002,5'"),
        ("time_s,duty_P1,_degC\n0,0,\n1,0,\n", "columns: expected time_s, .* got '_degC'"),
        (b"\x00\xff\xfe binary", "no text"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(read, text, said):
    with pytest.raises(RecordingError, match=rf"run\.csv: .*{said}"):
        read(text)


def test_counts_beyond_full_duty_are_named_with_their_line(read):
    with pytest.raises(RecordingError, match=r"line 3: PWM of P1: .* got 300 at sample 1"):
        read("time_s,pwm_P1\n0,0\n1,300\n", counts=255)


def test_counts_are_those_of_the_rig_s_driver(read):
    """A driver of 1023 counts that cools with positive ones; counts that are given come first."""
    rig = jt.load_rig("dual-cell")
    driven = replace(rig, driver=replace(rig.driver, counts=1023, polarity=-1))
    text = "time_s,pwm_P1,pwm_P2\n0,0,1023\n1,-1023,0\n"
    assert read(text, rig=driven).duty.tolist() == [[0, -1], [1, 0]]
    assert read(text, rig=driven, counts=2046, polarity=1).duty.tolist() == [[0, 0.5], [-0.5, 0]]


def test_lost_samples_are_gaps(read):
    whole = read(GOOD + "30,0,22\n31,0,22\n40,0,25\n")
    assert whole.gaps.tolist() == [[2, 30], [31, 40]]
    assert [part.time.tolist() for part in whole.parts] == [
        [0, 1, 2],
        [0, 1, 2, 30, 31],
        [0, 1, 2, 30, 31, 40],
    ]
    assert [part.sampled.sum() for part in whole.parts] == [3, 2, 1]
    assert [part.name for part in whole.parts] == ["run part 1", "run part 2", "run part 3"]
    assert read(GOOD).parts == (read(GOOD),)


NANOSECONDS = """time,t1,time_t1,t2,time_t2,heater_on,fan_on,elapsed
1611326938720290000,21.312,1611326936960770000,25,1611326937840280000,False,False,2.6
1611326941720290000,21.312,1611326940000310000,25.5,1611326940880730000,True,False,2.7
1611326944720290000,21.375,1611326943000310000,26,1611326943880730000,True,False,2.7
"""
LOGGED = {"t1": "ambient", "t2": "upper", "heater_on": "duty_P1"}


def test_a_logger_s_file_is_read_with_names_for_its_columns(read):
    left_out = ["fan_on", "elapsed", "time_t*"]
    found = read(NANOSECONDS, columns=LOGGED, ignore=left_out)
    assert found.time.tolist() == [0, 3, 6]
    assert found.duty[:, 0].tolist() == [0, 1, 1]
    assert found.channels == ("upper",)
    assert found.temperatures is not None
    assert found.temperatures[:, 0].tolist() == [25, 25.5, 26]
    assert np.asarray(found.ambient).tolist() == [21.312, 21.312, 21.375]
    assert read(NANOSECONDS, columns=LOGGED, ignore=["*"]) == found
    with pytest.raises(RecordingError, match=r"got 'time_t1'.*; columns= .*, ignore= leaves it"):
        read(NANOSECONDS, columns=LOGGED)
    with pytest.raises(RecordingError, match=r"titles of the file, .*, got t9"):
        read(NANOSECONDS, columns={"t9": "lower"})
    with pytest.raises(RecordingError, match="ignore: expected a list of titles, got 'fan_on'"):
        read(NANOSECONDS, columns=LOGGED, ignore="fan_on")


def test_a_sensor_that_was_read_at_times_of_its_own_is_interpolated(read):
    """`upper` is read 0.88, 0.84 and 0.84 s before the samples and rises by 0.5 K in 3.04 and 3 s;
    after the last time its last value stays."""
    columns = LOGGED | {"time_t2": "upper_time"}
    found = read(NANOSECONDS, columns=columns, ignore=["*"])
    assert found.temperatures is not None
    expected = [25 + 0.5 * 0.88001 / 3.04045, 25.5 + 0.5 * 0.83956 / 2.99958, 26]
    np.testing.assert_allclose(found.temperatures[:, 0], expected, rtol=1e-6)
    with pytest.raises(RecordingError, match="times of one of ambient, upper, got 'lower'"):
        read(NANOSECONDS, columns=LOGGED | {"time_t2": "lower_time"}, ignore=["*"])


@pytest.mark.parametrize("factor", [1, 1000, 1_000_000, 1_000_000_000])
def test_times_since_1970_count_from_the_first(read, factor):
    """In s, ms, us and ns; 1.5 s is a sample of each that has fractions."""
    second = 1_608_639_796 * factor
    stamps = [second, second + 2 * factor, second + 3 * factor]
    text = "time,duty_P1,T_degC\n" + "".join(f"{stamp},0.5,21\n" for stamp in stamps)
    assert read(text).time.tolist() == [0, 2, 3]


def test_plain_numbers_are_no_time_stamps(read):
    with pytest.raises(RecordingError, match="numbers need a unit, such as time_s"):
        read("time,duty_P1,T_degC\n0,0.5,21\n1,0.5,21\n")


def test_german_titles_and_dates_are_read(read):
    found = read(
        "Zeit;duty_P1 [%];Temperatur 1 [°C];Umgebung [°C]\n"
        "05.03.2024 14:03:20;50;21,5;20,1\n05.03.2024 14:03:21;50;21,9;20,1\n"
    )
    assert found.time.tolist() == [0, 1]
    assert found.channels == ("Temperatur 1",)
    assert found.ambient == 20.1
    named = read(
        "Zeit [min];Stellgrad;Temperatur 1;Umgebung [°C]\n0;0,5;21,5;20\n1;1;22;20\n",
        columns={"Stellgrad": "duty_P1", "Temperatur 1": "T1"},
    )
    assert named.time.tolist() == [0, 60]
    assert named.channels == ("T1",)
    assert named.duty[:, 0].tolist() == [0.5, 1]


@given(
    hst.lists(hst.integers(0, 10**15), min_size=1, max_size=20), hst.sampled_from(["s", "us", "ns"])
)
def test_time_stamps_are_exact_to_a_microsecond(parts: list[int], unit: str):
    stamps = [10**15 + part for part in parts]
    written = {
        "s": [f"{stamp // 10**6}.{stamp % 10**6:06d}" for stamp in stamps],
        "us": [str(stamp) for stamp in stamps],
        "ns": [str(stamp * 1000 + 999) for stamp in stamps],
    }
    found = times_of_fields(written[unit], "time", range(len(stamps))).values
    assert found.tolist() == stamps


def test_a_zone_is_refused_for_a_csv_file(read):
    with pytest.raises(RecordingError, match=r"zone: expected none, .* two-cell \.mat .* got 'A'"):
        read(GOOD, zone="A")
