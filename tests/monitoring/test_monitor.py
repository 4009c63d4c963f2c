"""What a monitor finds in runs of a small rig, and what it leaves alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from faulty_runs import LENGTH, ONSET, SIZE, bench, clean, recording, with_readings

from jaxtwin import Experiment, ProcessNoise, calibrate_monitor, monitor
from jaxtwin.errors import ObserverError
from jaxtwin.live import Finding
from jaxtwin.monitoring import FindingLog, MonitorCalibration, Monitored, ObservedSample
from jaxtwin.monitoring._evidence import observed_sample
from jaxtwin.monitoring._monitor import SETTLE, run
from jaxtwin.monitoring._state_test import StateTest
from jaxtwin.monitoring._thresholds import DAY, FAMILIES, nominal_calibration
from jaxtwin.observers import live_observer


def watched(readings: np.ndarray) -> Monitored:
    """A run with these readings beside their noise."""
    duty, _ = clean()
    noise = np.random.default_rng(7).normal(0.0, SIZE, readings.shape)
    return monitor(bench(), with_readings(readings + noise, duty))


def first(found: Monitored, kind: str, channel: str) -> Finding:
    return next(one for one in found.findings if (one.kind, one.channel) == (kind, channel))


@pytest.fixture(scope="module")
def healthy() -> list[Monitored]:
    return [monitor(bench(), recording(seed=seed)) for seed in range(4)]


def test_starts_and_changes_of_the_command_raise_nothing(healthy: list[Monitored]):
    assert [one.findings for one in healthy] == [[]] * 4
    assert "nothing found" in healthy[0].summary()


def test_missing_frames_raise_nothing():
    readings = clean()[1].copy()
    readings[200:330, 0] = np.nan
    readings[600:660] = np.nan
    assert watched(readings).findings == []


def test_a_correction_of_all_channels_raises_nothing():
    readings = clean()[1].copy()
    readings[400:] += 1.0 * np.exp(-np.arange(LENGTH + 1 - 400) / 3)[:, None]
    assert watched(readings).findings == []


@pytest.mark.parametrize(
    ("fault", "within"),
    [
        (("gain", "T1", 0.9), 60.0),
        (("fail", "H1", 1.0), 120.0),
        (("loosen", "H2", 3.0), 120.0),
    ],
)
def test_a_fault_is_found_soon_after_its_onset(fault: tuple[str, str, float], within: float):
    found = monitor(bench(), recording(*fault))
    soonest = min(found.alarms, key=lambda one: one.found or 0)
    assert soonest.found is not None
    assert ONSET < soonest.found <= ONSET + within
    assert soonest.since is not None
    assert abs(soonest.since - ONSET) < within
    assert soonest.probability is not None
    assert soonest.probability > 0.5


def test_a_dead_cell_is_taken_in_by_the_observer_and_found_there():
    # Its unexplained heat is the whole heat of the cell, with the sign of a loss.
    found = monitor(bench(), recording("fail", "H1", 1.0))
    heat = first(found, "implausible", "H1")
    assert heat.unit == "W"
    assert heat.size is not None
    assert heat.size < 0
    assert "unexplained" in heat.detail


def test_a_channel_that_stands_still_is_frozen():
    duty, readings = clean()
    noise = np.random.default_rng(7).normal(0.0, SIZE, readings.shape)
    stuck = readings + noise
    stuck[ONSET:, 0] = stuck[ONSET, 0]
    frozen = first(monitor(bench(), with_readings(stuck, duty)), "frozen", "T1")
    assert frozen.since == pytest.approx(ONSET)
    assert frozen.until is None


def test_a_channel_that_drifts_is_named_with_the_sign_of_its_drift():
    readings = clean()[1].copy()
    readings[ONSET:, 1] += 0.02 * np.arange(LENGTH + 1 - ONSET)
    drift = first(watched(readings), "drift", "T2")
    assert drift.size is not None
    assert drift.size > 0.5


def test_a_reading_at_the_room_at_full_duty_has_gone():
    duty, readings = (one.copy() for one in clean())
    duty[ONSET:] = 1.0
    readings[ONSET:] = 23.0
    noise = np.random.default_rng(7).normal(0.0, SIZE, readings.shape)
    found = monitor(bench(), with_readings(readings + noise, duty))
    assert {one.channel for one in found.findings if one.kind == "gone"} == {"T1", "T2"}
    late = first(found, "gone", "T1").found
    assert late is not None
    assert late > ONSET + 100  # what the heaters would need to show


def test_a_finding_clears_when_its_cause_is_over():
    readings = clean()[1].copy()
    readings[400:460, 1] += 3.0
    found = watched(readings)
    assert found.alarms
    assert all(one.until is not None and one.until < 700 for one in found.findings)


@pytest.mark.slow
def test_the_steps_of_several_recordings_run_side_by_side(healthy: list[Monitored]):
    several = [samples_of(one) for one in healthy[:2]]
    made = healthy[0].monitor
    with jax.enable_x64(True):
        both = jax.tree.map(lambda *leaves: np.stack(leaves), *several)
        found = jax.vmap(lambda one: run(made, one))(both)
    np.testing.assert_allclose(found.sum.score[1], healthy[1].evidences.sum.score, atol=1e-9)


def samples_of(found: Monitored):
    observed = found.observed
    with jax.enable_x64(True):
        dt = np.diff(observed.time, prepend=observed.time[0])
        return jax.tree.map(
            np.asarray,
            observed_sample(
                observed.filtered.states, observed.filtered.expected,
                np.asarray(observed.experiment.temperatures), observed.samples.ambient, dt,
            ),
        )  # fmt: skip


@pytest.mark.slow
def test_the_calibration_of_healthy_runs_has_a_tail_from_each_source():
    runs = [recording(seed=seed, name=f"run {seed}") for seed in range(10, 13)]
    found = calibrate_monitor(bench(), runs, hours=0.6)
    assert {tail.source for tail in found.tails["sum"]} == {"recordings", "simulations"}
    assert all(0.6 < scale < 1.6 for scale in found.scales.values())
    limits = found.for_seconds(30 * DAY)
    assert set(limits) == set(FAMILIES)
    assert monitor(bench(), recording(seed=20), calibration=found).findings == []
    hurt = monitor(bench(), recording("gain", "T1", 0.85), calibration=found)
    assert {one.channel for one in hurt.alarms if one.kind == "sudden"} >= {"T1"}
    table = hurt.thresholds()
    assert (table.days_lower <= table.days).all() or table.days_lower.isna().any()


def test_the_jump_of_one_error_alone_counts_and_that_of_several_does_not():
    errors = np.zeros((300, 2))
    errors[200:, 1] = 0.7  # 3.5 of its standard deviations, but 11 of those of such a jump
    alone = said_of_errors(errors)
    assert alone[200, 1] == pytest.approx(0.7 / (0.2 * np.sqrt(20 / 190)), rel=1e-6)
    assert alone[:, 0].max() == 0
    errors[200:, 0] = -0.7
    assert said_of_errors(errors).max() == pytest.approx(3.5)


def said_of_errors(errors: np.ndarray) -> np.ndarray:
    """The scores of the errors of both channels, with thresholds of 1."""
    noise = ProcessNoise(channel=0.2, channel_time=170.0)
    model = live_observer(bench(), noise).model
    test = StateTest(model, np.zeros(0, int), np.ones(2))
    means = np.zeros((len(errors), model.layout.size))
    means[:, model.layout.of("channels")] = errors
    none = np.zeros(2)

    def take(state, mean):
        sample = ObservedSample(none, none, none, mean, none, none, np.nan, 1.0)
        after, (_, found) = test.step(state, sample, jnp.ones(()), jnp.asarray(True))
        return after, found.score

    with jax.enable_x64(True):
        return np.asarray(jax.lax.scan(take, test.init(), jnp.asarray(means))[1])


@pytest.mark.parametrize("reading", [-127.0, 0.0, 85.0, 9999.0])
def test_one_impossible_reading_is_one_notice(reading: float):
    healthy = recording()
    readings = np.array(healthy.temperatures)
    readings[300, 0] = reading
    (finding,) = monitor(bench(), replace(healthy, temperatures=readings)).findings
    assert (finding.kind, finding.channel, finding.severity) == ("impossible", "T1", "notice")
    assert (finding.since, finding.found) == (healthy.time[300], healthy.time[301])
    assert finding.detail.startswith("one impossible reading of T1, ")
    assert finding.size == pytest.approx(reading - readings[299, 0], rel=0.05)


def test_a_recording_that_is_too_short_is_refused():
    with pytest.raises(
        ObserverError, match=f"bench: expected a recording of at least {2 * SETTLE:g}"
    ):
        monitor(bench(), recording().between(0, 100))
    with pytest.raises(ObserverError, match="expected a recording of at least"):
        calibrate_monitor(bench(), recording().between(0, 100))


def test_false_alarms_more_often_than_hourly_are_refused():
    with pytest.raises(ObserverError, match="false_alarm_time: expected at least 3600 s"):
        monitor(bench(), recording(), false_alarm_time=60.0)


def test_a_calibration_of_another_rig_is_refused():
    other = nominal_calibration(("T",), 1.0)
    with pytest.raises(ObserverError, match="expected the channels T1, T2, got T"):
        monitor(bench(), recording(), calibration=other)


def test_a_table_and_json_have_each_finding(healthy: list[Monitored]):
    found = monitor(bench(), recording("gain", "T1", 0.9))
    table = found.to_dataframe()
    assert len(table) == len(found.findings) > 0
    assert table.loc[0, "found_s"] == found.findings[0].found
    content = found.to_dict()
    assert content["alarms"] == len(found.alarms)
    assert [one["kind"] for one in content["findings"]] == list(table.kind)
    assert len(content["thresholds"]) == len(FAMILIES)
    assert healthy[0].to_dict()["findings"] == []
    assert isinstance(found.calibration, MonitorCalibration)
    assert isinstance(found.experiment, Experiment)
    assert isinstance(FindingLog(found.monitor, found.calibration, DAY).present, tuple)
