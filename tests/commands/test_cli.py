"""The command line: what it prints, what it writes, and how it refuses."""

import importlib
import inspect
import io
import json
import math
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import typer
import xarray
from small_results import fit, recordings

from jaxtwin import (
    Experiment,
    Fit,
    JaxtwinError,
    Twin,
    bundled_rigs,
    global_sensitivity,
    load_rig,
    match,
    read_parameters,
    read_recording,
    sensitivity,
    sweep,
    validate,
    write_recording,
)
from jaxtwin.cli import app, run
from jaxtwin.commands._output import say
from jaxtwin.commands._sources import find_recording, open_twin, open_twins
from jaxtwin.data import synthetic_recordings, synthetic_truth
from jaxtwin.matching import FittedParameters
from jaxtwin.report import write_demo

COMMANDS = [
    [],
    ["demo"],
    ["rigs"],
    ["check"],
    ["new-rig"],
    ["schema"],
    ["netlist"],
    ["dc-sweep"],
    ["import"],
    ["simulate"],
    ["match"],
    ["identify"],
    ["validate"],
    ["estimate-noise"],
    ["diff"],
    ["report"],
    ["sensitivity"],
    ["sweep"],
    ["virtual-rig"],
    ["record"],
    ["drive"],
    ["design"],
    ["control"],
    ["prove"],
    ["watch"],
    ["observe"],
    ["serve"],
    ["fleet"],
    ["monitor"],
    ["diagnose"],
    ["refit"],
    ["retune"],
    ["health"],
    ["twins"],
    ["twins", "list"],
    ["twins", "show"],
    ["twins", "diff"],
    ["twins", "add"],
    ["twins", "promote"],
    ["twins", "rollback"],
    ["conform"],
    ["backup"],
    ["export"],
    ["data"],
    ["data", "list"],
    ["data", "fetch"],
    ["doctor"],
    ["warm-up"],
]


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    """Each test in a folder of its own."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def minute(tmp_path) -> str:
    """A minute of a synthetic recording as a file."""
    return write_recording(recordings()[0], tmp_path / "minute.csv").name


def written() -> list[str]:
    return sorted(path.name for path in Path.cwd().iterdir())


def printed(capsys) -> str:
    return capsys.readouterr().out


def fresh(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "jaxtwin.cli", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env=os.environ | environment, check=False
    )


def test_the_page_of_commands_has_every_command():
    text = (Path(__file__).parents[2] / "docs/commands.md").read_text(encoding="utf-8")
    rows = re.search(r"These are all commands:\n\n(.*?)\n\n", text, re.DOTALL)
    assert rows is not None
    listed = re.findall(r"`([\w -]+)`", " ".join(row.split("|")[1] for row in rows[1].split("\n")))
    groups = {command[0] for command in COMMANDS if len(command) > 1}
    known = [" ".join(each) for each in COMMANDS if each not in ([], *([one] for one in groups))]
    assert groups == {"data", "twins"}
    assert sorted(listed) == sorted(known)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example(command, capsys):
    assert run([*command, "--help"]) == 0
    text = printed(capsys)
    if command not in ([], ["data"], ["twins"]):
        assert "Example:" in text
        assert f"jaxtwin {' '.join(command)}" in text


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_line_of_help_ends_where_the_next_word_does_not_fit(command, capsys, monkeypatch):
    """Otherwise the line breaks of the code would be in the help, beside those of the terminal."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run([*command, "--help"]) == 0
    prose = printed(capsys).partition("╭")[0].splitlines()
    for line, following in pairwise(prose):
        if line.strip() and following.strip():
            assert len(line.rstrip()) + 1 + len(following.split()[0]) > 79


