"""What a command line says arrives where the work is done, and what it leaves out is the default.

The work itself is replaced: it notes the arguments that it gets and gives a small result.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pytest
import typer
from small_results import analysis, fit, global_analysis

import jaxtwin as jt
from jaxtwin import control, experiment_design, live, matching, observers
from jaxtwin.cli import app, run
from jaxtwin.commands import _control, _drive
from jaxtwin.commands._monitored import MonitorOptions
from jaxtwin.control import PID
from jaxtwin.control import control as run_controller
from jaxtwin.experiment_design import ExperimentDesign, PlannedSchedule
from jaxtwin.sensitivity_analysis import Sobol

Noted = dict[str, Any]


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, str, object], Noted]:
    """Replaces a function by one that gives a result; its arguments stand in the dictionary."""

    def replace(module: Any, name: str, result: object) -> Noted:
        arguments: Noted = {}

        def stands_in(*positional: object, **named: object) -> object:
            arguments.update(named, positional=positional)
            return result

        monkeypatch.setattr(module, name, stands_in)
        return arguments

    return replace


def without(arguments: Noted, *left_out: str) -> Noted:
    """The arguments of the user, without recordings and reports of progress."""
    return {k: v for k, v in arguments.items() if k not in ("positional", "on_progress", *left_out)}


def planned(name: str = "designed", is_allowed: bool = True) -> PlannedSchedule:
    drive = jt.Experiment([0.0, 60.0], [[0.1], [0.2]], channels=("T",))
    return PlannedSchedule(
        name, drive, np.array([[26]]), {"R_E": 0.5}, 0.5, 45.5, 71.25, is_allowed
    )


def a_design() -> ExperimentDesign:
    return ExperimentDesign(
        "single-cell", "A", ("R_E",), ("ohm",), (2.0,), {"R_E": 1.0}, planned(),
        {"PRBS": planned("PRBS", is_allowed=False)}, 60.0, (),
    )  # fmt: skip


# What scripts rely on where they say nothing. Every other option is off, or none.
DEFAULTS = {
    "check": {"duty": "0:0.5", "duration": 600.0},
    "conform": {"baud": 115_200},
    "control": {"duration": 1000.0, "silence": 3.0, "sample_time": 1.0, "baud": 115_200},
    "demo": {"out": Path("report"), "draws": 10_000, "speed": 10.0, "port": 8000},
    "design": {
        "purpose": "match", "duration": 1200.0, "hold": 60.0, "levels": 5, "criterion": "D",
        "margin": 5.0,
        "starts": 1, "seed": 0,
    },
    "drive": {"duration": 1000.0, "silence": 3.0, "sample_time": 1.0, "baud": 115_200},
    "estimate-noise": {"horizon": [60.0, 300.0]},
    "export": {"step": 1.0},
    "fleet": {"speed": 1.0, "host": "127.0.0.1", "port": 8000},
    "health": {"probability": 0.5},
    "match": {"starts": 1, "max_iterations": 200, "seed": 0, "gaps": "hold"},
    "monitor": {"days": 30.0},
    "new-rig": {"supply_voltage": "12 V", "limit": "80 degC"},
    "prove": {"duty": 0.3, "silence": 3.0, "baud": 115_200},
    "observe": {"sample_time": 1.0, "speed": 1.0, "baud": 115_200},
    "record": {"sample_time": 1.0, "silence": 10.0, "baud": 115_200},
    "refit": {"forgetting": 1.0, "changes": 1},
    "report": {"out": Path("report"), "draws": 0},
    "retune": {"draws": 100},
    "schema": {"out": Path("-")},
    "sensitivity": {
        "method": "correlations", "spread": 0.25, "inputs": "normal", "output": ["cost"], "seed": 0,
    },
    "serve": {
        "speed": 1.0, "faults": "", "host": "127.0.0.1", "port": 8000, "silence": 10.0,
        "baud": 115_200,
    },
    "simulate": {"duration": 1000.0},
    "sweep": {
        "duration": 1000.0, "spread": 0.25, "precision": "float64", "chunk": 65_536, "seed": 0,
    },
    "validate": {"warm_up": 60.0},
    "virtual-rig": {
        "host": "127.0.0.1","speed": 1.0, "camera_rate": 9.0, "controller_rate": 10.0, "faults": "",
                    "seed": 0},
    "watch": {"speed": 1.0, "baud": 115_200},
}  # fmt: skip


def test_options_that_are_left_out_have_the_values_that_scripts_rely_on():
    commands = typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]
    found = {
        name: {
            option.name: option.default
            for option in command.params
            if not option.required
            and option.default is not None
            and option.default is not False
            and option.default != []
        }
        for name, command in commands.items()
    }
    assert {name: options for name, options in found.items() if options} == DEFAULTS


def test_every_option_of_a_match_arrives(noted):
    arguments = noted(matching, "match", fit())
    words = (
        "match paper-2024 synthetic-A synthetic-B --out fit.toml --free R_E --free R_pc "
        "--fixed R_pc --shared alpha --per-recording T_amb --group mon --group tue --starts 3 "
        "--seed 7 --max-iterations 11 --gaps split --set published --json -"
    )
    assert run(words.split()) == 0
    twin, experiments = arguments["positional"]
    assert float(twin.values["R_E"]) == 0.01  # the published value
    assert [experiment.name for experiment in experiments] == ["synthetic-A", "synthetic-B"]
    assert without(arguments) == {
        "free": ["R_E", "R_pc"], "fixed": ["R_pc"], "shared": ["alpha"], "per_recording": ["T_amb"],
        "groups": ["mon", "tue"], "starts": 3, "seed": 7, "max_iterations": 11,
        "gaps": "split",
    }  # fmt: skip
    assert jt.Fit.load("fit.toml")["R_E"].value == fit()["R_E"].value


def test_a_match_without_options_takes_what_the_rig_says(noted):
    arguments = noted(matching, "match", fit())
    assert run(["match", "paper-2024", "synthetic-A", "--out", "fit.toml"]) == 0
    assert without(arguments) == {
        "free": None, "fixed": [], "shared": [], "per_recording": [], "groups": None,
        "starts": 1, "seed": 0, "max_iterations": 200, "gaps": "hold",
    }  # fmt: skip


def test_every_option_of_a_sensitivity_analysis_arrives(noted, capsys):
    arguments = noted(jt, "global_sensitivity", global_analysis())
    words = (
        "sensitivity paper-2024 synthetic-A --method sobol --second-order --draws 64 --spread 0.1 "
        "--seed 7 --inputs priors --output final --output energy --out sens.nc --json sens.json"
    )
    assert run(words.split()) == 0
    assert without(arguments) == {
        "method": Sobol(second_order=True), "draws": 64, "spread": 0.1, "seed": 7,
        "inputs": "priors", "outputs": ("final", "energy"),
    }  # fmt: skip
    assert Path("sens.nc").exists()
    assert json.loads(Path("sens.json").read_text()) == global_analysis().to_dict()
    shown = capsys.readouterr().out
    label = global_analysis().labels[global_analysis().row()]
    frame = global_analysis().to_dataframe().loc[label]
    assert f"parameter, for {label}" in shown
    for number in frame.loc["R_pc"]:
        assert f"{number:.4g}" in shown


def test_correlations_are_the_ones_of_the_mean_cost(noted, capsys):
    arguments = noted(jt, "sensitivity", analysis())
    assert run(["sensitivity", "paper-2024", "synthetic-A", "--out", "sens.nc"]) == 0
    assert without(arguments) == {"spread": 0.25, "seed": 0}
    shown = capsys.readouterr().out
    for name, row in analysis().to_dataframe().loc["mean"].iterrows():
        (line,) = (line for line in shown.splitlines() if line.startswith(f"{name} "))
        assert f"{row.correlation:.4g}" in line
        assert f"{row.rank_correlation:.4g}" in line


class _Stored:
    """Stands for a sweep."""

    def to_dict(self) -> dict[str, int]:
        return {"done": 50}


def test_every_option_of_a_sweep_arrives(noted, monkeypatch):
    arguments = noted(jt, "sweep", _Stored())
    monkeypatch.setattr("jaxtwin.commands._sweep._summary", lambda result: "half done")
    words = (
        "sweep paper-2024 --duty 0:0.5,10:0.2 --duration 30 --out folder --draws 100 --spread 0.1 "
        "--seed 7 --reductions final,energy --precision float32 --chunk 50 --json -"
    )
    assert run(words.split()) == 0
    twins, (experiment,), folder = arguments["positional"]
    assert len(twins) == 1
    assert (experiment.duration, experiment.duty.shape[1]) == (30.0, 2)
    assert str(folder) == "folder"
    assert without(arguments) == {
        "draws": 100, "spread": 0.1, "seed": 7, "reductions": ["final", "energy"],
        "precision": "float32", "chunk_size": 50, "executor": None,
    }  # fmt: skip


def test_every_option_of_a_design_arrives_and_its_table_is_shown(noted, capsys):
    arguments = noted(experiment_design, "design_experiment", a_design())
    words = (
        "design single-cell --out plan.csv --duration 240 --hold 40 --bounds=-0.5:0.25 --levels 3 "
        "--criterion A --interest R_E --interest alpha --group mon --margin 2 --starts 4 --seed 7 "
        "--plot plan.png --json plan.json"
    )
    assert run(words.split()) == 0
    assert without(arguments) == {
        "duration": 240.0, "hold": 40.0, "bounds": (-0.5, 0.25), "levels": 3, "criterion": "A",
        "names": ["R_E", "alpha"], "group": "mon", "margin": 2.0, "starts": 4, "seed": 7,
    }  # fmt: skip
    shown = capsys.readouterr().out
    for text in (
        "PRBS 50 % (too hot)", "highest reading 45.5 degC",
        "cell side 71.2 degC", "0:0.1,60:0.2",
    ):  # fmt: skip
        assert text in shown
    assert jt.read_recording("plan.csv") == planned().experiment
    assert json.loads(Path("plan.json").read_text()) == a_design().to_dict()
    assert Path("plan.png").read_bytes().startswith(b"\x89PNG")


LIVE = (
    "--link socket://a:1 --link socket://b:2 --out run.db --silence 4 --ambient 21.5 --reset "
    "--operator me --set published --baud 9600"
)
ARRIVED = {
    "rig": "paper-2024", "link": ["socket://a:1", "socket://b:2"], "out": Path("run.db"),
    "reset": True, "alarm": None, "operator": "me",
    "parameter_file": None,
    "set_name": "published", "baud": 9600,
}  # fmt: skip


@pytest.mark.slow
def test_every_option_of_a_drive_arrives(noted):
    arguments = noted(_drive, "run_on_live_rig", None)
    words = f"drive paper-2024 --duty 0:0.5,10:0.2/0.1 --duration 30 {LIVE}"
    beside = "--monitor --noise noise.toml --calibration healthy.toml --sample-time 2"
    assert run(f"{words} {beside}".split()) == 0
    monitor = MonitorOptions(Path("noise.toml"), Path("healthy.toml"), 2.0)
    expected = {"doing": "driving", "duration": 30.0, "monitor": monitor}
    assert without(arguments) == ARRIVED | expected
    twin = jt.Twin("paper-2024")
    (prepare,) = arguments["positional"]
    command, about = prepare(twin, None, [live.AlarmInterlock()])
    assert command.func is live.drive
    guard = command.keywords["guard"].settings
    assert (guard["silence_s"], guard["ambient_degC"]) == (4.0, 21.5)
    assert guard["stop_on_alarm"]
    plan = command.keywords["plan"]
    assert plan.duration == 30.0
    np.testing.assert_array_equal(plan.duty[[0, 10]], [[0.5, 0.5], [0.2, 0.1]])
    assert about == {"plan": {"duty": "0:0.5,10:0.2/0.1", "duration_s": 30.0}}


@pytest.mark.slow
def test_a_plan_is_driven_for_its_own_duration(noted):
    arguments = noted(_drive, "run_on_live_rig", None)
    a_design().save("plan.csv")
    assert run(f"drive single-cell --plan plan.csv {LIVE}".split()) == 0
    assert arguments["duration"] == 60.0
    (prepare,) = arguments["positional"]
    command, about = prepare(jt.Twin("single-cell"), None, [])
    assert command.keywords["plan"] == planned().experiment
    assert about == {"plan": {"file": "plan.csv", "duration_s": 60.0}}


@pytest.mark.slow
def test_every_option_of_a_control_arrives(noted, monkeypatch):
    """The controller is read for the rig, and the whole file is kept with the recording."""
    arguments = noted(_control, "run_on_live_rig", None)
    twin = jt.Twin("dual-cell")
    control.save_controller("pid.toml", PID(Kp=0.02, Ki=0.0002), twin.rig)
    words = f"control paper-2024 --controller pid.toml --reference 0:35,20:40 --duration 30 {LIVE}"
    assert run(words.split()) == 0
    expected = {"doing": "controlling", "duration": 30.0, "monitor": None}
    assert without(arguments) == ARRIVED | expected
    (prepare,) = arguments["positional"]
    checked: list[tuple[object, ...]] = []
    really_checked = resolve_name("jaxtwin.control.loops._control.checked_loop")

    def check(*given: Any) -> Any:
        checked.append(given)
        return really_checked(*given)

    monkeypatch.setattr("jaxtwin.control.loops._control.checked_loop", check)
    command, about = prepare(twin, None, [])
    assert command.func is run_controller
    guard = command.keywords["guard"].settings
    assert (guard["silence_s"], guard["ambient_degC"]) == (4.0, 21.5)
    assert command.keywords["loop"].plan == {"references": "0:35,20:40", "duration_s": 30.0}
    ((of, pid, *given),) = checked  # once
    assert of is twin
    assert getattr(pid, "Kp", None) == 0.02
    assert given == ["0:35,20:40", 30.0, 21.5]
    assert about == {
        "plan": {"reference": "0:35,20:40", "duration_s": 30.0},
        "controller": Path("pid.toml").read_text(encoding="utf-8"),
    }


def test_every_option_of_an_estimate_of_noise_arrives(noted, monkeypatch, capsys):
    found = jt.ProcessNoise(heat=0.5, standard_errors={"heat": 0.1})
    arguments = noted(observers, "estimate_noise", found)
    monkeypatch.setattr(matching.Fit, "load", lambda path: fit())
    words = "estimate-noise fit.toml synthetic-A --name R_E --name alpha --horizon 30 --out n.toml"
    assert run(words.split()) == 0
    assert without(arguments) == {"names": ["R_E", "alpha"], "horizons": [30.0]}
    assert jt.ProcessNoise.load("n.toml").standard_errors == {"heat": 0.1}
    assert re.search(r"\nheat +0\.5 +W s\^0\.5 +10 +found\n", capsys.readouterr().out)
