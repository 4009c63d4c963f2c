"""`jaxtwin sweep`: what it takes, prints and refuses."""

import json

import dask.config
import pytest

from jaxtwin import open_sweep
from jaxtwin.cli import run

DRIVE = ["--duty", "0:0.5", "--duration", "10"]


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_sweep_goes_on_and_says_so(tmp_path, engine, capsys):
    """Two of its chunks are taken away again, as if it had been stopped before them."""
    command = ["sweep", "paper-2024", *DRIVE, "--draws", "20", "--chunk", "5", "--out", "out"]
    command += ["--reductions", "final,plate_range", "--seed", "7", "--set", "startup"]
    assert run(command) == 0
    assert "20 of 20 draws are done" in capsys.readouterr().out
    for chunk in "02":
        (tmp_path / "out" / "done" / chunk).unlink()
    assert run([*command, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["done"], told["new"], told["complete"]) == (20, 10, True)
    assert told["failed"] == int(open_sweep("out").failed.sum())


@pytest.mark.slow
def test_costs_are_kept_where_there_are_recordings(capsys):
    """Real engine; the synthetic recording's first channel is T11 with a cost of its own."""
    command = ["sweep", "paper-2024", "synthetic-A", "--draws", "2", "--out", "out"]
    assert run(command) == 0
    table = open_sweep("out")
    assert table.cost.dims == ("draw", "channel")
    assert (table.cost > 0).all()
    assert list(table.recording) == ["synthetic-A"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give either recordings or --duty"),
        (["synthetic-A", *DRIVE], "give either recordings or --duty"),
        ([*DRIVE, "--dask", "nowhere"], "--dask: nowhere: "),
        ([*DRIVE, "--reductions", "mean"], "reductions: expected some of cost"),
        (["nowhere.csv"], "nowhere.csv"),
    ],
)
def test_mistakes_are_one_line_and_leave_no_folder(tmp_path, engine, capsys, options, message):
    assert run(["sweep", "paper-2024", *options, "--draws", "5", "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_found_leaves_dask_as_it_was(tmp_path, engine):
    """xarray asks Dask for its scheduler whenever it writes a file."""
    options = [*DRIVE, "--draws", "5", "--out", "out", "--dask", "nowhere"]
    assert run(["sweep", "paper-2024", *options]) == 2
    assert dask.config.get("scheduler", None) is None
