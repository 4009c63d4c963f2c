"""`jaxtwin import`: the file of a logger, checked against a rig and written as a recording."""

import contextlib
import hashlib
import json
import shlex

import numpy as np
import pytest
import xarray
from heated_block import heated_block_file
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxtwin as jt
from jaxtwin.cli import run
from jaxtwin.commands._file_overview import overview
from jaxtwin.commands._import_recording import ReadingOptions

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
        (
            NAMES + " --column fan_on=duty_P2",
            ["--ignore", "*"],
            "drives of P1, got P1, P2",
        ),
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


@pytest.fixture
def block(tmp_path):
    return str(heated_block_file(tmp_path))


def test_without_further_words_it_shows_the_file_and_the_command(tmp_path, block, capsys):
    """The command that it shows is one that reads the file, and nothing is written before."""
    (tmp_path / "log.csv").write_text(
        "Bench 7\n\nElapsed [min];Heizung %;bed (F);Room (C);Set Point (C);note\n"
        + "".join(f"{k};{50 * (k % 2)};{70 + k};20;25;x\n" for k in range(6))
        + "9;0;185;20;25;x\n"
    )
    before = sorted(tmp_path.iterdir())
    assert run(["import", "log.csv", "--rig", block]) == 0
    told = capsys.readouterr().out
    assert "7 rows of 6 columns, separated by semicolons, titles in line 3" in told
    for shown in ("time_min (guess)", "duty_H (guess)", "T (guess)", "ambient (guess)"):
        assert shown in told
    assert told.count("left out (guess)") == 2
    assert "7 samples in 540 s, every 60 s (60 to 240 s), gaps: 1" in told
    assert "nothing from 300 s to 540 s" in told
    assert "missing in 1 of 7 samples, codes: 185 (1)" in told  # 85 degC
    assert sorted(tmp_path.iterdir()) == before
    command = shlex.split(told.splitlines()[-1].replace("RECORDING.csv", "clean.csv"))
    assert run(command[1:]) == 0
    clean = jt.read_recording("clean.csv")
    assert clean.duty[:, 0].tolist() == [0, 0.5, 0, 0.5, 0, 0.5, 0]
    np.testing.assert_allclose(clean.temperatures[:6, 0], (np.arange(6) + 38) / 1.8)  # pyright: ignore[reportOptionalSubscript]


def test_a_glitch_is_shown(tmp_path, capsys):
    readings = [20, 20, 20, 31, 20, 20.5]
    rows = "".join(f"{k},0,{t}\n" for k, t in enumerate(readings))
    (tmp_path / "log.csv").write_text("time_s,duty_P1,T1_degC\n" + rows)
    assert run(["import", "log.csv"]) == 0
    assert "T1 at 3 s reads 31 degC, +11 K from the readings beside it" in capsys.readouterr().out


def test_a_title_that_is_no_name_is_guessed_with_one(tmp_path, capsys):
    rows = "".join(f"{k},{20 + k},0.5\n" for k in range(6))
    (tmp_path / "log.csv").write_text("time_s,101 <oven> (C),duty_P1\n" + rows)
    assert run(["import", "log.csv"]) == 0
    (command,) = [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("  jaxtwin import")
    ]
    assert "--column '101 <oven> (C)=T1'" in command
    recording = jt.read_recording(tmp_path / "log.csv", columns={"101 <oven> (C)": "T1"})
    assert recording.channels == ("T1",)


