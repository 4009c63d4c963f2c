"""The clock time at 0 s is kept where a recording says it, and is no part of its contents."""

from datetime import datetime
from pathlib import Path

import numpy as np
import pandas

import jaxtwin as jt
from jaxtwin.io import Experiment


def test_a_log_with_dates_knows_when_it_began(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    rows = [f"2024-05-03 18:57:{10 + k},0.5,{20 + k}.0" for k in range(5)]
    file.write_text("\n".join(["timestamp,duty_P1,T1_degC", *rows]))
    recording = jt.read_recording(file)
    assert recording.start == datetime(2024, 5, 3, 18, 57, 10)
    assert recording.between(1.0).start == recording.start  # its times are not moved
    assert recording.select(["T1"]).start == recording.start


def test_a_table_with_time_stamps_too_by_the_clock_of_its_zone() -> None:
    index = pandas.date_range("2024-05-03 18:57:10", periods=4, freq="s", tz="Europe/Madrid")
    frame = pandas.DataFrame({"duty_P1": [0.5] * 4, "T1_degC": [20.0, 21.0, 22.0, 23.0]}, index)
    recording = Experiment.from_dataframe(frame)
    assert recording.start == datetime(2024, 5, 3, 18, 57, 10)
    np.testing.assert_allclose(recording.time, [0.0, 1.0, 2.0, 3.0])


def test_seconds_have_no_date_and_a_date_changes_no_contents() -> None:
    plain = Experiment([0.0, 1.0], [0.1, 0.1])
    assert plain.start is None
    assert Experiment([0.0, 1.0], [0.1, 0.1], start=datetime(2024, 5, 3)) == plain
