"""`jaxtwin import`: the file of a logger, checked against a rig and written as a recording."""

import json

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.cli import run

LOGGED = """clock,t,room,heater_on,fan_on,elapsed
1611326938720290000,21.312,20.5,False,True,2.6
1611326941760290000,21.4,20.5,True,True,2.6
1611326944800290000,,20.5,True,True,2.6
1611326987840290000,23.5,20.6,False,True,2.6
1611326990880290000,23.25,20.6,False,True,2.6
"""
NAMES = "--column clock=time --column room=ambient --column heater_on=duty_P1"
RIG = "single-cell"


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "box.csv").write_text(LOGGED)


def imported(*more: str, names: str = NAMES) -> int:
    return run(["import", "box.csv", "--rig", RIG, *names.split(), *more, "--out", "clean.csv"])


def test_a_logger_s_file_becomes_a_recording(capsys):
    channel = jt.load_rig(RIG).channels[0].name
    names = f"{NAMES} --column t={channel}"
    assert imported("--ignore", "fan_on", "--ignore", "elapsed", names=names) == 0
    clean = jt.read_recording("clean.csv")
    np.testing.assert_allclose(clean.time, [0, 3.04, 6.08, 49.12, 52.16], atol=1e-6)
    np.testing.assert_array_equal(clean.duty[:, 0], [0, 1, 1, 0, 0])
    assert clean.channels == (channel,)
    said = capsys.readouterr().out
    assert "clean.csv: 5 samples in 52.16 s, from box.csv" in said
    assert "from heater_on  0 to 1" in said
    assert "21.31 to 23.5 degC, 1 missing" in said
    assert "left out: fan_on, elapsed" in said
    assert "nothing from 6.08 s to 49.12 s" in said


def test_a_column_that_is_called_as_a_channel_needs_no_option(tmp_path):
    channel = jt.load_rig(RIG).channels[0].name
    (tmp_path / "box.csv").write_text(LOGGED.replace(",t,", f",{channel.lower()},"))
    assert imported("--ignore", "*", "--json", "told.json") == 0
    told = json.loads((tmp_path / "told.json").read_text())
    assert (told["channels"], told["channels_without_column"]) == ([channel], [])


@pytest.mark.parametrize(
    ("names", "more", "expected"),
    [
        (NAMES + " --column t=T9", ["--ignore", "*"], "expected the channels"),
        (NAMES, ["--ignore", "elapsed"], "--column and --ignore"),
        (NAMES + " --column fan_on=duty_P2", ["--ignore", "*"], "the 1 cell of single-cell, got 2"),
        ("--column clock", [], "--column: expected TITLE=NAME, got 'clock'"),
        (NAMES + " --column cloc=time", ["--ignore", "*"], "cloc; did you mean 'clock'?"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_written(names, more, expected, capsys, tmp_path):
    assert imported(*more, names=names) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "clean.csv").exists()


def test_an_existing_file_is_kept(tmp_path, capsys):
    (tmp_path / "clean.csv").write_text("mine")
    assert imported("--ignore", "*") == 2
    assert "add --overwrite" in capsys.readouterr().err
    assert (tmp_path / "clean.csv").read_text() == "mine"
