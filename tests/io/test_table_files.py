"""Spreadsheets and Parquet files: the recording of the .csv file with the same columns."""

import builtins
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import Experiment, read_recording
from jaxtwin.errors import RecordingError
from jaxtwin.io import column_names

START = datetime(2024, 3, 5, 14, 3, 20)
NAMES = {"heater_on": "duty_P1", "t2": "T1", "t1": "ambient", "clock": "time"}


def workbook(file: Path, rows: list[list[Any]], more: bool = False) -> Path:
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    for row in rows:
        sheet.append(row)
    if more:
        book.create_sheet("notes").append(["not", "read"])
    book.save(file)
    return file


def logged() -> list[list[Any]]:
    """What a logger writes: time stamps, truth values, a column too many, a missing reading."""
    rows: list[list[Any]] = [["clock", "heater_on", "t1", "t2", "fan"]]
    for k in range(8):
        t2 = None if k == 3 else 21.5 + k / 3
        rows.append([START + timedelta(seconds=3 * k), k % 2 == 1, 20.25, t2, "on"])
    return rows


def check_logged(experiment: Experiment) -> None:
    np.testing.assert_array_equal(experiment.time, 3.0 * np.arange(8))
    np.testing.assert_array_equal(experiment.duty[:, 0], [0, 1, 0, 1, 0, 1, 0, 1])
    expected = 21.5 + np.arange(8) / 3
    expected[3] = np.nan
    assert experiment.temperatures is not None
    np.testing.assert_allclose(experiment.temperatures[:, 0], expected, rtol=1e-15)
    assert experiment.ambient is not None
    np.testing.assert_array_equal(np.broadcast_to(experiment.ambient, 8), 20.25)


def test_a_workbook_with_time_stamps_and_truth_values(tmp_path: Path):
    file = workbook(tmp_path / "box.xlsx", logged(), more=True)
    assert list(column_names(file)) == ["clock", "heater_on", "t1", "t2", "fan"]
    taken = column_names(file, columns=NAMES, ignore=["fan"])
    assert (taken["t2"], taken["fan"]) == ("T1_degC", None)
    check_logged(read_recording(file, columns=NAMES, ignore=["fan"]))


@pytest.mark.parametrize("index", [None, "clock"])
def test_a_parquet_file_with_or_without_an_index(tmp_path: Path, index: str | None):
    titles, *rows = logged()
    frame = pandas.DataFrame(rows, columns=titles)
    if index is not None:
        frame = frame.set_index(index)
    frame.to_parquet(tmp_path / "box.parquet")
    check_logged(read_recording(tmp_path / "box.parquet", columns=NAMES, ignore=["f*"]))


def test_the_times_of_an_index_without_a_name(tmp_path: Path):
    frame = pandas.DataFrame({"duty_P1": [0.0, 0.5, 1.0], "T1_degC": [20.0, 21.0, 22.0]})
    frame.index = pandas.date_range(START, periods=3, freq="2s")
    frame.to_parquet(tmp_path / "run.parquet")
    np.testing.assert_array_equal(read_recording(tmp_path / "run.parquet").time, [0, 2, 4])


NUMBERS = st.floats(-120, 84)  # none of them a code, or a room in kelvin


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-1, 1), st.one_of(st.none(), NUMBERS)), min_size=2))
def test_every_number_arrives_to_the_last_bit_or_to_the_16_digits_of_a_workbook(
    tmp_path_factory, samples
):
    folder = tmp_path_factory.mktemp("tables")
    columns = {
        "time_s": [float(k) for k in range(len(samples))],
        "duty_P1": [duty for duty, _ in samples],
        "T1_degC": [reading for _, reading in samples],
    }
    frame = pandas.DataFrame(columns)
    frame.to_parquet(folder / "run.parquet")
    rows = [list(columns), *map(list, zip(*columns.values(), strict=True))]
    workbook(folder / "run.xlsx", rows)
    assert read_recording(folder / "run.parquet") == Experiment.from_dataframe(frame)
    read = read_recording(folder / "run.xlsx").to_dataframe().to_numpy()
    expected = Experiment.from_dataframe(frame).to_dataframe().to_numpy()
    np.testing.assert_allclose(read, expected, rtol=1e-15)


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=400), st.integers(0, 10_000), st.sampled_from(["xlsx", "parquet"]))
def test_damaged_files_are_refused_in_one_sentence(tmp_path_factory, junk, place, ending):
    folder = tmp_path_factory.mktemp("damaged")
    file = folder / f"run.{ending}"
    if ending == "xlsx":
        workbook(file, [["time_s", "duty_P1"], [0, 0.5], [1, 0.5]])
    else:
        pandas.DataFrame({"time_s": [0.0, 1.0], "duty_P1": [0.5, 0.5]}).to_parquet(file)
    content = file.read_bytes()
    cut = 4 + place % (len(content) - 4)
    file.write_bytes(content[:cut] + junk)
    try:
        read_recording(file)
    except RecordingError as error:
        said = str(error)
    else:
        said = str(file)
    assert said.startswith(str(file))
    assert "\n" not in said


