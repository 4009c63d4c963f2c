"""What a diagnosis says of runs of a small rig."""

from functools import cache

import numpy as np
import pytest
from faulty_runs import ONSET, SIZE, bench, clean, recording, with_readings

import jaxtwin as jt
from jaxtwin.diagnosis import Diagnosis, suspects
from jaxtwin.diagnosis._diagnose import learned
from jaxtwin.errors import ObserverError
from jaxtwin.physics import FAULT_MODELS


@cache
def found(*fault: object) -> Diagnosis:
    return jt.diagnose(bench(), recording(*fault))  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_healthy_run_is_healthy(seed: int):
    diagnosis = jt.diagnose(bench(), recording(seed=seed))
    assert diagnosis.causes == ()
    assert "healthy" in diagnosis.summary()
    np.testing.assert_allclose(diagnosis.probabilities.sum(axis=1), 1.0)
    assert diagnosis.probabilities[:, -1].min() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("row", "reading"), [(0, 85.0), (200, -127.0), (400, 60.0)])
def test_a_single_impossible_reading_is_no_fault(row: int, reading: float):
    healthy = recording()
    readings = np.array(healthy.temperatures)
    readings[row, 0] = reading
    diagnosis = jt.diagnose(bench(), with_readings(readings, healthy.duty))
    assert diagnosis.causes == ()
    assert diagnosis.probabilities[:, -1].min() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "within"),
    [
        (("gain", "T1", 0.8), 5.0),
        (("load", "H1", 1.5), 30.0),
        (("fail", "H1", 1.0), 30.0),
        (("offset", "T2", 1.0), 5.0),
    ],
)
def test_a_fault_is_named_with_its_size_and_onset_in_their_bands(
    fault: tuple[str, str, float], within: float
):
    (cause,) = found(*fault).causes
    assert cause.name == " ".join(fault[:2])
    best = cause.best
    assert best.lower <= fault[2] <= best.upper + 1e-9
    assert best.onset_lower <= ONSET + 0.5 <= best.onset_upper
    assert ONSET < cause.found <= ONSET + 2 * within
    assert cause.probability > 0.5
    assert cause.until is None
    assert not cause.is_partial


@pytest.mark.slow
def test_an_open_lid_is_a_loss_in_watt_per_kelvin():
    (cause,) = found("leak", "H1", 2.0).causes
    usual = suspects(bench())["leak H1"]
    assert cause.name == "leak H1"
    assert cause.best.unit == "W/K"
    assert cause.best.healthy == usual.none
    # The band takes the onset as known; a slow fault's is found some seconds off.
    assert cause.size == pytest.approx(2 * usual.none, rel=0.03)


@pytest.mark.slow
def test_what_channels_cannot_tell_apart_is_a_tie():
    """The heat of a heater is V^2 / R: its supply and its resistance look the same."""
    diagnosis = found("age", "H1", 1.3)
    (cause,) = diagnosis.causes
    assert {"age H1", "weaken H1"} <= set(cause.tie)
    assert diagnosis.ties == [cause.tie]
    sizes = {one.name: one.size for one in cause.explanations}
    assert sizes["weaken H1"] == pytest.approx(1 / np.sqrt(sizes["age H1"]), rel=0.02)
    assert "or weaken H1" in diagnosis.summary() or "or age H1" in diagnosis.summary()


@pytest.mark.slow
def test_none_of_these_is_an_answer():
    diagnosis = jt.diagnose(bench(), recording("gain", "T1", 0.8), ["leak H2", "age H2"])
    assert diagnosis.causes[0].name == "none of these"
    assert np.isnan(diagnosis.causes[0].size)


def no_fault(kind: str) -> jt.Experiment:
    """Readings that no fault explains, from the beginning or from the onset of faults on."""
    duty, readings = clean()
    readings = readings + np.random.default_rng(1).normal(0.0, SIZE, readings.shape)
    wrong = readings.copy()
    if kind == "mirrored":
        wrong = 2 * readings.mean(axis=0) - readings
    elif kind == "mirrored later":
        wrong[ONSET:] = 2 * readings[ONSET:].mean(axis=0) - readings[ONSET:]
    elif kind == "shuffled":
        wrong[ONSET:] = np.random.default_rng(2).permutation(readings[ONSET:])
    elif kind == "backwards":
        wrong = readings[::-1]
    return with_readings(wrong, duty)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mirrored", "mirrored later", "shuffled", "backwards"])
