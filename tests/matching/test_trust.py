"""Priors, the camera as an instrument, uncertainty: on recordings whose truth is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxtwin import Experiment, Fit, MatchError, Twin, match, simulate
from jaxtwin.matching._estimate import first_knowledge, make_problem
from jaxtwin.matching._match import checked_recordings, make_setting
from jaxtwin.matching._residuals import residual_jacobian, residuals
from jaxtwin.matching._unknowns import choose_unknowns

FREE = ["h_A", "R_pc1_row2", "g_T11", "T_amb"]
TRUTH = {"h_A": 20.0, "R_pc1_row2": 0.4, "g_T11": 0.95, "T_amb": 17.0}
CHANNELS = ("T11", "T12", "TAM")
EVENTS = (90.0, 210.0)


def recording(seed: int, camera: bool, name: str) -> Experiment:
    """A run of the true twin with noise, and with two corrections of the camera."""
    rng = np.random.default_rng(seed)
    drive = Experiment.schedule("0:0.5,150:0.8", duration=300, cells=2, channels=CHANNELS)
    seen = simulate(Twin("dual-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * rng.standard_normal(seen.shape)
    if camera:
        for event, jump in zip(EVENTS, (1.0, -0.8), strict=True):
            after = np.maximum(drive.time - event, 0)
            seen += (np.where(drive.time >= event, jump, 0) * np.exp(-after / 25))[:, None]
    return Experiment(drive.time, drive.duty, channels=CHANNELS, temperatures=seen, name=name)


@pytest.fixture(scope="module")
def start() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="module")
def disturbed(start: Twin) -> Fit:
    return match(start, [recording(0, True, "day 1"), recording(1, True, "day 2")], free=FREE)


@pytest.fixture(scope="module")
def calm(start: Twin) -> Fit:
    return match(start, [recording(2, False, "day 1"), recording(3, False, "day 2")], free=FREE)


def test_corrections_are_found_and_the_plate_keeps_its_dynamics(disturbed: Fit):
    for camera in disturbed.camera.values():
        np.testing.assert_allclose(camera.events, EVENTS, atol=2)
    for name, value in TRUTH.items():
        row = disturbed.parameter(name)
        # Four standard errors: one false alarm in ten thousand.
        assert abs(row.value - value) < 4 * row.standard_error
        assert row.standard_error < 0.1 * abs(value)
    assert disturbed.rmse < 0.1


def test_without_corrections_none_are_found_and_the_camera_takes_nothing(calm: Fit):
    for camera in calm.camera.values():
        assert camera.events == ()
        assert np.abs(camera.error).max() < 0.3
    for name, value in TRUTH.items():
        row = calm.parameter(name)
        assert abs(row.value - value) < 4 * row.standard_error


def test_the_jacobian_is_that_of_the_residuals(start: Twin):
    runs = [recording(4, True, "a"), recording(5, False, "b")]
    unknowns = choose_unknowns(start, 2, free=FREE)
    names = checked_recordings(start, runs)
    setting = make_setting(start, runs, names, unknowns, None, None, None)
    problem = make_problem(setting, first_knowledge(setting))
    with jax.enable_x64(True):
        vector = jnp.asarray(unknowns.start()) + 0.1
        ours = residual_jacobian(vector, problem)
        plain = jax.jacfwd(lambda v: ravel_pytree(residuals(v, problem)[0])[0])(vector)
    np.testing.assert_allclose(ours, plain, rtol=1e-9, atol=1e-9)


def test_what_no_sample_tells_stays_at_its_prior(start: Twin):
    # R_sink2 is behind the cell that these channels do not see.
    fit = match(start, recording(2, False, "day"), free=["h_A", "R_sink2"])
    row = fit.parameter("R_sink2")
    assert row.told < 1
    assert "prior only" in row.warnings
    assert row.value == pytest.approx(0.5, rel=0.3)
    assert row.standard_error == pytest.approx(row.value, rel=0.3)


def test_masked_spans_do_not_count(start: Twin):
    clean = recording(2, False, "day")
    assert clean.temperatures is not None
    broken = clean.temperatures.copy()
    broken[200:240, 0] += 5.0
    spoiled = Experiment(clean.time, clean.duty, channels=CHANNELS, temperatures=broken, name="day")
    fit = match(start, spoiled, free=FREE, events="none", masks={"day": [(200.0, 239.0)]})
    assert fit.weights["day"][210, 0] == 0.0
    assert abs(fit.parameter("h_A").value - 20.0) < 4 * fit.parameter("h_A").standard_error


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"events": {"day": [400.0]}}, "events: day: found 400 s.*0 to 300"),
        ({"events": {"night": [10.0]}}, "events: found the recording 'night', allowed are day"),
        ({"masks": {"day": [(10.0, 400.0)]}}, "masks: day.*0 to 300"),
        ({"masks": {"day": [(0.0, 300.0)]}}, "no sample left"),
        ({"robust": 0.0}, "robust: found 0.0"),
        ({"bounds": {"h_A": (15.5, 40.0)}}, "h_A"),
    ],
)
def test_bad_requests_say_what_is_allowed(start: Twin, options, words):
    with pytest.raises(MatchError, match=words):
        match(start, recording(2, False, "day"), free=FREE, **options)


def test_tables_can_be_pasted(disturbed: Fit):
    names = [row.name for row in disturbed.parameters if row.free]
    markdown = disturbed.summary("markdown").splitlines()
    assert len(markdown) == 2 + len(names)
    assert len({line.count("|") for line in markdown}) == 1
    latex = disturbed.summary("latex")
    assert latex.count(r" \\") == 1 + len(names)
    assert r"R\_pc1\_row2" in latex
    assert "corrections of the camera" in disturbed.summary()