@pytest.mark.parametrize("text", ["", "x", "a,b\n", "1,2\n", "a\n1\n2\n", ",,\n1,,\n2,,\n"])
def test_a_file_without_a_recording_is_no_traceback(text, tmp_path, capsys):
    (tmp_path / "log.csv").write_text(text)
    assert run(["import", "log.csv"]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err


def test_what_was_done_is_written_into_the_file(tmp_path, block):
    (tmp_path / "log.csv").write_text(
        "P_W,temp_f,clock\n0,70,0:00:00\n,-196.6,0:00:01\n30,71,0:00:02\n"
    )
    columns = ["P_W=duty_P1", "temp_f=T", "clock=time"]
    words = [word for column in columns for word in ("--column", column)]
    command = ["import", "log.csv", "--rig", block, *words, "--scale", "duty_P1=1/30 W"]
    assert run([*command, "--out", "clean.csv"]) == 0
    notes = [line for line in (tmp_path / "clean.csv").read_text().splitlines() if line[0] == "#"]
    assert notes[0].startswith("# jaxtwin import log.csv --rig block.toml --column P_W=duty_P1")
    assert "'duty_P1=1/30 W' --out clean.csv" in notes[0]
    checksum = hashlib.sha256((tmp_path / "log.csv").read_bytes()).hexdigest()
    assert notes[1] == f"# of log.csv, SHA-256 {checksum}"
    assert "# T from temp_f, degF 21.11 to 21.67 degC, 1 missing" in notes
    assert "# P_W: missing in 1 of 3 samples, held" in notes
    clean = jt.read_recording("clean.csv")
    assert clean.duty[:, 0].tolist() == [0, 0, 1]
    assert run([*command, "--out", "clean.nc"]) == 0
    with xarray.open_dataset("clean.nc", engine="scipy") as dataset:
        assert "jaxtwin import log.csv" in dataset.attrs["history"]
    assert jt.read_recording("clean.nc") == clean


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--out", "clean.csv"], "--rig: expected the rig file"),
        (["--no-header", "--header-line", "3"], "expected one of them, got both"),
        (["--scale", "duty_P1"], "--scale: expected NAME=FACTOR, got 'duty_P1'"),
    ],
)
def test_options_that_do_not_belong_together(words, expected, capsys):
    assert run(["import", "box.csv", *words]) == 2
    assert expected in capsys.readouterr().err


def test_commands_say_what_was_done_to_a_recording(tmp_path, capsys, block):
    (tmp_path / "run.csv").write_text(
        "time_s,duty_P1,T_degC\n0,0,22\n1,1,9.9e37\n2,1,22.1\n3,1,22.4\n"
    )
    assert run(["simulate", block, "--recording", "run.csv", "--out", "out.csv"]) == 0
    assert "run.csv: T_degC: missing in 1 of 4 samples, codes: 9.9e37" in capsys.readouterr().err


@given(
    st.lists(
        st.lists(
            st.sampled_from(
                [
                    *("time", "time_s", "T (F)", "heater", "", "1", "2.5", "-127", "on", "off"),
                    *("2024-03-05 14:03:20", "14:03:21", "(s)", "# a", "entity_id", "state", "x"),
                ]
            ),
            min_size=1,
            max_size=4,
        ),
        max_size=7,
    ),
    st.sampled_from([",", ";", "\t", " "]),
)
@settings(max_examples=150, deadline=None)
def test_no_file_is_answered_with_a_traceback(tmp_path_factory, rows, gap):
    file = tmp_path_factory.mktemp("files") / "log.csv"
    file.write_text("\n".join(gap.join(row) for row in rows))
    with contextlib.suppress(jt.errors.RecordingError):
        assert "jaxtwin import" in overview(file, None, None, ReadingOptions())


def test_glitches_are_named_and_left_out_where_asked(tmp_path, capsys):
    """One reading of 300 is that of a sensor that was pulled out for a moment."""
    rows = [f"{n},0.5,0.0,{20 + 0.1 * n:.2f},{20 + 0.05 * n:.2f}" for n in range(300)]
    rows[200] = "200,0.5,0.0,3.10,30.00"
    file, out = tmp_path / "log.csv", tmp_path / "run.csv"
    file.write_text("time_s,duty_P1,duty_P2,T1_degC,T2_degC\n" + "\n".join(rows) + "\n")
    command = ["import", str(file), "--rig", "tclab", "--out", str(out)]
    named = "T1 at 200 s reads 3.1 degC, -36.9 K from the readings beside it"
    assert run(command) == 0
    assert f"{named}; --mask-glitches leaves it out" in capsys.readouterr().out
    assert len(jt.read_recording(out).glitches) == 1
    assert run([*command, "--mask-glitches", "--overwrite"]) == 0
    assert f"left out: {named}" in capsys.readouterr().out
    sampled = jt.read_recording(out).sampled
    assert np.argwhere(~sampled).tolist() == [[200, 0]]
    assert run(["import", str(file), "--rig", "tclab"]) == 0
    assert named in capsys.readouterr().out
