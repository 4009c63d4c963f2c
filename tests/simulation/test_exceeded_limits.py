"""What a run says about the limits of its rig."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from jaxtwin import Twin
from jaxtwin.cli import app
from jaxtwin.simulation._check_values import exceeded_limits

# Its channel may reach 110 degC; the file states no limit of its cell.
TWIN = Twin("single-cell")


def test_a_run_within_the_limits_says_nothing():
    run = TWIN.simulate("0:0.1", duration=30)
    assert run.beyond_limits == ()
    assert "above" not in repr(run)


def test_a_run_beyond_the_limits_of_channels_and_of_solder_says_both_once():
    run = TWIN.simulate("0:0", duration=30, initial=150.0)
    channel, side = run.beyond_limits
    assert channel.startswith("T reaches ")
    assert channel.endswith("above 110 degC, the limit of channels, from 0 s on")
    assert side.startswith("P1.T")
    assert side.endswith("above 138 degC, at which solder melts, from 0 s on")
    assert repr(run).count("above 110 degC") == 1


def test_a_resistive_heater_has_no_solder():
    run = Twin("printer-bed").simulate("0:0", duration=30, initial=145.0)
    assert [text.split(",")[1].strip() for text in run.beyond_limits] == ["above 120 degC"]


@pytest.mark.slow
def test_the_command_warns_once_and_writes_it_as_json(tmp_path: Path):
    numbers = tmp_path / "run.json"
    arguments = ["simulate", "pcr-block", "--duty", "0:1/1", "--duration", "600"]
    arguments += ["--out", str(tmp_path / "run.nc"), "--json", str(numbers)]
    said = CliRunner().invoke(app, arguments).output
    (text, *_) = json.loads(numbers.read_text())["beyond_limits"]
    assert said.count(f"warning: {text}") == 1


def test_a_limit_that_the_recording_exceeds_itself_is_left_out() -> None:
    run = TWIN.simulate("0:0", duration=30, initial=150.0)
    channel, side = run.beyond_limits
    assert exceeded_limits(run, TWIN.rig, recorded=100.0) == (channel, side)
    assert exceeded_limits(run, TWIN.rig, recorded=111.0) == (side,)
    assert exceeded_limits(run, TWIN.rig, recorded=139.0) == ()
