"""Recordings as tables of pandas, and time stamps in files."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Experiment, read_recording
from jaxtwin.errors import RecordingError

TIMES = [0.0, 1.0, 2.5]
START = pandas.Timestamp("2024-03-05 14:03:21")


def frame(**columns) -> pandas.DataFrame:
    drive = {"duty_P1": [0.5, 0.5, -1.0], "T1_degC": [20.0, 21.0, np.nan], "T2_K": [293.15] * 3}
    return pandas.DataFrame(columns | drive)


EXPECTED = Experiment(
    TIMES,
    [0.5, 0.5, -1.0],
    channels=("T1", "T2"),
    temperatures=[[20.0, 20.0], [21.0, 20.0], [np.nan, 20.0]],
)


@pytest.mark.parametrize(
    "table",
    [
        frame(time_s=TIMES),
        frame(time_ms=[0, 1000, 2500]),
        frame(**{"Time [s]": TIMES}),
        frame().set_index(pandas.Index(TIMES)),
        frame().set_index(pandas.to_timedelta(TIMES, unit="s")),
        frame().set_index(START + pandas.to_timedelta(TIMES, unit="s")),
        frame().set_index(START.tz_localize("CET") + pandas.to_timedelta(TIMES, unit="s")),
        frame(clock=START + pandas.to_timedelta(TIMES, unit="s")),
        frame(since=pandas.to_timedelta(TIMES, unit="s")),
    ],
    ids=[
        "seconds", "milliseconds", "brackets", "index", "timedelta index", "time stamp index",
        "time zone", "time stamps", "timedelta",
    ],
)  # fmt: skip
def test_times_as_people_have_them(table: pandas.DataFrame):
    assert Experiment.from_dataframe(table) == EXPECTED


def test_a_named_time_column_and_missing_values():
    table = frame(seconds=TIMES, ambient_degC=[15.0, 15.5, 16.0])
    table["T1_degC"] = pandas.array([20.0, 21.0, None], dtype="Float64")
    found = Experiment.from_dataframe(table, time="seconds", name="Monday")
    assert found.name == "Monday"
    assert found.channels == ("T1", "T2")
    assert found.sampled.tolist() == [[True, True], [True, True], [False, True]]
    np.testing.assert_array_equal(found.ambient, [15.0, 15.5, 16.0])


@pytest.mark.parametrize("ambient", [None, 15.0, [15.0, 15.5, 16.0]])
def test_a_table_is_read_back(ambient):
    experiment = Experiment(
        TIMES,
        [[0.5, 1.0], [0.5, -1.0], [0.0, 0.25]],
        channels=("T1", "T2"),
        temperatures=[[20.0, 20.5], [21.0, np.nan], [22.0, 21.5]],
        ambient=ambient,
    )
    table = experiment.to_dataframe()
    assert table.loc[1.0, "duty_P2"] == -1.0
    assert Experiment.from_dataframe(table) == experiment


def test_a_drive_alone_is_read_back():
    drive = Experiment.schedule("0:0.5,2:0", duration=4, cells=2, channels=("T1",))
    assert Experiment.from_dataframe(drive.to_dataframe()) == drive


def test_counts_with_polarity():
    table = frame(time_s=TIMES).rename(columns={"duty_P1": "pwm_P1"})
    table["pwm_P1"] = [0, 51, -255]
    found = Experiment.from_dataframe(table, counts=255, polarity=-1)
    np.testing.assert_allclose(found.duty[:, 0], [0.0, -0.2, 1.0])


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        ([1, 2], {}, "frame: expected a DataFrame of pandas or polars, got list"),
        (frame(time_s=TIMES), {"time": "clock"}, "time: expected one of time_s, duty_P1"),
        (frame(time_s=TIMES, remark=["a"] * 3), {}, "column remark: expected numbers"),
        (frame(time_s=TIMES, power=[1.0] * 3), {}, "columns: expected time_s"),
        (frame(time=TIMES), {}, "call a column of seconds time_s, or pass time='time'"),
        (frame(time=["a", "b", "c"]), {}, "pandas.to_datetime makes time stamps of text"),
        (frame(second=TIMES), {"time": "seconds"}, "did you mean 'second'?"),
        (frame(time_s=["a", "b", "c"]), {"time": "time_s"}, "column time_s: expected seconds"),
        (
            frame(clock=[START, pandas.NaT, START]),
            {},
            "row 1, column clock: expected a time in every row",
        ),
        (frame(time_s=[0.0, 2.0, 1.0]), {}, "time: expected increasing times"),
        (frame(time_s=TIMES).drop(columns="duty_P1"), {}, "expected drives of the cells"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(table, options, message: str):
    with pytest.raises(RecordingError, match=message) as caught:
        Experiment.from_dataframe(table, **options)
    assert "\n" not in str(caught.value)


STAMPS = {
    "ISO": "time,duty_P1,T1_degC\n2024-03-05 14:03:21,0.5,20\n2024-03-05T14:03:22.5,0.5,21\n",
    "zone": (
        "Timestamp,duty_P1,T1_degC\n2024-03-05T14:03:21Z,0.5,20\n2024-03-05T15:03:22.5+01:00,0.5,21"
    ),
    "spreadsheet": (
        "Datum ignored;;\n".replace("Datum ignored", "# Pruefstand")
        + "Date;duty_P1;T1 [°C]\n05.03.2024 14:03:21;0,5;20\n05.03.2024 14:03:22,5;0,5;21,0\n"
    ),
    "midnight": (
        "datetime,duty_P1,T1_degC\n31.12.2023 23:59:59,0.5,20\n01.01.2024 00:00:00.5,0.5,21"
    ),
}


@pytest.mark.parametrize("text", STAMPS.values(), ids=STAMPS)
def test_time_stamps_in_files(text: str, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    found = read_recording(path)
    np.testing.assert_allclose(found.time, [0.0, 1.5])
    np.testing.assert_array_equal(found.temperatures, [[20.0], [21.0]])


@pytest.mark.parametrize(
    ("stamp", "message"),
    [
        ("03/05/2024 14:03:22", "line 3, column time: expected a time such as 2024-03-05"),
        ("12.5", "numbers need a unit, such as time_s"),
        ("2024-03-05", "expected a time such as"),
        ("31.02.2024 10:00:00", "expected a time such as"),
        ("2024-03-05T14:03:22Z", "expected time stamps that all have a time zone or none"),
        ("", "expected a time such as"),
        ("2024-03-05 14:03:20", "time: expected increasing times"),
    ],
)
def test_other_time_stamps_are_refused(stamp: str, message: str, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(f"time,duty_P1,T1_degC\n2024-03-05 14:03:21,0,20\n{stamp},0,21\n")
    with pytest.raises(RecordingError, match=message):
        read_recording(path)


@given(
    steps=st.lists(st.integers(1, 10**10), min_size=1, max_size=5),
    start=st.datetimes(min_value=datetime(1971, 1, 1), max_value=datetime(2200, 1, 1)),
    zone=st.sampled_from([None, UTC]),
)
def test_any_time_stamps_are_read_to_the_microsecond(steps, start, zone, tmp_path_factory):
    stamps = [start.replace(tzinfo=zone)]
    for step in steps:
        stamps.append(stamps[-1] + timedelta(microseconds=step))
    path = tmp_path_factory.mktemp("stamps") / "run.csv"
    path.write_text("time,duty_P1\n" + "".join(f"{s.isoformat()},0.5\n" for s in stamps))
    expected = [(stamp - stamps[0]).total_seconds() for stamp in stamps]
    np.testing.assert_allclose(read_recording(path).time, expected, atol=1e-6)


def test_the_unit_of_an_index_or_of_a_column_of_times_is_kept():
    expected = [0.0, 0.06, 0.12]
    by_index = pandas.DataFrame({"duty_P1": [0.5] * 3}, index=pandas.Index([0, 60, 120], name="x"))
    by_index.index.name = "time_ms"
    np.testing.assert_allclose(Experiment.from_dataframe(by_index).time, expected)
    column = pandas.DataFrame({"duty_P1": [0.5] * 3, "Elapsed [ms]": [0, 60, 120]})
    np.testing.assert_allclose(
        Experiment.from_dataframe(column, time="Elapsed [ms]").time, expected
    )


def test_a_missing_duty_is_the_last_one():
    table = frame(time_s=TIMES).assign(duty_P1=[0.5, np.nan, 0.25])
    run = Experiment.from_dataframe(table)
    assert run.duty[:, 0].tolist() == [0.5, 0.5, 0.25]
    assert run.notes == ("duty_P1: missing in 1 of 3 samples, held",)