def test_an_old_workbook_is_refused(tmp_path: Path):
    (tmp_path / "box.xls").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(512))
    with pytest.raises(RecordingError, match=r"box.xls: expected .* \.xlsx, got the older \.xls"):
        read_recording(tmp_path / "box.xls")


@pytest.mark.parametrize(("ending", "library"), [("xlsx", "openpyxl"), ("parquet", "pyarrow")])
def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, ending, library):
    file = workbook(tmp_path / "box.xlsx", logged())
    if ending == "parquet":
        file = tmp_path / "box.parquet"
        pandas.DataFrame({"time_s": [0.0, 1.0], "duty_P1": [0.5, 0.5]}).to_parquet(file)
    really = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.partition(".")[0] == library:
            raise ImportError(name)
        return really(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RecordingError, match=r"needs pip install 'jaxtwin\[tables\]'"):
        read_recording(file)


def test_titles_of_another_format_are_refused(tmp_path: Path):
    (tmp_path / "run.nc").write_bytes(b"CDF\x01" + bytes(60))
    with pytest.raises(
        RecordingError, match=r"expected a \.csv, \.xlsx, \.parquet, \.mat or \.tdms file"
    ):
        column_names(tmp_path / "run.nc")
    assert list(column_names(_text(tmp_path))) == ["time_s", "duty_P1"]


def _text(folder: Path) -> Path:
    (folder / "run.csv").write_text("# a note\n\ntime_s,duty_P1\n0,0\n")
    return folder / "run.csv"


def test_a_sheet_by_its_name(tmp_path: Path):
    book = openpyxl.Workbook()
    book.worksheets[0].append(["notes"])
    sheet = book.create_sheet("Data")
    for row in (
        [None, "duty_P1", "T1_degC"],
        [START, 0, 20],
        [START + timedelta(seconds=1), 1, 21],
    ):
        sheet.append(row)
    book.save(tmp_path / "run.xlsx")
    assert read_recording(tmp_path / "run.xlsx", sheet="Data").time.tolist() == [0, 1]
    with pytest.raises(RecordingError, match=r"first sheet, 'Sheet', .* --sheet: Data"):
        read_recording(tmp_path / "run.xlsx")
    with pytest.raises(RecordingError, match="one of Sheet, Data, got 'data'; did you mean"):
        read_recording(tmp_path / "run.xlsx", sheet="data")
    with pytest.raises(RecordingError, match=r"sheet: expected none, as only \.xlsx files"):
        read_recording(_text(tmp_path), sheet="Data")


def test_a_tdms_file_of_labview_with_units_and_a_waveform(tmp_path: Path):
    from nptdms import ChannelObject, TdmsWriter

    wave = {"wf_start_offset": 0.0, "wf_increment": 0.5}
    probe = np.array([68.0, 70.0, 72.0])
    channels = [
        ChannelObject("Log", "Probe", probe, {"unit_string": "degF", **wave}),
        ChannelObject("Log", "Heater", np.array([0.0, 12.0, 24.0]), {"unit_string": "V", **wave}),
        ChannelObject("Notes", "Scan", np.array([1, 2, 3])),
    ]
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment(channels)
    names = {"Probe (degF)": "T1", "Heater (V)": "duty_P1"}
    run = read_recording(tmp_path / "run.tdms", columns=names, scale={"duty_P1": "1/24 V"})
    assert run.time.tolist() == [0, 0.5, 1]
    assert run.duty[:, 0].tolist() == [0, 0.5, 1]
    assert run.temperatures is not None
    np.testing.assert_allclose(run.temperatures[:, 0], (probe - 32) / 1.8)


def test_a_tdms_file_with_time_stamps_and_a_damaged_one(tmp_path: Path):
    from nptdms import ChannelObject, TdmsWriter

    stamps = np.array(["2024-03-05T14:03:20", "2024-03-05T14:03:22"], "datetime64[us]")
    channels = [
        ChannelObject("Log", "Time", stamps),
        ChannelObject("Log", "duty_P1", np.array([0.0, 1.0])),
    ]
    file = tmp_path / "run.tdms"
    with TdmsWriter(file) as writer:
        writer.write_segment(channels)
    assert read_recording(file).time.tolist() == [0, 2]
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(RecordingError, match=r"run\.tdms: "):
        read_recording(file)


def test_parquet_is_read_without_threads_that_outlive_the_process(tmp_path: Path):
    """The thread of pyarrow's data sets aborts a process that ends right after the reading, in one
    run of ten."""
    file = tmp_path / "a.parquet"
    pandas.DataFrame({"time_s": [0.0, 1.0], "duty_P1": [0.5, 0.5]}).to_parquet(file)
    script = (
        "import sys, jaxtwin\n"
        f"jaxtwin.read_recording({str(file)!r})\n"
        "print('pyarrow.dataset' in sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (told.returncode, told.stdout) == (0, "False\n")
