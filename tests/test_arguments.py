"""Arguments that are something else than the signature says give one clear sentence.

The package is imported without the checks of shapes and types that all other tests have: whoever
calls it at a prompt has none.
"""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from jaxtwin import JaxtwinError
from jaxtwin._arguments import names_of, path_of, true_or_false, whole_number

SETTING = """
import json, sys
import diffrax
import numpy as np
import optimistix
from jaxtwin import *
from jaxtwin import control, live, matching, observers, plots, rig as rigs
from jaxtwin.data import synthetic_recordings
from jaxtwin.physics import *
rig = load_rig("paper-2024")
twin = Twin(rig)
drive = Experiment.schedule("0:0.5", duration=50, cells=2)
seen = read_recording(synthetic_recordings()[0]).between(0, 60)
draws = {"R_ph": [0.5, 0.6]}
pid, draught = control.PID(0.1), control.Draught("V11", 0, 1, 1)
found = {}
for text in json.load(sys.stdin):
    try:
        found[text] = ["nothing", repr(eval(text))]
    except Exception as problem:
        found[text] = [type(problem).__name__, str(problem)]
json.dump(found, sys.stdout)
"""

TWIN = "twin: expected a Twin, as Twin\\(rig\\) makes it.*, got .*"
EXPERIMENT = "expected an Experiment, as read_recording.*, got .*"
LEAST_SQUARES = "expected an optimistix least-squares solver, such as optimistix.Levenberg"
FIT = "fit: expected a Fit, as match gives it.*, got .*"
RIG = "rig: expected a Rig, as load_rig reads it.*, got .*"
PATH = "expected (the path of a file or a folder|a path whose names are not too long).*, got .*"
WHOLE = "expected a whole number "
LOSS = "loss: expected a loss, such as jaxtwin.matching.Huber"
FINITE = "expected a finite number"
NAMES = "expected one name or several.*, got .*"
FUNCTION = "expected a function or None.*, got .*"

