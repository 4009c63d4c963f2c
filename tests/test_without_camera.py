"""A rig that thermocouples read, from its file to a match, a validation, pictures and a link."""

import json
from pathlib import Path

import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench
from typer.testing import CliRunner

from jaxtwin import Experiment, Twin, load_rig, match, plots, read_recording, simulate, validate
from jaxtwin.cli import app
from jaxtwin.errors import LinkError, RigError
from jaxtwin.io import write_recording
from jaxtwin.live import Reading, Recorder, Replay, Sample, VirtualRig
from jaxtwin.physics import Faults, frame_to_channels
from jaxtwin.rig import Rig

TEXT = """
format = 1
name = "strip"
title = "An aluminium strip on one cell, three thermocouples"

[plate]
columns = ["4 cm", "4 cm", "4 cm"]
rows = ["2 cm", "2 cm"]
thickness = "2 mm"
density = "2700 kg/m^3"
specific_heat = "900 J/(kg K)"
conductivity = "k"
film_coefficient = "h"

[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "17 J/K"
contacts = { V11 = "R_pc", V21 = "R_pc" }
sink_resistance = "0.5 K/W"

[driver]
supply_voltage = "12 V"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"

[sensors]
noise = "0.05 K"

[[channels]]
name = "near"
nodes = ["V11"]

[[channels]]
name = "middle"
x = "6 cm"
y = "1 cm"

[[channels]]
name = "far"
x = "12 cm"
y = "2 cm"

[limits]
temperature = "90 degC"

[ambient]
temperature = "T_amb"

[initial]
temperature = "T_amb"

[parameters]
k = { value = 180.0, unit = "W/(m K)", bounds = [20.0, 400.0], free = true }
h = { value = 15.0, unit = "W/(m^2 K)", bounds = [2.0, 100.0], free = true }
R_pc = { value = 0.6, unit = "K/W", bounds = [0.02, 40.0], free = true }
T_amb = { value = 20.0, unit = "degC", bounds = [5.0, 35.0], free = true, scope = "recording" }
"""
CAMERA = """
[camera]
resolution = [80, 60]
noise = "0.1 K"
view = { x = [0, 80], y = [0, 60] }
"""
TRUTH = {"k": 140.0, "h": 22.0, "R_pc": 0.9, "T_amb": 17.0}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "strip.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def rig(file: Path) -> Rig:
    return load_rig(file)


@pytest.fixture(scope="module")
def recording(rig: Rig) -> Experiment:
    """Of the true rig, with the sensors' noise."""
    drive = Experiment.schedule(
        "60:0.4,300:0.6", duration=600, step=2.0, channels=("near", "middle", "far"), name="run"
    )
    exact = simulate(Twin(rig, TRUTH), drive).temperatures
    noise = rig.noise * np.random.default_rng(0).standard_normal(exact.shape)
    return Experiment(
        drive.time,
        drive.duty,
        channels=drive.channels,
        temperatures=exact + noise,
        name="run",
    )


def test_a_sensor_in_the_middle_of_an_element_reads_it_alone(rig: Rig):
    """One on the right edge reads the last column, because the temperature is constant beyond the
    outermost centres, and both rows, because it lies on their border."""
    assert rig.camera is None
    assert rig.common_error is None
    assert rig.noise == 0.05
    state = np.zeros(6)
    state[1] = 1.0
    weights = Twin(rig).wiring.channel_weights[:, :6]
    np.testing.assert_array_equal(weights @ state, [0, 1, 0])
    np.testing.assert_allclose(weights[2], [0, 0, 0.5, 0, 0, 0.5])


def test_a_point_sensor_reads_the_temperature_interpolated_between_centres(tmp_path: Path):
    """At 5 cm and 2 cm, between centres at 2 and 6 cm, and on the border of the rows: the column
    of V12 has 3/4, each row half."""
    path = tmp_path / "moved.toml"
    path.write_text(TEXT.replace('x = "6 cm"\ny = "1 cm"', 'x = "5 cm"\ny = "2 cm"'), "utf-8")
    weights = Twin(load_rig(path)).wiring.channel_weights[1, :6]
    np.testing.assert_allclose(weights, np.array([1, 3, 0, 1, 3, 0]) / 8)


