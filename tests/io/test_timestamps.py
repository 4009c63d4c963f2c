"""Times in words: each form against Python's own datetime."""

import contextlib
from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RecordingError
from jaxtwin.io import read_recording
from jaxtwin.io._timestamps import times_of_fields

FORMATS = {
    "ISO": "%Y-%m-%d %H:%M:%S.%f",
    "dots": "%d.%m.%Y %H:%M:%S.%f",
    "year first": "%Y/%m/%d %H:%M:%S.%f",
    "BenchLink": "%m/%d/%Y %H:%M:%S:%f",
    "American": "%m/%d/%Y %I:%M:%S.%f %p",
    "European": "%d/%m/%Y %H:%M:%S",
    "MATLAB": "%d-%b-%Y %H:%M:%S",
    "in words": "%b %d, %Y %I:%M:%S %p",
}
START = datetime(2024, 3, 5, 14, 3, 20)


@given(
    st.sampled_from(sorted(FORMATS)),
    st.datetimes(datetime(2001, 1, 1), datetime(2030, 1, 1)),
    st.lists(st.integers(1, 3000), min_size=1, max_size=10),
)
def test_time_stamps_of_every_form(form, start, steps):
    """The order of day and month is found where the samples follow each other within a day."""
    start = start.replace(microsecond=0)
    seconds = np.concatenate([[0], np.cumsum(steps)])
    stamps = [start + timedelta(seconds=int(s)) for s in seconds]
    times = times_of_fields(
        [stamp.strftime(FORMATS[form]) for stamp in stamps], "time", range(len(stamps))
    )
    assert ((times.values - times.values[0]) / 1e6).tolist() == seconds.tolist()


def test_the_order_of_day_and_month_is_said_where_it_matters():
    fields = ["3/5/2024 23:59:50", "3/6/2024 00:00:00"]
    times = times_of_fields(fields, "Time", [1, 2])
    assert np.diff(times.values).tolist() == [10e6]
    assert times.note == "dates of Time are read as month/day/year"
    with pytest.raises(RecordingError, match="order of day and month is clear, got '3/5/2024"):
        times_of_fields(["3/5/2024 10:00:00", "5/5/2024 10:00:00"], "Time", [1, 2])


@pytest.mark.parametrize(
    ("title", "fields", "seconds"),
    [
        ("time", ["00:00:00", "00:01:01.5"], [0, 61.5]),
        ("time", ["0:00:59", "36:00:00"], [59, 129600]),
        ("time", ["23:59:59", "00:00:01", "00:00:03"], [86399, 86401, 86403]),
        ("time", ["11:59:59 PM", "12:00:01 AM"], [86399, 86401]),
        ("time", ["0 days 00:00:01", "1 day, 0:00:02"], [1, 86402]),
        ("time", ["1:05.5", "61:00.0"], [65.5, 3660]),
        ("Elapsed (mm:ss)", ["01:05", "61:00"], [65, 3660]),
        ("Elapsed (hh:mm)", ["01:05", "02:00"], [3900, 7200]),
    ],
)
def test_elapsed_times_and_times_of_a_day(title, fields, seconds):
    assert times_of_fields(fields, title, range(len(fields))).values.tolist() == seconds


def test_two_numbers_without_a_form_are_asked_for():
    with pytest.raises(RecordingError, match=r"is it \(mm:ss\) or \(hh:mm\)"):
        times_of_fields(["01:05", "01:06"], "time", [2, 3])


@pytest.mark.parametrize(
    ("titles", "columns"),
    [("Date,Time", {}), ("Datum,Uhrzeit", {}), ("day,clock", {"day": "date", "clock": "time"})],
)
def test_a_date_and_a_time_of_the_day_are_one_time(tmp_path, titles, columns):
    path = tmp_path / "run.csv"
    rows = "2024-03-05,23:59:59,0,20\n2024-03-06,00:00:01,1,21\n"
    path.write_text(f"{titles},duty_P1,T1_degC\n{rows}")
    assert read_recording(path, columns=columns).time.tolist() == [0, 2]


def test_elapsed_words_under_the_name_of_seconds(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Elapsed,duty_P1,T1_degC\n00:00:00,0,20\n00:01:00,1,21\n")
    assert read_recording(path, columns={"Elapsed": "time_s"}).time.tolist() == [0, 60]


@given(st.lists(st.text("0123456789:/-. APMTZadys+", max_size=24), max_size=4))
def test_no_text_is_answered_with_another_error(fields):
    with contextlib.suppress(RecordingError):
        times_of_fields(fields, "time", range(len(fields)))
