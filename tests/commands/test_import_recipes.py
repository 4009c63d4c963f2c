"""The commands of docs/recordings.md, each with a file as the program writes it that it names."""

import re
import shlex
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pandas
import pytest
import scipy.io
from heated_block import heated_block_file

import jaxtwin as jt
from jaxtwin.cli import run

PAGE = Path(__file__).parents[2] / "docs" / "recordings.md"
COMMANDS = re.findall(r"^jaxtwin import .* --out run\.csv$", PAGE.read_text("utf-8"), re.MULTILINE)
START = datetime(2024, 3, 5, 14, 3, 20)
STAMPS = [START + timedelta(seconds=k) for k in range(3)]

# What every file holds, at 0, 1 and 2 s, but for one that cools.
DUTY, READINGS = (0, 1, 1), (21.5, 21.6, 21.8)

TEXTS = {
    "labview.lvm": (
        "LabVIEW Measurement\t\nSeparator\tTab\nTime\t14:03:20.5\n***End_of_Header***\t\n\t\n"
        "Channels\t2\t\t\nSamples\t3\t3\t\nX0\t0.0\t0.0\t\nDelta_X\t1.0\t1.0\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tTemperature\tHeater\tComment\n"
        "0.000000\t21.50\t0\t\n1.000000\t21.60\t1\t\n2.000000\t21.80\t1\t\n"
    ),
    "benchlink.csv": (
        "Name:,Config,,\nAcquisition Date:,3/5/2024 2:03:20 PM,,\n,,,\n"
        "Scan,Time,101 <oven> (C),201 (VDC)\n1,3/5/2024 14:03:20:000,21.50,0\n"
        "2,3/5/2024 14:03:21:000,21.60,5\n3,3/5/2024 14:03:22:000,21.80,5\n"
    ),
    "picolog.csv": (
        "Time,Ave. Temp.,Ave. Heater\n(s),(°C),(V)\n\n0.0,21.5,0\n1.0,21.6,12\n2.0,21.8,12\n"
    ),
    "home-assistant.csv": (
        "entity_id,state,last_changed\n"
        "sensor.tank,21.5,2024-03-05T14:03:20.000Z\nswitch.heater,off,2024-03-05T14:03:20.000Z\n"
        "switch.heater,on,2024-03-05T14:03:21.000Z\nsensor.tank,21.6,2024-03-05T14:03:21.000Z\n"
        "sensor.tank,21.8,2024-03-05T14:03:22.000Z\n"
        "sensor.tank,unavailable,2024-03-05T14:03:23.000Z\n"
    ),
    "influx.csv": (
        "#datatype,string,long,dateTime:RFC3339,double,string\n,result,table,_time,_value,_field\n"
        ",,0,2024-03-05T14:03:20Z,21.5,temp\n,,0,2024-03-05T14:03:21Z,21.6,temp\n"
        ",,0,2024-03-05T14:03:22Z,21.8,temp\n,,1,2024-03-05T14:03:20Z,0,heater\n"
        ",,1,2024-03-05T14:03:21Z,1,heater\n"
    ),
    "serial.txt": "   0    0  21.50\n1000  100  21.60\n2000  100  21.80\n",
    "savetxt.dat": "# time_s duty_P1 T\n0.0 0 21.5\n1.0 1 21.6\n2.0 1 21.8\n",
    "tabelle.csv": (
        "Datum;Uhrzeit;Heizung [%];Ofen [°C]\n05.03.2024;14:03:20;0;21,5\n"
        "05.03.2024;14:03:21;100;21,6\n05.03.2024;14:03:22;100;21,8\n"
    ),
    "meter.csv": "Elapsed,P_W,T\n00:00:00,0,21.5\n00:00:01,2220,21.6\n00:00:02,2220,21.8\n",
    "seconds.csv": "time,duty_P1,T_degC\n"
    + "".join(f"2024-03-05 14:03:{20 + k // 2},{int(k > 1)},{21.5 + k / 10}\n" for k in range(6)),
    "cooling.csv": "time_s,T\n0,21.5\n1,21.6\n2,21.8\n",
}


def _frame(reading: str, values: tuple[float, ...]) -> pandas.DataFrame:
    return pandas.DataFrame({"duty_P1": DUTY, reading: values}, index=pandas.DatetimeIndex(STAMPS))


def _workbook(path: Path) -> None:
    book = openpyxl.Workbook()
    book.worksheets[0].append(["notes"])
    sheet = book.create_sheet("Data")
    for row in ([None, "duty_P1", "T"], *zip(STAMPS, DUTY, READINGS, strict=True)):
        sheet.append(list(row))
    book.save(path)


def _tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    wave = {"wf_start_offset": 0.0, "wf_increment": 1.0}
    fahrenheit = 1.8 * np.array(READINGS) + 32
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("Log", "Probe", fahrenheit, {"unit_string": "degF", **wave}),
                ChannelObject("Log", "Heater", np.array(DUTY, float), wave),
            ]
        )


def _mat(path: Path) -> None:
    variables = {"t": np.arange(3.0), "u": np.array(DUTY), "y": np.array(READINGS), "Ts": 1.0}
    scipy.io.savemat(path, variables)


FILES: dict[str, Callable[[Path], None]] = {
    "frame.xlsx": _workbook,
    "frame.parquet": lambda path: _frame(
        "bed_kelvin", tuple(t + 273.15 for t in READINGS)
    ).to_parquet(path),
    "labview.tdms": _tdms,
    "bench.mat": _mat,
}


def test_the_page_has_a_command_for_every_file():
    names = {shlex.split(command)[2] for command in COMMANDS}
    assert names == {*TEXTS, *FILES}
    assert len(names) >= 12


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: shlex.split(command)[2])
def test_each_command_reads_its_file(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    heated_block_file(tmp_path)
    words = shlex.split(command)[1:]
    file = tmp_path / words[1]
    if words[1] in TEXTS:
        file.write_text(TEXTS[words[1]], encoding="utf-8")
    else:
        FILES[words[1]](file)
    assert run(words) == 0
    clean = jt.read_recording("run.csv")
    if words[1] == "seconds.csv":
        np.testing.assert_allclose(clean.time, np.arange(6) / 2)
        assert clean.duty[:, 0].tolist() == [0, 0, 1, 1, 1, 1]
        return
    assert clean.channels == ("T",)
    assert clean.temperatures is not None
    np.testing.assert_allclose(clean.time[:3], [0, 1, 2], atol=1e-9)
    np.testing.assert_allclose(clean.temperatures[:3, 0], READINGS, atol=1e-9)
    expected = (0, 0, 0) if words[1] == "cooling.csv" else DUTY
    np.testing.assert_allclose(clean.duty[:3, 0], expected, atol=1e-12)