@pytest.mark.slow
def test_a_match_recovers_the_truth_and_a_validation_predicts(rig: Rig, recording: Experiment):
    fit = match(Twin(rig), recording)
    for name, value in TRUTH.items():
        row = fit[name]
        assert abs(row.value - value) < 3 * row.standard_error < 0.1 * value
    assert fit.rmse == pytest.approx(0.05, rel=0.1)
    assert not fit.camera["run"].error.any()
    checked = validate(fit, recording)
    assert checked.mean_fit_percent > 99
    run = fit.runs["run"]
    for figure in (
        plots.plot_comparison([run]),
        plots.plot_residuals([run]),
        plots.plot_residual_tests([run]),
        plots.plot_uniformity([run]),
        plots.plot_plate_beside(rig, [run], [100.0, 500.0]),
        plots.plot_camera_error(fit),
        plots.plot_netlist(Twin(rig)),
    ):
        assert figure is not None


@pytest.mark.slow
def test_the_virtual_rig_streams_sensors_and_no_frames(rig: Rig, tmp_path: Path):
    clock, file = HandClock(), tmp_path / "live.db"
    twin = Twin(rig, TRUTH)
    device = VirtualRig(twin, speed=20)
    with Recorder(file, rig, clock=clock) as recorder:
        bench = virtual_bench(rig, device, clock, journal=recorder)
        records: list = []
        for step in range(100):
            if step % 5 == 0:
                bench.send_duty((128,))
            records += bench.poll()
    readings = [record for record in records if isinstance(record, Reading)]
    assert len(readings) == sum(isinstance(record, Sample) for record in records) > 500
    assert all(reading.pixels is None for reading in readings)
    experiment = read_recording(file)
    assert experiment.channels == ("near", "middle", "far")
    exact = simulate(twin, experiment).temperatures
    # Means of ten readings with noise of 0.05 K; the drive is known to half a step.
    assert np.abs(np.asarray(experiment.temperatures) - exact)[20:].max() < 0.3
    with Replay(file, speed=float("inf")) as replay:
        again = [record for record in replay if isinstance(record, Reading)]
    np.testing.assert_array_equal(
        [recording.temperatures for recording in again],
        [recording.temperatures for recording in readings],
    )


def test_a_camera_is_refused_where_the_rig_has_none(rig: Rig):
    with pytest.raises(LinkError, match="jumps: expected 0 for a rig without a camera, got 100"):
        VirtualRig(Twin(rig), faults=Faults.parse("jumps=100"))
    with pytest.raises(RigError, match=r"strip\.toml: camera: expected a rig with a camera"):
        frame_to_channels(rig, np.zeros((60, 80)))


def test_the_commands_take_the_rig(file: Path, recording: Experiment, tmp_path: Path):
    run = CliRunner().invoke
    checked = run(app, ["check", str(file)])
    assert checked.exit_code == 0, checked.output
    drawn = run(app, ["netlist", str(file), "--out", str(tmp_path / "network.png")])
    assert drawn.exit_code == 0, drawn.output
    path = write_recording(recording, tmp_path / "run.csv")
    numbers_file, out = tmp_path / "numbers.json", tmp_path / "out.nc"
    options = ["--recording", str(path), "--out", str(out), "--json", str(numbers_file)]
    simulated = run(app, ["simulate", str(file), *options])
    assert simulated.exit_code == 0, simulated.output
    numbers = json.loads(numbers_file.read_text())
    assert set(numbers["fit_percent"]) == {"near", "middle", "far"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            '[sensors]\nnoise = "0.05 K"',
            "",
            r"camera: expected either \[camera\] or .* got neither",
        ),
        (
            "[sensors]",
            CAMERA + "\n[sensors]",
            "camera: expected either .*, got both",
        ),
        ('noise = "0.05 K"', "", "sensors.noise: missing"),
        ('x = "6 cm"', 'x = "16 cm"', r"channels\[middle\].x: .* 0 to 12 cm, got '16 cm'"),
        ('x = "6 cm"\n', "", r"channels\[middle\]: expected either nodes or x with y"),
        ('x = "6 cm"', 'x = ["5 cm", "7 cm"]', r"channels\[middle\]: expected a position in both"),
        (
            'x = "6 cm"',
            'x = ["5 cm"]',
            r"channels\[middle\].x: expected one position or .* got 1 entries",
        ),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, said: str):
    assert old in TEXT
    path = tmp_path / "strip.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(RigError, match=said):
        load_rig(path)