def test_help_comes_without_loading_jax_or_another_heavy_library():
    """Quick: nothing that takes long to import is imported."""
    code = (
        "import sys\nfrom jaxtwin.cli import run\nrun(['--help'])\n"
        "print({'jax', 'numpy', 'matplotlib', 'pydantic', 'pint', 'xarray'} & set(sys.modules))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.endswith("set()\n")


@pytest.mark.parametrize("arguments", [[], ["data"], ["twins"]], ids=["jaxtwin", "data", "twins"])
def test_without_a_command_the_help_is_shown(arguments, capsys):
    assert run(arguments) == 0
    assert "Usage:" in printed(capsys)


def test_version(capsys):
    assert run(["--version"]) == 0
    assert re.fullmatch(r"jaxtwin \d+\.\d+\.\d+\n", printed(capsys))


GROUP = ["--group", "day"]
WRONG = {
    "split and leave one out": (
        ["validate", "paper-2024", "synthetic-A", "--split", "500", "--leave-one-out"],
        "give one of --split, --leave-one-out and --leave-group-out",
    ),
    "nothing to validate": (["validate", "paper-2024", "synthetic-A"], "give --parameters"),
    "given and split": (
        ["validate", "paper-2024", "synthetic-A", "--split", "500", "--given", "120"],
        "give --group and --given with --parameters, not with --split",
    ),
    "two groups of one prediction": (
        [
            "validate",
            "paper-2024",
            "synthetic-A",
            "--set",
            "published",
            "--group",
            "a",
            "--group",
            "b",
        ],
        "--group: expected one name, got 2; only --leave-group-out takes one for each recording",
    ),
    "one group to leave out": (
        [
            "validate",
            "paper-2024",
            "synthetic-A",
            "synthetic-B",
            "--leave-group-out",
            "--group",
            "day",
            "--group",
            "day",
        ],
        "leave_one_out: by: expected recordings of two groups or more, got one group 'day'",
    ),
    "fewer groups than recordings": (
        ["match", "paper-2024", "synthetic-A", "synthetic-B", "--group", "day", "--out", "f.toml"],
        "groups: expected a name for each recording, such as its day, got ['day'] for synthetic-A",
    ),
    "split outside": (
        ["validate", "paper-2024", "synthetic-A", "--split", "2000"],
        "in every channel before and after it, got 1001 and 0",
    ),
    "no time to warm up": (
        ["validate", "paper-2024", "synthetic-A", "--set", "published", "--warm-up", "nan"],
        "--warm-up: expected a finite number, got nan",
    ),
    "another rig's recording": (
        ["validate", "single-cell", "synthetic-A", "--split", "500"],
        "columns: expected drives of P1, got P1, P2",
    ),
    "unknown command": (["simulat"], "No such command 'simulat'"),
    "unknown option": (["rigs", "--jsn", "x"], "No such option: --jsn"),
    "missing argument": (["match", "paper-2024"], "Missing argument 'RECORDING'"),
    "no rig": (["check", "paper-2042"], "unknown bundled rig 'paper-2042'"),
    "no module": (["dc-sweep", "TEC9"], "TEC9"),
    "no drive": (["simulate", "paper-2024", "--out", "r.nc"], "either --recording or --duty"),
    "wrong ending": (
        ["simulate", "paper-2024", "--duty", "0:1", "--out", "r.txt"],
        "ends with .nc or .csv, got '.txt'",
    ),
    "no folder": (
        ["simulate", "paper-2024", "--duty", "0:1", "--out", "none/r.nc"],
        "there is no folder",
    ),
    "a folder": (["netlist", "paper-2024", "--spice", "."], "expected a file, got a folder"),
    "duty out of range": (
        ["simulate", "paper-2024", "--duty", "0:1.5", "--out", "r.nc"],
        "expected duty cycles from -1 to 1",
    ),
    "no parameter set": (
        ["simulate", "paper-2024", "--duty", "0:1", "--set", "final", "--out", "r.nc"],
        "expected one of startup, initial, published, got 'final'",
    ),
    "no parameter file": (
        ["simulate", "paper-2024", "--duty", "0:1", "--parameters", "f.toml", "--out", "r.nc"],
        "f.toml",
    ),
    "no recording": (
        ["match", "paper-2024", "zone-D", "--out", "fit.toml"],
        "zone-D: expected a file or a known recording, got neither",
    ),
    "recording of another rig": (
        ["match", "paper-2024", "other.csv", "--out", "fit.toml"],
        "columns: expected drives of P1, P2, got P1",
    ),
    "parameter unknown": (
        ["match", "paper-2024", "synthetic-A", "--fixed", "R_x", "--out", "fit.toml"],
        "got R_x",
    ),
    "nothing free": (
        ["match", "paper-2024", "synthetic-A", "--out", "fit.toml"]
        + [
            word
            for name, row in load_rig("paper-2024").parameters.items()
            if row.free
            for word in ("--fixed", name)
        ],
        "no free parameter",
    ),
    "too few draws": (
        ["sensitivity", "paper-2024", "synthetic-A", "--draws", "2", "--out", "s.nc"],
        "--draws",
    ),
    "folder of something else": (["demo", "--out", "."], "an older report of jaxtwin"),
    "recordings not there": (
        ["demo", "--out", "report", "--recordings", "none"],
        "no such folder",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_written(case, capsys):
    write_recording(
        Experiment([0.0, 1.0], [0.5, 0.5], channels=["T"], temperatures=[20.0, 21.0]),
        Path("other.csv"),
    )
    arguments, message = WRONG[case]
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"jaxtwin: .+\n", err)
    assert message in err
    assert written() == ["other.csv"]


def test_rigs_are_listed(capsys):
    assert run(["rigs", "--json", "-"]) == 0
    assert set(json.loads(printed(capsys))) == set(bundled_rigs())


def test_check_counts_the_network_as_the_model_file_has_it(capsys):
    """circuit.md, section 3: 24 elements, 83 resistances, 681.7 J/K, 4.604 W/K."""
    assert run(["check", "paper-2024", "--json", "-"]) == 0
    network = json.loads(printed(capsys))["network"]
    assert network["plate_resistances"] == 83
    assert network["states"] == 28
    assert network["plate_capacitance_J_per_K"] == pytest.approx(681.7, abs=0.05)
    assert network["plate_to_ambient_W_per_K"] == pytest.approx(4.604, abs=5e-4)


def test_check_names_the_mistake_in_a_rig_file(capsys):
    Path("my.toml").write_text('format = 1\nname = "x"\n')
    assert run(["check", "my.toml"]) == 2
    assert "my.toml: " in capsys.readouterr().err


@pytest.mark.slow
def test_netlist_is_drawn_and_exported(capsys):
    assert run(["netlist", "paper-2024", "--out", "n.png", "--spice", "n.cir"]) == 0
    assert printed(capsys).endswith("written to n.png, n.cir\n")
    assert Path("n.png").read_bytes().startswith(b"\x89PNG")
    assert ".end" in Path("n.cir").read_text().lower()


def test_dc_sweep_gives_the_datasheets_constants(capsys):
    """Eq. (10) of the paper at 323 K: 0.0508 V/K, 1.967 ohm, 1.861 K/W."""
    assert run(["dc-sweep", "TEC1-12706", "--out", "sweep", "--json", "s.json"]) == 0
    said = printed(capsys)
    assert "0.0508 V/K, 1.967 ohm, 1.861 K/W" in said
    assert said.endswith("written to sweep\n")
    points = json.loads(Path("s.json").read_text())["best_points"]
    assert points[0]["current_A"] == pytest.approx(0.050774 * 323 / 1.96749, rel=1e-4)
    assert sorted(path.name for path in Path("sweep").iterdir()) == [
        "TEC1-12706.nc",
        "TEC1-12706.png",
    ]


def test_simulate_writes_a_run_with_labels(capsys):
    arguments = ["--duty", "0:0.5,30:0.78", "--duration", "60", "--out", "run.nc"]
    assert run(["simulate", "paper-2024", *arguments, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["rig"] == "paper-2024"
    assert err.endswith("written to run.nc\n")
    with xarray.open_dataset("run.nc") as stored:
        assert stored["temperature"].sizes == {"time": 61, "channel": 15}
        assert stored["duty"].values[[29, 30], 0].tolist() == [0.5, 0.78]


@pytest.mark.slow
def test_simulate_compares_with_a_recording_under_its_own_ambient(capsys):
    """The synthetic recording's truth leaves its noise, 0.1 K."""
    truth = ["--parameters", str(synthetic_truth())]
    arguments = ["--recording", "synthetic-B", *truth, "--out", "run.csv", "--json", "-"]
    assert run(["simulate", "paper-2024", *arguments]) == 0
    numbers = json.loads(printed(capsys))
    assert numbers["rmse_K"] == pytest.approx(0.1, abs=0.003)
    stored, recorded = read_recording("run.csv"), read_recording(synthetic_recordings()[1])
    np.testing.assert_array_equal(stored.duty, recorded.duty)
    assert stored.temperatures is not None
    assert recorded.temperatures is not None
    assert np.std(stored.temperatures - recorded.temperatures) == pytest.approx(0.1, abs=0.003)


@pytest.mark.slow
def test_global_sensitivity_by_a_command(minute, capsys):
    few = ["--draws", "8", "--out", "s.nc", "--output", "final", "--output", "cost"]
    chosen = ["--method", "sobol", "--second-order", "--inputs", "lognormal", "--json", "s.json"]
    assert run(["sensitivity", "paper-2024", minute, *chosen, *few]) == 0
    shown = printed(capsys)
    assert "272 runs" in shown
    assert "\nparameter, for cost mean  S1" in shown
    numbers = json.loads(Path("s.json").read_text())
    assert len(numbers["indices"]["S2"]["final T11"]) == len(numbers["parameters"]) == 16
    with xarray.open_dataset("s.nc") as stored:
        assert dict(stored.sizes)["run"] == numbers["runs"] == 272
        assert stored.attrs["method"] == "sobol"


def test_second_order_is_sobols(minute, capsys):
    wrong = ["sensitivity", "paper-2024", minute, "--second-order", "--out", "s.nc"]
    assert run(wrong) == 2
    assert "--method sobol" in capsys.readouterr().err
    assert not Path("s.nc").exists()


@pytest.mark.slow
def test_match_saves_what_the_other_commands_take(minute, capsys):
    held = [name for name, row in load_rig("paper-2024").parameters.items() if row.free]
    held.remove("R_pc")
    fixed = [word for name in held for word in ("--fixed", name)]
    more = ["--per-recording", "T_amb", "--set", "published", "--max-iterations", "4"]
    files = ["--out", "fit.toml", "--json", "fit.json"]
    assert run(["match", "paper-2024", minute, *fixed, *more, *files]) == 0
    assert "parameter  initial" in printed(capsys)
    saved = tomllib.loads(Path("fit.toml").read_text())
    numbers = json.loads(Path("fit.json").read_text())
    free = [row["name"] for row in numbers["parameters"] if row["free"]]
    assert free == ["R_pc", "T_amb"]
    assert saved["recordings"]["minute"] == numbers["recordings"]["minute"]

    arguments = ["--parameters", "fit.toml", "--json", "-"]
    assert run(["simulate", "paper-2024", "--recording", minute, "--out", "r.nc", *arguments]) == 0
    simulated = json.loads(printed(capsys))
    assert simulated["rmse_K"] == pytest.approx(numbers["rmse_K"], rel=1e-6)
    assert simulated["own_values"] == numbers["recordings"]["minute"]

    few = ["--draws", "8", "--seed", "3", "--out", "s.nc"]
    assert run(["sensitivity", "paper-2024", minute, *few, *arguments]) == 0
    assert len(json.loads(printed(capsys))["ranking"]) == 16
    with xarray.open_dataset("s.nc") as stored:
        assert stored.sizes["draw"] == 8


def test_a_mistyped_parameter_set_is_answered_with_the_nearest():
    with pytest.raises(JaxtwinError, match="did you mean 'published'"):
        open_twin(load_rig("paper-2024"), "publishd", None)


def test_recordings_get_the_values_that_a_parameter_file_has_under_their_names():
    """The synthetic truth names its three recordings; another one gets the shared value."""
    rig, recording = load_rig("paper-2024"), read_recording(synthetic_recordings()[1])
    unseen = replace(recording, name="unseen")
    twins = open_twins(rig, None, synthetic_truth(), [recording, unseen])
    assert not isinstance(twins, Fit)
    known, shared = (float(twin.values["T_amb"]) for twin in twins)
    assert known == read_parameters(synthetic_truth(), rig, "synthetic-B")["T_amb"]
    assert shared == read_parameters(synthetic_truth(), rig)["T_amb"]
    assert abs(shared - known) > 0.5


@pytest.mark.slow
def test_simulate_says_whose_values_a_fit_gave_it(minute, tmp_path, capsys):
    """Of a matched recording, whatever its name, its own; of a drive the means of them all."""
    fit().save(tmp_path / "fit.toml")
    rooms = [values["T_amb"] for values in fit().recording_values.values()]
    command = ["simulate", "paper-2024", "--parameters", "fit.toml", "--out", "r.nc"]
    assert run([*command, "--recording", minute, "--json", "r.json"]) == 0
    said = printed(capsys)
    assert f"T_amb = {rooms[0]:.4g}: as matched for synthetic-A" in said
    assert re.search(r"^mean fit \d+\.\d %, RMSE \d\.\d+ K$", said, re.MULTILINE)
    assert json.loads(Path("r.json").read_text())["own_values"] == {"T_amb": rooms[0]}
    assert run([*command, "--duty", "0:0.5", "--duration", "10"]) == 0
    said = f"T_amb = {np.mean(rooms):.4g}: means of synthetic-A, synthetic-B"
    assert said in printed(capsys)


@pytest.mark.slow
def test_validate_predicts_after_the_warm_up_and_draws_the_residuals(minute, capsys):
    """What it prints and writes are the numbers of `jaxtwin.validate`."""
    arguments = ["validate", "paper-2024", minute, "--set", "published", "--warm-up", "20"]
    assert run([*arguments, "--out", "pictures", "--json", "numbers.json"]) == 0
    rig = load_rig("paper-2024")
    twin = Twin(rig, rig.parameter_sets["published"])
    expected = validate(twin, read_recording(minute), warm_up=20.0)
    assert json.loads(Path("numbers.json").read_text()) == expected.to_dict()
    assert f"RMSE {expected.rmse:.3f} K" in printed(capsys)
    assert sorted(p.name for p in Path("pictures").iterdir()) == ["residuals.png", "response.png"]


@pytest.mark.slow
def test_validate_takes_rooms_from_a_saved_fit(minute, tmp_path, capsys):
    """The whole fit, not its values alone: the room is expected where its recordings had it."""
    fit().save(tmp_path / "fit.toml")
    arguments = ["validate", "paper-2024", minute, "--parameters", "fit.toml", "--warm-up", "20"]
    assert run([*arguments, "--json", "numbers.json"]) == 0
    expected = validate(fit(), read_recording(minute), warm_up=20.0)
    assert json.loads(Path("numbers.json").read_text()) == expected.to_dict()


@pytest.mark.slow
def test_diff_counts_in_standard_errors(tmp_path, capsys):
    """A fit beside itself, and beside one whose room is two standard errors further."""
    room = fit()["T_amb"]
    moved = replace(room, value=room.value + 2 * math.sqrt(2) * room.standard_error)
    rows = FittedParameters({**fit().parameters, "T_amb": moved})
    fit().save(tmp_path / "old.toml")
    replace(fit(), parameters=rows).save(tmp_path / "new.toml")
    assert run(["diff", "old.toml", "old.toml"]) == 0
    assert printed(capsys) == "no difference\n"
    assert run(["diff", "old.toml", "new.toml", "--json", "diff.json"]) == 0
    head, line = printed(capsys).splitlines()
    assert head.split()[:3] == ["parameter", "old", "new"]
    assert line.split()[0] == "T_amb"
    assert line.split()[-1] == "+2.00"
    numbers = json.loads(Path("diff.json").read_text())["parameters"]
    assert numbers["T_amb"]["standard_errors"] == pytest.approx(2.0)
    assert numbers["R_pc"]["standard_errors"] == 0.0


def test_known_recordings_are_found_by_name(tmp_path, monkeypatch):
    (tmp_path / "peltierMIMOStepSecB.mat").touch()
    monkeypatch.setenv("JAXTWIN_RECORDINGS", str(tmp_path))
    assert find_recording("peltierMIMOStepSecB") == tmp_path / "peltierMIMOStepSecB.mat"
    assert find_recording("synthetic-C") == synthetic_recordings()[2]


def test_data_list_says_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAXTWIN_RECORDINGS", str(tmp_path))
    assert run(["data", "list", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["peltierMIMOStepSecA"]["path"] is None
    assert "jaxtwin data fetch" in err


def test_a_reader_that_goes_away_gets_no_traceback():
    code = "import sys; from jaxtwin.cli import run; sys.exit(run(['rigs']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirected", "code", "said"),
    [
        ("| true", 0, ""),
        (">&-", 0, ""),
        ("2>&-", 0, ""),
        ("> /dev/full", 2, "jaxtwin: standard output: No space left on device\n"),
    ],
)
def test_streams_that_are_gone_or_full_give_no_traceback(redirected: str, code: int, said: str):
    """Also as a module, `python -m jaxtwin`, where the script is not on the path."""
    done = subprocess.run(
        f"set -o pipefail; {sys.executable} -m jaxtwin rigs {redirected}",
        shell=True,
        executable="/bin/bash",
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (code, said)


@pytest.mark.parametrize("platform", ["cuda", "banana"])
def test_a_platform_that_jax_does_not_have_is_said_in_one_line(platform):
    """Of CUDA without a graphics card JAX itself only asserts that it has found something."""
    done = subprocess.run(
        [sys.executable, "-m", "jaxtwin", "doctor"],
        env=os.environ | {"JAX_PLATFORMS": platform},
        capture_output=True,
        text=True,
        check=False,
    )
    (line,) = [one for one in done.stderr.splitlines() if one.startswith("jaxtwin: ")]
    assert line.startswith(f"jaxtwin: JAX_PLATFORMS={platform}: expected platforms that are there")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_a_pipe_that_cannot_hold_a_name_gets_it_in_ascii(tmp_path):
    """A log or a pipe on Windows is in cp1252, without a Chinese file name."""
    recording = tmp_path / "数.csv"
    recording.write_text("time_s,duty_P1\n0,0.5\n1,0.5\n", encoding="utf-8")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "jaxtwin", "import", str(recording), "--rig", "single-cell"),
            *("--out", str(tmp_path / "数.nc"), "--json", "-"),
        ],
        env=os.environ | {"PYTHONIOENCODING": "cp1252"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"\\u6570.nc" in done.stderr
    assert json.loads(done.stdout)["samples"] == 2


def test_a_tilde_behind_an_equals_sign_is_the_home_folder(tmp_path, monkeypatch):
    """Shells leave it alone there, and a folder called ~ is nobody's wish."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    assert run(["dc-sweep", "TEC1-12706", "--out=~/sweep"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"home"}
    assert (tmp_path / "home" / "sweep" / "TEC1-12706.nc").exists()


@pytest.mark.parametrize(
    ("command", "function", "expected"),
    [
        ("demo", write_demo, {"draws": 10_000}),
        ("match", match, {"starts": 1, "seed": 0, "max_iterations": 200}),
        ("sensitivity", sensitivity, {"spread": 0.25, "seed": 0}),
        ("sensitivity", global_sensitivity, {"spread": 0.25, "seed": 0, "inputs": "normal"}),
        ("sweep", sweep, {"spread": 0.25, "seed": 0}),
    ],
)
def test_what_is_not_said_means_the_same_as_in_python(command, function, expected):
    """The paper's plus or minus a quarter among it."""
    module = importlib.import_module(f"jaxtwin.commands._{command}")
    for each in (getattr(module, command), function):
        parameters = inspect.signature(each).parameters
        assert {name: parameters[name].default for name in expected} == expected


def test_every_command_is_tested_for_help():
    names = {command.name for command in app.registered_commands}
    assert names | {"data", "twins"} == {command[0] for command in COMMANDS if command}


@pytest.mark.slow
def test_compiled_programs_are_kept_unless_one_says_no(tmp_path):
    """docs/performance.md: JAXTWIN_COMPILATION_CACHE rules it."""
    arguments = ["simulate", "paper-2024", "--duty", "0:0.5", "--duration", "10", "--out", "r.nc"]
    folder = tmp_path / "compiled"
    for setting, kept in (("off", False), (str(folder), True)):
        result = fresh(*arguments, JAXTWIN_COMPILATION_CACHE=setting)
        assert result.returncode == 0, result.stderr
        assert folder.exists() == kept
    assert any(folder.iterdir())


def test_what_takes_long_or_much_room_is_left_out_unless_asked_for():
    commands = typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]
    defaults = {
        name: {option.name: option.default for option in command.params}
        for name, command in commands.items()
    }
    assert defaults["report"]["draws"] == 0
    for option in ("append", "frames", "daily"):
        assert defaults["record"][option] is False


def test_a_line_is_seen_at_once_by_a_program_that_reads_it(monkeypatch):
    """A pipe keeps what is not flushed until it is full."""
    lines = io.StringIO()
    flushed = []
    monkeypatch.setattr(lines, "flush", lambda: flushed.append(lines.getvalue()))
    monkeypatch.setattr("sys.stdout", lines)
    say("recording")
    assert flushed == ["recording\n"]


def test_a_command_ends_without_a_search_for_reference_cycles():
    """The search through all that JAX has made would take up to a second after the last line."""
    code = (
        "import atexit, gc, sys\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 0))\n"  # the first comes last
        "sys.argv = ['jaxtwin', 'rigs']\n"
        "from jaxtwin.cli import main\nmain()"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.endswith("True\n")
