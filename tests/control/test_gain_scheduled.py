"""Controllers of several operating points in one: what it is at a point, between two, and when it
goes from one to the other."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Twin, export_c, simulate_closed_loop
from jaxtwin.control import (
    PID,
    DecoupledPI,
    GainScheduled,
    loop_margins,
    read_controller,
    save_controller,
)
from jaxtwin.errors import ControlError

LIMITS = {"limits": (0, 1), "sample_time_s": 5.0}
COLD = PID(0.03, 3e-4, measured=["T1", "T2"], setpoint_weight=0.5, **LIMITS)
WARM = PID(0.06, 5e-4, measured=["T1", "T2"], setpoint_weight=0.7, **LIMITS)
MATRICES = [[1.0, -0.2], [-0.1, 1.0]], [[1.1, -0.1], [-0.3, 0.9]]
PAIRS = [
    DecoupledPI(0.04, 3e-4, 0.03, 2e-4, measured=["T1", "T2"], decoupling=matrix, **LIMITS)
    for matrix in MATRICES
]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


@pytest.mark.slow
@pytest.mark.parametrize("controllers", [[COLD, WARM], PAIRS])
@pytest.mark.parametrize("by", ["measurement", "reference"])
def test_at_a_point_the_loop_is_that_of_its_controller(twin: Twin, controllers: Any, by: Any):
    scheduled = GainScheduled(controllers, at=[35.0, 45.0], by=by)
    for controller, at in zip(controllers, [35.0, 45.0], strict=True):
        alone, ours = (loop_margins(twin, one, at) for one in (controller, scheduled))
        np.testing.assert_allclose(ours.sensitivity_peak, alone.sensitivity_peak, rtol=1e-6)
        np.testing.assert_allclose(ours.disk.gain, alone.disk.gain, rtol=1e-6)


def test_between_two_points_the_parameters_are_on_the_line_between_them():
    scheduled = GainScheduled([COLD, WARM], at=[30.0, 50.0])
    for at, share in ((20.0, 0.0), (35.0, 0.25), (50.0, 1.0), (70.0, 1.0)):
        np.testing.assert_allclose(scheduled.controller_at(at).Kp, 0.03 + share * 0.03, rtol=1e-6)


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("controllers", [[COLD, WARM], PAIRS])
def test_the_duty_does_not_jump_when_the_parameters_change(controllers: Any):
    """At rest it is the one that the parameters of before ask for, whatever set-point weight and
    decoupling."""
    scheduled = GainScheduled(controllers, at=[30.0, 50.0])
    measurement = jnp.array([49.0, 51.0])
    state = scheduled.init(jnp.array([0.4, 0.3]), jnp.full(2, 30.0))
    asked, _ = controllers[0].step(state.controller, measurement, measurement)
    duty, _ = scheduled.step(state, measurement, measurement)
    np.testing.assert_allclose(duty, asked, atol=1e-12)
    other, _ = controllers[1].step(state.controller, measurement, measurement)
    assert np.abs(other - asked).max() > 1e-3


@pytest.mark.slow
def test_a_plate_that_is_cooled_is_another_plant():
    """benchmarks/results/controllers.md: neither PID is robust and quick at both temperatures."""
    twin = Twin("dual-cell")
    cooling = PID(Kp=0.16, Ki=0.0042, limits=(-1, 1))
    heating = PID(Kp=0.055, Ki=0.0013, limits=(-1, 1))
    scheduled = GainScheduled([cooling, heating], at=[10, 15])
    peaks, settled = {}, {}
    for name, one in (("cooling", cooling), ("heating", heating), ("scheduled", scheduled)):
        peaks[name] = [loop_margins(twin, one, at).sensitivity_peak for at in (10.0, 40.0)]
        settled[name] = [
            simulate_closed_loop(
                twin, one, f"0:{start},400:{end}", duration=900, noise=False, initial=start
            ).measures()["value"]["settling_time"]
            for start, end in ((14.0, 10.0), (36.0, 40.0))
        ]
    np.testing.assert_allclose(peaks["cooling"], [1.59, 4.14], atol=0.01)
    np.testing.assert_allclose(peaks["heating"], [1.18, 1.59], atol=0.01)
    np.testing.assert_allclose(peaks["scheduled"], [1.59, 1.59], atol=0.01)
    np.testing.assert_allclose(settled["cooling"], [34, 122], atol=1)
    np.testing.assert_allclose(settled["heating"], [166, 79], atol=1)
    np.testing.assert_allclose(settled["scheduled"], [60, 79], atol=1)
    apart = GainScheduled([cooling, heating], at=[10, 40])
    assert loop_margins(twin, apart, 20.0).sensitivity_peak > 3.2


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
def test_equal_controllers_are_one(twin: Twin):
    scheduled = GainScheduled([COLD, COLD], at=[30.0, 40.0])
    runs = [
        simulate_closed_loop(twin, one, [45.0, 38.0], duration=300) for one in (COLD, scheduled)
    ]
    np.testing.assert_allclose(runs[1].duty, runs[0].duty, atol=1e-9)


@pytest.mark.parametrize("controllers", [[COLD, WARM], PAIRS])
def test_a_file_has_a_table_for_each_point(twin: Twin, tmp_path: Path, controllers: Any):
    path = tmp_path / "scheduled.toml"
    scheduled = GainScheduled(controllers, at=[30.0, 50.5], by="reference")
    save_controller(path, scheduled, twin.rig)
    again = read_controller(path, twin.rig)
    assert jax.tree.structure(again) == jax.tree.structure(scheduled.for_rig(twin.rig))
    for found, value in zip(jax.tree.leaves(again), jax.tree.leaves(scheduled), strict=True):
        np.testing.assert_array_equal(found, value)
    kind = type(controllers[0]).__name__
    said = f"<GainScheduled {kind} by the reference: at 30, 50.5 degC, sample time 5 s>"
    assert repr(again) == said


FILE = """
format = 1
rig = "tclab"
kind = "gain-scheduled"
sample_time = "5 s"
of = "pid"
[[points]]
at = "30 degC"
Kp = "0.1 1/K"
[[points]]
at = "50 degC"
Kp = "0.2 1/K"
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('of = "pid"', 'of = "lqi"', r"of: expected one of pid, decoupled-pi, got 'lqi'"),
        ('"50 degC"', '"20 degC"', r"GainScheduled: at: expected a temperature for each"),
        ('Kp = "0.2 1/K"', "", r"points\[1\]\.Kp: expected this field, got none"),
        ('Kp = "0.2 1/K"', 'Kp = "0.2 K"', r"points\[1\]\.Kp: expected a gain"),
        ('Kp = "0.2 1/K"', 'KP = "0.2 1/K"', r"points\[1\]\.KP: unknown field"),
        ('at = "50 degC"', "at = 50", r"points\[1\]\.at\[0\]: expected"),
        ('of = "pid"', 'of = "pid"\nby = "room"', r"by: expected 'measurement' or 'reference'"),
        ('of = "pid"', 'of = "decoupled-pi"', r"points\[0\]\.Kp: unknown field"),
    ],
)
def test_a_wrong_file(twin: Twin, tmp_path: Path, old: str, new: str, message: str):
    path = tmp_path / "scheduled.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(ControlError, match=rf"scheduled\.toml: {message}"):
        read_controller(path, twin.rig)


@pytest.mark.parametrize(
    ("controllers", "at", "message"),
    [
        ([COLD], [30], "at: expected a temperature for each of at least two"),
        ([COLD, WARM], [50, 30], "in rising order, degC, got"),
        ([COLD, PAIRS[0]], [30, 50], "expected a PID for each point, or a DecoupledPI for each"),
        ([COLD, PID(0.1)], [30, 50], "expected the same outputs, sample time, limits and kinds"),
    ],
)
def test_controllers_that_do_not_fit(controllers: Any, at: Any, message: str):
    with pytest.raises(ControlError, match=message):
        GainScheduled(controllers, at=at)


def test_there_is_no_c(twin: Twin, tmp_path: Path):
    with pytest.raises(ControlError, match="whose class has a law in C, got a GainScheduled"):
        export_c(GainScheduled([COLD, WARM], at=[30, 50]), tmp_path, rig=twin.rig)