def test_what_no_fault_explains_is_none_of_these(kind: str):
    """The best of many wrong faults explains more than no fault does, which once was enough to be
    called certain."""
    first = jt.diagnose(bench(), no_fault(kind)).causes[0]
    assert first.name == "none of these"
    assert first.probability > 0.95


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        "exchanged",
        "fast clock",
        pytest.param("exchanged later", marks=pytest.mark.long),
        pytest.param("another rig", marks=pytest.mark.long),
    ],
)
def test_wrong_recordings_of_a_rig_with_many_channels_are_no_fault_of_it(kind: str):
    """All 15 channels of the rig with two cells are exchanged, or the recording is of a rig whose
    values are others, or its clock runs at half the rate that it should."""
    twin = jt.Twin("dual-cell")
    time = np.arange(601.0)
    random = np.random.default_rng(0)
    duty = np.repeat(random.uniform(0.0, 0.9, (11, 2)), 60, axis=0)[:601]
    true = 2 * time if kind == "fast clock" else time
    rig = twin
    if kind == "another rig":
        rig = twin.with_values(
            {
                name: float(value) * np.exp(random.normal(0.0, 0.7))
                for name, value in twin.values.items()
                if twin.rig.parameters[name].free and twin.rig.parameters[name].is_logarithmic
            }
        )
    plan = jt.Experiment(true, duty, channels=twin.channels)
    one = jt.simulate(rig, plan).to_recording(seed=1)
    readings = np.array(one.temperatures)
    others = np.random.default_rng(5).permutation(readings.shape[1])
    if kind == "exchanged":
        readings = readings[:, others]
    elif kind == "exchanged later":
        readings[300:] = readings[300:, others]
    wrong = jt.Experiment(time, duty, channels=twin.channels, temperatures=readings)
    first = jt.diagnose(twin, wrong).causes[0]
    assert first.name == "none of these"


@pytest.mark.slow
@pytest.mark.parametrize("later", [0, 150])
def test_two_faults_at_once_leave_more_than_noise(later: int):
    """No suspect is two of them: the likeliest one is said to explain a part."""
    duty, readings = clean("fail", "H1", 0.5)
    readings = readings + np.random.default_rng(3).normal(0.0, SIZE, readings.shape)
    readings[ONSET + later :, 1] *= 0.8
    diagnosis = jt.diagnose(bench(), with_readings(readings, duty))
    assert any(cause.is_partial for cause in diagnosis.causes)
    assert "explains a part" in diagnosis.summary()
    assert max(cause["misfit"] for cause in diagnosis.to_dict()["causes"]) > 1.25


@pytest.mark.slow
def test_two_weak_faults_at_once_are_called_one_of_them():
    """What is left of the second is not more than noise: the page says so."""
    duty, readings = clean()
    readings = readings + np.random.default_rng(3).normal(0.0, SIZE, readings.shape)
    readings[ONSET:] = 23 + np.array([0.95, 0.97]) * (readings[ONSET:] - 23)
    (cause,) = jt.diagnose(bench(), with_readings(readings, duty)).causes
    assert cause.name == "gain T1"
    assert not cause.is_partial


@pytest.mark.slow
def test_a_fault_of_ones_own_is_a_function():
    own = FAULT_MODELS["gain"](bench(), "T1", 0.9)
    diagnosis = jt.diagnose(bench(), recording("gain", "T1", 0.8), {"dust on T1": own})
    (cause,) = diagnosis.causes
    assert cause.name == "dust on T1"
    assert cause.best.lower <= 2.0 <= cause.best.upper  # twice as much dust


@pytest.mark.slow
def test_a_channel_that_is_stuck_is_named():
    duty, readings = clean()
    noise = np.random.default_rng(1).normal(0.0, 0.15, readings.shape)
    stuck = readings + noise
    stuck[ONSET + 1 :, 0] = stuck[ONSET + 1, 0]
    (cause, *_) = jt.diagnose(bench(), with_readings(stuck, duty)).causes
    assert cause.name == "stuck T1"


@pytest.mark.slow
def test_a_fault_that_ends_has_an_end():
    readings = clean()[1].copy()
    readings[500:600, 0] += 2.0
    readings += np.random.default_rng(1).normal(0.0, 0.15, readings.shape)
    cause = jt.diagnose(bench(), with_readings(readings, clean()[0])).causes[0]
    assert cause.name == "offset T1"
    assert cause.until == pytest.approx(600, abs=3)
    assert cause.best.lower <= 2.0 <= cause.best.upper


@pytest.mark.slow
def test_innovations_that_say_too_much_in_healthy_runs_count_less():
    """With an observer that takes readings for three times as exact as they are, healthy runs show
    by how much its statistics are too large."""
    exact = jt.ProcessNoise(reading=0.05, heat=0.003, disturbance=0.003, channel=0.01, common=0.01)
    one = suspects(bench())["gain T1"]
    healthy = [recording(seed=n) for n in (1, 2)]
    prior = learned([one], [jt.observe(bench(), run, exact) for run in healthy])
    assert np.asarray(prior.inflation)[0] > 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"faults": ["loosen H9"]}, "expected names of tclab, got 'loosen H9'; did you mean"),
        ({"faults": []}, "expected at least one, got none"),
    ],
)
def test_what_cannot_be_diagnosed_is_refused_in_a_sentence(
    arguments: dict[str, object], words: str
):
    given = {"experiment": recording(), **arguments}
    with pytest.raises(ObserverError, match=words):
        jt.diagnose(bench(), **given)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_a_short_recording_and_one_of_another_rig_are_refused():
    with pytest.raises(ObserverError, match="at least 240 s, in which an observer settles"):
        jt.diagnose(bench(), recording().between(0, 100))
    with pytest.raises(jt.errors.SimulationError):
        jt.diagnose(jt.Twin("single-cell"), recording())