CASES = {
    "control.PID(0.1, anti_windup='none')": (
        "ControlError",
        "PID: anti_windup: expected 'back-calculation' or 'clamping', got 'none'",
    ),
    "observers.MovingHorizonEstimator(observers.live_observer(twin), bounds={'room': (1, 2)})": (
        "ObserverError",
        "MovingHorizonEstimator: bounds: expected a StateBounds, got {'room'",
    ),
    "control.GainScheduled([pid, pid], at=[30, 40], by='room')": (
        "ControlError",
        "GainScheduled: by: expected 'measurement' or 'reference', got 'room'",
    ),
    "plots.style('light').__enter__()": (
        "ParameterError",
        "style: expected paper, grey or dark, got 'light'",
    ),
    "control.scenario(twin, pid, 30, duration=20, faults=5)": (
        "ControlError",
        "faults: expected text such as 'drop=0.01,jumps=164', or Faults, got 5",
    ),
    "control.scenario(twin, pid, 30, duration=20, disturbances=draught)": (
        "ControlError",
        "disturbances: expected a list of Draught and HeatInput, got Draught",
    ),
    "control.scenario(twin, pid, 30, duration=20, noise='no')": (
        "ControlError",
        "scenario: noise: expected True or False, got 'no'",
    ),
    "control.scenario(twin, pid, 30, duration=20, quantised=1)": (
        "ControlError",
        "scenario: quantised: expected True or False, got 1",
    ),
    "diagnose(twin, 3)": (
        "ObserverError",
        "diagnose: experiment: expected an Experiment, as .*, got 3",
    ),
    "diagnose(twin, seen, noise=0.1)": (
        "ObserverError",
        "diagnose: noise: expected a ProcessNoise, as jaxtwin.estimate_noise finds it, got 0.1",
    ),
    "isolability(twin, faults=[5])": (
        "ObserverError",
        "faults: expected names, suspects, or functions System -> System by their names, got 5",
    ),
    "live.operate(None, twin, None, reset='no')": (
        "JaxtwinError",
        "operate: reset: expected True or False, got 'no'",
    ),
    "live.Recorder('session.db', rig, append='no')": (
        "RecordingError",
        "Recorder: append: expected True or False, got 'no'",
    ),
    "plots.plot_netlist(twin.netlist)": ("ParameterError", f"plot_netlist: {TWIN}"),
    "match(twin, [seen], groups={'monday'})": (
        "MatchError",
        "groups: expected a name for each recording, got {'monday'}",
    ),
    "control.PID(0.1, measured=5)": ("ControlError", "PID: measured: expected channels, or groups"),
    "simulate('paper-2024', drive)": ("SimulationError", TWIN),
    "simulate(None, drive)": ("SimulationError", TWIN),
    "simulate(rig, drive)": ("SimulationError", TWIN),
    "simulate(Twin, drive)": ("SimulationError", TWIN),
    "response(rig, drive)": ("SimulationError", TWIN),
    "simulate_batch(rig, drive, draws)": ("SimulationError", TWIN),
    "match(rig, seen)": ("MatchError", TWIN),
    "match_many(rig, [[seen]])": ("MatchError", TWIN),
    "sensitivity(rig, seen)": ("SimulationError", "sensitivity: " + TWIN),
    "sensitivity('paper-2024', seen)": ("SimulationError", "sensitivity: " + TWIN),
    "sensitivity([rig], seen)": ("SimulationError", "sensitivity: " + TWIN),
    "sweep(rig, seen, 'folder', draws=3)": ("SimulationError", "sweep: " + TWIN),
    "validate(None, seen)": ("MatchError", TWIN),
    "validate_split(rig, seen, 30)": ("MatchError", TWIN),
    "leave_one_out(rig, [seen, seen])": ("MatchError", TWIN),
    "simulate(twin, 'run.csv')": (
        "SimulationError",
        "experiment: " + EXPERIMENT + r"; read a file with read_recording\('run\.csv'\)",
    ),
    "control.save_controller(pid, 'pid.toml', rig)": (
        "ControlError",
        r"\(path, controller, rig\), in this order, got save_controller\(PID, str, Rig\)",
    ),
    "control.save_controller('pid.toml', rig, pid)": (
        "ControlError",
        r"in this order, got save_controller\(str, Rig, PID\)",
    ),
    "simulate(twin, np.zeros((3, 2)))": ("SimulationError", "experiment: " + EXPERIMENT),
    "simulate_batch(twin, None, draws)": ("SimulationError", "experiment: " + EXPERIMENT),
    "Experiment([0, 1], [0, 1], name=3)": ("RecordingError", "name: expected text.*, got 3"),
    "Experiment([0, 1], [0, 1], channels=3)": ("RecordingError", "channels: expected .* got 3"),
    "Experiment.schedule(None, duration=9)": ("RecordingError", "text: expected te.*, got None"),
    "Experiment.schedule('0:1', duration='9')": (
        "RecordingError",
        "duration: expected a number in s, or text such as \"10 min\", got '9'",
    ),
    "Experiment.schedule('0:1', duration=True)": ("RecordingError", "duration: " + FINITE),
    "Experiment.schedule('0:1', duration=9, step='1')": (
        "RecordingError",
        "step: expected a number in s, or text such as \"10 min\", got '1'",
    ),
    "Experiment.schedule('0:1', duration=9, cells=1.5)": ("RecordingError", "cells: " + WHOLE),
    "seen.between('a', 5)": ("RecordingError", "between: t0: " + FINITE),
    "seen.between(0, True)": ("RecordingError", "between: t1: " + FINITE),
    "seen.select(None)": ("RecordingError", "channels: expected one name or several.*, got None"),
    "match(twin, 'synthetic-A')": ("RecordingError", "synthetic-A: cannot be read: No such file"),
    "match(twin, None)": ("MatchError", "match: experiments: " + EXPERIMENT),
    "match(twin, ['synthetic-A'])": ("RecordingError", "synthetic-A: cannot be read: No such file"),
    "match_many(twin, 7)": ("MatchError", "sets: expected one or several sets.*, got 7"),
    "match_many(twin, [7])": ("MatchError", "match_many: sets: " + EXPERIMENT),
    "match_many(twin, [])": ("MatchError", "sets: .* got none"),
    "sensitivity(twin, {})": ("SimulationError", "sensitivity: .* got 0 twins for 0"),
    "sensitivity(twin, 7)": ("SimulationError", "sensitivity: experiments: " + EXPERIMENT),
    "sweep(twin, 'a', 'folder', draws=3)": ("SimulationError", "sweep: experiments: " + EXPERIMENT),
    "validate(twin, 7)": ("MatchError", "experiments: " + EXPERIMENT),
    "profile(None, 'R_ph')": ("MatchError", "profile: " + FIT),
    "profile(twin, 'R_ph')": ("MatchError", "profile: " + FIT),
    "prediction_band('fit.toml')": ("MatchError", "prediction_band: " + FIT),
    "build_netlist(twin)": ("RigError", "build_netlist: " + RIG),
    "plate_map(twin, np.zeros(24))": ("ParameterError", "plate_map: " + RIG),
    "plate_map(rig, ['a'])": ("ParameterError", "temperatures: expected numb.*, got .* values"),
    "frame_to_channels(None, np.zeros((4, 4)))": ("RigError", "frame_to_channels: " + RIG),
    "frame_to_channels(rig, 3)": ("RigError", "frames: expected .* of shape \\(\\)"),
    "read_parameters('fit.toml', twin)": (
        "RigError",
        "load_rig: expected the path of a file.*, got .*",
    ),
    "write_recording(twin, 'run.csv')": ("RecordingError", EXPERIMENT),
    "load_rig(None)": ("RigError", "load_rig: " + PATH),
    "load_rig(b'paper-2024')": ("RigError", "load_rig: " + PATH),
    "load_rig('a' * 5000)": ("RigError", "load_rig: " + PATH),
    "read_recording(None)": ("RecordingError", "read_recording: path: " + PATH),
    "read_recording('')": ("RecordingError", "read_recording: path: " + PATH),
    "read_recording('a\\0b')": ("RecordingError", "read_recording: path: " + PATH),
    "read_recording('a' * 5000)": ("RecordingError", "read_recording: path: " + PATH),
    "write_recording(drive, 3)": ("RecordingError", "write_recording: path: " + PATH),
    "read_parameters(3, rig)": ("ParameterError", PATH),
    "open_sweep(3)": ("SimulationError", "open_sweep: folder: " + PATH),
    "sweep(twin, seen, None, draws=3)": ("SimulationError", "sweep: folder: " + PATH),
    "Twin(rig, [1])": ("ParameterError", "values: expected name -> value.*, got .*"),
    "twin.with_values(5)": ("ParameterError", "values: expected name -> value.*, got 5"),
    "Twin(rig, {3: 1.0})": ("ParameterError", "values: expected name -> value.*, got 3"),
    "Twin(rig, {'R_ph': [[1], [1, 2]]})": ("ParameterError", "expected finite numbers"),
    "Twin(rig, {'R_ph': []})": ("ParameterError", "R_ph: expected finite numbers.*, got \\[\\]"),
    "simulate_batch(twin, drive, 'R_ph')": ("ParameterError", "expected name -> draws"),
    "simulate_batch(twin, drive, {'R_ph': [True]})": ("ParameterError", "expected numbers"),
    "simulate_batch(twin, drive, {'R_ph': ['1']})": ("ParameterError", "expected numbers"),
    "simulate_batch(twin, drive, {'R_ph': np.ones(2) + 0j})": (
        "ParameterError",
        "expected numbers",
    ),
    "reduce_batch(twin, drive, draws, 3)": ("SimulationError", "reductions: " + NAMES),
    "reduce_batch(twin, drive, draws, [[1]])": ("SimulationError", NAMES),
    "simulate_batch(twin, drive, draws, precision=[])": ("SimulationError", "precision: expected"),
    "simulate_batch(twin, drive, draws, chunk_size=True)": ("SimulationError", WHOLE + "above 0"),
    "simulate_batch(twin, drive, draws, on_progress=3)": ("SimulationError", FUNCTION),
    "simulate(twin, drive, initial=True)": ("SimulationError", "initial: expected .* got True"),
    "simulate(twin, drive, initial={})": ("SimulationError", "initial: expected .* got {}"),
    "simulate(twin, drive, initial=['a'])": ("SimulationError", "initial: expected"),
    "simulate(twin, drive, initial=[[1], [1, 2]])": ("SimulationError", "initial: expected"),
    "simulate(twin, drive, initial=-300)": (
        "SimulationError",
        "initial: expected -273.15 degC and above.*, got -300 degC",
    ),
    "simulate(twin, drive, solver='Kvaerno5')": ("SimulationError", "expected a diffrax solver"),
    "simulate(twin, drive, solver=diffrax.Kvaerno5(), dt0=np.nan)": (
        "SimulationError",
        "dt0: expected a number above 0, in s",
    ),
    "simulate(twin, drive, solver=diffrax.Kvaerno5(), dt0=-1.0)": (
        "SimulationError",
        "dt0: expected a number above 0.* got -1.0",
    ),
    "match(twin, seen, free=3)": ("MatchError", "free: " + NAMES),
    "match(twin, seen, fixed=[None])": ("MatchError", "fixed: " + NAMES),
    "match(twin, seen, per_recording=4)": ("MatchError", "per_recording: " + NAMES),
    "match(twin, seen, bounds=[1])": ("MatchError", "bounds: expected name -> .*, got .*"),
    "match(twin, seen, bounds={'R_ph': 3})": ("MatchError", "expected \\(lower, upper\\)"),
    "match(twin, seen, bounds={'R_ph': ('a', 'b')})": ("MatchError", "R_ph: bounds: expected"),
    "match(twin, seen, bounds={'R_ph': (None, 3)})": ("MatchError", "R_ph: bounds: expected"),
    "match(twin, seen, bounds={'R_ph': (np.nan, 3)})": ("MatchError", "R_ph: bounds: expected"),
    "match(twin, seen, bounds={'R_ph': ((1, 2), 3)})": ("MatchError", "R_ph: bounds: expected"),
    "match(twin, seen, loss='huber')": ("MatchError", LOSS + ".* got 'huber'"),
    "match(twin, seen, loss=matching.Huber)": ("MatchError", LOSS + ".* got .*Huber"),
    "matching.Huber('a')": ("MatchError", "Huber: threshold: expected a number above 0"),
    "matching.Cauchy(0)": ("MatchError", "Cauchy: threshold: expected a number above 0, got 0"),
    "rigs.register_sensor(rigs.AbstractSensor)": ("RigError", "its name in rig files"),
    "matching.register_loss(matching.AbstractLoss)": ("MatchError", "its name in saved fits"),
    "match(twin, seen, starts='2')": ("MatchError", "starts: " + WHOLE + "above 0"),
    "match(twin, seen, seed=-1)": ("MatchError", "seed: " + WHOLE + "of at least 0"),
    "match(twin, seen, solver='lm')": ("MatchError", "solver: " + LEAST_SQUARES + ".* got 'lm'"),
    "match(twin, seen, solver=optimistix.BFGS(1e-6, 1e-6))": ("MatchError", LEAST_SQUARES),
    "match_many(twin, [seen], solver=3)": ("MatchError", "solver: " + LEAST_SQUARES + ".* got 3"),
    "match(twin, seen, on_progress=3)": ("MatchError", "on_progress: " + FUNCTION),
    "sensitivity(twin, seen, draws=5.5)": ("SimulationError", "draws: " + WHOLE + "of at least 3"),
    "sensitivity(twin, seen, spread='a')": (
        "SimulationError",
        "spread: expected a number between 0 and 1",
    ),
    "sensitivity(twin, seen, spread=1)": ("SimulationError", "spread: .* between 0 and 1"),
    "sensitivity(twin, seen, seed=None)": ("SimulationError", "seed: " + WHOLE + "of at least 0"),
    "sensitivity(twin, seen, seed=2**200)": (
        "SimulationError",
        "seed: expected .* up to 2\\*\\*128",
    ),
    "global_sensitivity(twin, seen, method='fast')": (
        "SimulationError",
        "method: expected pearson, .* got 'fast'",
    ),
    "global_sensitivity(twin, seen, method=3)": (
        "SimulationError",
        "method: expected the name of a .*3",
    ),
    "global_sensitivity(twin, seen, method='oat', outputs=['heat'])": (
        "SimulationError",
        "outputs: expected some of cost, .*, temperature, or functions by name, got 'heat'",
    ),
    "global_sensitivity(twin, seen, method='oat', outputs=3)": (
        "SimulationError",
        "outputs: " + NAMES,
    ),
    "global_sensitivity(twin, seen, method='oat', times=3)": (
        "SimulationError",
        "times: expected several times, s, or None, got 3",
    ),
    "global_sensitivity(twin, seen, method='oat', inputs='flat')": (
        "ParameterError",
        "inputs: expected one of normal, .*, or name -> distribution, got 'flat'",
    ),
    "global_sensitivity(twin, seen, method='oat', inputs={'R_E': 3.0})": (
        "ParameterError",
        "inputs: R_E: expected Normal, Uniform or LogNormal of .*, got 3.0",
    ),
    "global_sensitivity(twin, seen, method='src', samples='grid')": (
        "SimulationError",
        "samples: expected one of random, latin-hypercube, sobol, got 'grid'",
    ),
    "sensitivity(twin, seen, names=3)": ("ParameterError", "names: " + NAMES),
    "sensitivity(twin, seen, on_progress=3)": ("SimulationError", "on_progress: " + FUNCTION),
    "sweep(twin, seen, 'folder', draws=True)": (
        "SimulationError",
        "sweep: draws: " + WHOLE + "above 0",
    ),
    "sensitivity(twin, seen, executor=3)": (
        "SimulationError",
        "sensitivity: executor: expected .* got 3",
    ),
    "sweep(twin, seen, 'folder', draws=3, executor=3)": (
        "SimulationError",
        "sweep: executor: expected .* got 3",
    ),
    "simulate_batch(twin, seen, draws, executor='dask')": (
        "SimulationError",
        "executor: expected .* got 'dask'",
    ),
    "match_many(twin, [[seen]], executor=3)": (
        "MatchError",
        "match_many: executor: expected .* got 3",
    ),
    "validate(twin, seen, warm_up='a')": ("MatchError", "validate: warm_up: " + FINITE),
    "validate(twin, seen, names=3)": ("MatchError", "validate: names: " + NAMES),
    "validate_split(twin, seen, None)": ("MatchError", "validate_split: at: " + FINITE),
    "leave_one_out(twin, [seen, seen], by='day')": (
        "MatchError",
        'by: expected "recording" or "group", got \'day\'',
    ),
    "leave_one_out(twin, [seen, seen], by='group')": (
        "MatchError",
        "by: expected recordings of two groups or more, got one group ''; give groups",
    ),
    "match(twin, seen, gaps='fill')": ("MatchError", "gaps: expected .* got 'fill'"),
    "leave_one_out(twin, [seen, seen], warm_up=None)": ("MatchError", "warm_up: " + FINITE),
}


