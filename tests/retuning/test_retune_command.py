"""`jaxtwin retune`: a champion and its controller from a store, a challenger into it."""

import json
from pathlib import Path

import pytest
from tuned_board import DESIGN, fit, pid

from jaxtwin import TwinStore
from jaxtwin.cli import run
from jaxtwin.control import save_controller


@pytest.fixture
def store(tmp_path: Path) -> TwinStore:
    store = TwinStore(tmp_path / "twins.db")
    store.add(fit(), reason="first match", aliases=["champion"])
    return store


def test_who_gives_no_controller_is_asked_for_one(
    store: TwinStore, capsys: pytest.CaptureFixture[str]
):
    assert run(["retune", str(store.path)]) == 2
    assert "controller: expected a champion with a controller of its own" in capsys.readouterr().err


def test_a_file_that_does_not_say_its_design_is_refused(
    store: TwinStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_controller(tmp_path / "pid.toml", pid(), fit().twin.rig)
    assert run(["retune", str(store.path), "--controller", str(tmp_path / "pid.toml")]) == 2
    assert "design: expected references, duration and objective" in capsys.readouterr().err
    assert store.aliases == {"champion": 1}


@pytest.mark.slow
def test_a_champion_is_retuned_with_all_scenarios(
    store: TwinStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / "pid.toml"
    save_controller(file, pid(), fit().twin.rig, design=DESIGN)
    line = ["retune", str(store.path), "--controller", str(file), "--draws", "3", "--json", "-"]
    assert run(line) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["decision"], found["challenger"]) == ("accepted", 2)
    names = [scenario["name"] for scenario in found["scenarios"]]
    assert names[0] == "steps"
    assert {"twice the delay", "sensor lost", "saturated supply", "age H1"} <= set(names)
    assert store.aliases == {"champion": 1, "challenger": 2}
    assert run(["retune", str(store.path), "--draws", "3"]) == 2  # the champion has none yet
    store.promote(reason="the trial was passed")
    assert run(["retune", str(store.path), "--draws", "3"]) == 0
    assert "unchanged" in capsys.readouterr().out
