"""Derivatives by draws in C, beside those that JAX integrates."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin, match, simulate
from jaxtwin._jax_settings import own_settings
from jaxtwin.matching import named_recordings
from jaxtwin.matching._jacobian import output_error_jacobians
from jaxtwin.matching._native_recordings import NativeRecordings
from jaxtwin.matching._noise_model import initial_noise_model
from jaxtwin.matching._objective import make_objective
from jaxtwin.matching._problem import (
    MatchProblem,
    ParameterChoice,
    choose_unknowns,
    make_match_problem,
)
from jaxtwin.matching._residuals import output_errors

pytestmark = pytest.mark.c_compiler


def problem_of(rig: str, names: list[str], room: float | None = None) -> MatchProblem:
    """A match of some parameters to a minute of steps with two of the rig's channels."""
    twin = Twin(rig)
    cells = len(twin.wiring.cold)
    drive = Experiment.schedule("0:0,5:0.6,30:0.2", duration=60, cells=cells)
    if room is not None:
        drive = replace(drive, ambient=np.linspace(room, room + 1, len(drive.time)))
    run = simulate(twin, drive)
    recording = replace(
        drive, channels=run.channels[-2:], temperatures=run.temperatures[:, -2:] + 0.1
    )
    unknowns = choose_unknowns(twin, (0,), ParameterChoice(names))
    return make_match_problem(twin, named_recordings(twin, [recording]), unknowns)


def native_of(problem: MatchProblem) -> NativeRecordings:
    native = NativeRecordings.of(problem)
    assert native is not None
    return native


@pytest.mark.parametrize(
    ("rig", "names", "room"),
    [
        ("single-cell", ["R_E", "T_amb", "C_sink"], None),
        ("paper-2024", ["alpha", "R_E", "C_element", "R_ph"], 21.0),
        ("dual-cell", ["R_sink1", "h_A", "t_delay", "t_lag", "g_TCM", "T_start"], None),
    ],
)
def test_differences_are_the_derivatives_that_jax_integrates(
    rig: str, names: list[str], room: float | None
):
    problem = problem_of(rig, names, room)
    native, vector = native_of(problem), problem.unknowns.start()
    objective = make_objective(problem, initial_noise_model(problem))
    with own_settings():

        @jax.jit
        def both(vector):
            return output_errors(vector, objective), output_error_jacobians(vector, objective)

        errors, exact = both(jnp.asarray(vector))
        found_errors, found = native.output_errors(vector, 0), native.jacobian(vector, 0)
    assert found_errors is not None
    np.testing.assert_allclose(found_errors, errors[0][0], atol=2e-4)
    assert found is not None
    expected = np.asarray(exact[0][0])
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    # Single precision in C makes 4e-7 K, over twice a step of 4e-3 of the scale of an entry.
    times = len(problem.experiments[0].time)
    assert np.all(np.abs(found - expected)[:, :times] < 1e-3 * scale + 1e-3)


def test_a_match_is_the_same_without_a_compiler(monkeypatch: pytest.MonkeyPatch):
    twin = Twin("single-cell")
    drive = Experiment.schedule("0:0,5:0.6,60:-0.2", duration=120)
    seen = twin.with_values({"R_E": 1.1 * twin["R_E"]}).simulate(drive).to_recording(noise=0.05)
    fits = {}
    for choice in ("on", "off"):
        monkeypatch.setenv("JAXTWIN_NATIVE", choice)
        fits[choice] = match(twin, seen, free=["R_E", "C_sink"])
    for name in ("R_E", "C_sink"):
        row, other = fits["on"][name], fits["off"][name]
        assert abs(row.value - other.value) < 0.05 * other.standard_error
        assert row.standard_error == pytest.approx(other.standard_error, rel=0.02)