@pytest.fixture(scope="module")
def found() -> dict[str, list[str]]:
    """Call -> name and text of what it raised, from one process for all of them."""
    child = subprocess.run(
        [sys.executable, "-c", SETTING],
        input=json.dumps(list(CASES)),
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(child.stdout)


@pytest.mark.parametrize("call", CASES)
def test_a_wrong_argument_gives_a_sentence_that_says_what_is_allowed(
    found: dict[str, list[str]], call: str
) -> None:
    error, words = CASES[call]
    raised, text = found[call]
    assert raised == error, text
    assert re.search(words, text)
    assert "\n" not in text


def test_whole_numbers_of_numpy_are_whole_numbers():
    assert whole_number("starts", np.int32(3), 1, JaxtwinError) == 3


def test_truth_values_of_numpy_are_truth_values():
    assert true_or_false("noise", np.bool_(False), JaxtwinError) is False


def test_a_single_name_is_one_and_a_repeated_one_counts_once():
    assert names_of("free", "R_E", JaxtwinError) == ("R_E",)
    assert names_of("free", ["R_pc", "R_E", "R_pc"], JaxtwinError) == ("R_pc", "R_E")


def test_names_of_a_set_have_the_same_order_in_every_process():
    names = [f"R_{number}" for number in range(10)]  # ten have one order in 3.6 million
    for given in (set(names), frozenset(names[::-1])):
        assert names_of("free", given, JaxtwinError) == tuple(names)
    assert names_of("free", dict.fromkeys(names[::-1]).keys(), JaxtwinError) == tuple(names[::-1])


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert path_of("folder", "~/sweep", JaxtwinError) == tmp_path / "sweep"
