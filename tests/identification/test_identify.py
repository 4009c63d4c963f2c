"""A twin from a log alone, on a device whose network and values are known."""

from dataclasses import replace

import numpy as np
import pytest
from pot import pot_tables

import jaxtwin as jt
from jaxtwin import Experiment
from jaxtwin.errors import MatchError
from jaxtwin.identification._baselines import fit_first_order
from jaxtwin.identification._log import screened_log
from jaxtwin.identification._network import Family
from jaxtwin.rig import rig_from_tables

SCHEDULE = "0:0,200:1,800:0.2,1500:0.8,2300:0,2900:0.5,3300:0.9"


def recording(noise: float = 0.1, seed: int = 1) -> Experiment:
    """The readings of the device over an hour, every 10 s."""
    plan = Experiment.schedule(SCHEDULE, duration=3600, step=10.0, cells=1)
    run = jt.simulate(jt.Twin(rig_from_tables(pot_tables(), "pot")), plan)
    readings = run.temperatures + np.random.default_rng(seed).normal(0, noise, (361, 1))
    return Experiment(plan.time, plan.duty, channels=["water"], temperatures=readings, name="pot")


@pytest.fixture(scope="module")
def identified():
    return jt.identify(recording().between(None, 2600.0))


@pytest.mark.slow
def test_what_follows_is_predicted(identified):
    whole = recording()
    band = identified.predict(whole)
    later = whole.time >= 2600.0
    error = (band.middle - whole.temperatures)[later, 0]
    assert np.sqrt(np.mean(error**2)) < 0.5  # of a range of 40 K
    inside = (whole.temperatures > band.lower) & (whole.temperatures < band.upper)
    assert inside[later].mean() > 0.9
    assert (band.upper - band.lower)[later].mean() < 4.0


def test_the_ratios_of_the_device_come_back(identified):
    # All values are relative to 10 W, a thirtieth of the power.
    values = {name: float(value) for name, value in identified.fit.twin.values.items()}
    assert values["C_1"] == pytest.approx(900 / 30, rel=0.15)
    assert "a wall" in identified.candidates[0].structure or "a shell" in repr(identified)


def test_physics_beats_the_simple_models_here(identified):
    held_out = identified.candidates[0].held_out_rmse
    assert held_out < min(identified.baselines.values())
    assert held_out < 0.5


def test_the_rig_file_can_be_read_again(identified, tmp_path):
    path = tmp_path / "pot.toml"
    path.write_text(identified.rig.text)
    again = jt.load_rig(path)
    assert again.fingerprint == replace(identified.rig, source=again.source).fingerprint
    assert "jaxtwin identify" in again.text
    identified.fit.save(tmp_path / "fit.toml")
    assert jt.Fit.load(tmp_path / "fit.toml").rmse == pytest.approx(identified.fit.rmse)


def test_the_result_says_what_it_is(identified):
    text = identified.summary()
    assert identified.candidates[0].structure in text
    assert "first order with delay" in text
    assert "two capacities" in text
    assert "one recording" in text
    table = identified.to_dataframe()
    assert len(table) == len(identified.candidates)
    assert list(table["cost"].iloc[1:4]) == sorted(table["cost"].iloc[1:4])
    assert identified.to_dict()["structure"] == identified.candidates[0].structure
    assert "<table>" in identified._repr_html_()
    assert identified.plot().axes


@pytest.mark.slow
def test_the_next_recording_separates_the_rivals_within_a_limit(identified):
    plan = identified.next_recording(1800, highest=60)
    assert plan.duration == pytest.approx(1800)
    assert plan.duty.min() >= 0
    rivals = identified._rivals
    limit = np.array([60.0])
    designed = rivals.separation(plan, limit)
    usual = Experiment.schedule("0:0.3", duration=1800, step=6.0, cells=1)
    assert designed > rivals.separation(usual, limit) > 0
    assert identified.predict(plan).middle.max() < 61
    with pytest.raises(MatchError, match="highest: expected a temperature that a schedule keeps"):
        identified.next_recording(1800, highest=10)


def test_another_recording_of_the_device_is_predicted(identified):
    other = replace(recording(seed=2), name="another day")
    band = identified.predict(other)
    error = (band.middle - other.temperatures)[other.time > 60]
    assert np.sqrt(np.mean(error**2)) < 1.0


def with_duty(duty) -> Experiment:
    whole = recording()
    return Experiment(
        whole.time, duty, channels=whole.channels, temperatures=whole.temperatures, name="pot"
    )


def test_logs_from_which_nothing_can_be_learnt_are_refused():
    whole = recording()
    assert whole.temperatures is not None
    constant = np.full_like(whole.duty, 0.3)
    with pytest.raises(MatchError, match="pot: duty of P1: expected a duty that changes, got 0"):
        jt.identify(with_duty(constant))
    many = [f"T{number}" for number in range(9)]
    wide = replace(whole, channels=many, temperatures=np.tile(whole.temperatures, 9))
    with pytest.raises(MatchError, match="at most 8 channels, got 9; choose some by channels="):
        jt.identify(wide)
    with pytest.raises(MatchError, match="always change together"):
        jt.identify(with_duty(np.concatenate([whole.duty, whole.duty / 2], axis=1)))
    with pytest.raises(MatchError, match="duty of immersion heater: expected a name of letters"):
        jt.identify(replace(whole, cells=("immersion heater",)))
    with pytest.raises(MatchError, match="at least 60 readings of each channel, got 5"):
        jt.identify(whole.between(None, 50.0))
    still = replace(whole, temperatures=np.full_like(whole.temperatures, 20.0))
    with pytest.raises(MatchError, match="water: expected readings that move"):
        jt.identify(still)
    with pytest.raises(MatchError, match="expected temperatures, got none"):
        jt.identify(replace(whole, temperatures=None))
    with pytest.raises(MatchError, match="expected at least one, got none"):
        jt.identify([])


@pytest.mark.slow
def test_a_glitch_is_left_out_and_named():
    whole = recording()
    assert whole.temperatures is not None
    readings = whole.temperatures.copy()
    readings[100] = 85.0
    result = jt.identify(replace(whole, temperatures=readings))
    assert any("left out" in note and "water at 1000 s" in note for note in result.notes)
    assert result.fit.rmse < 0.3


@pytest.mark.slow  # a minute
def test_a_thermoelectric_cell_is_found_and_its_other_session_predicted():
    device = jt.Twin("single-cell")

    def session(schedule: str, seed: int) -> Experiment:
        plan = Experiment.schedule(schedule, duration=2400, step=4.0, cells=1)
        # Its columns have no names of the rig, as those of a stranger's log.
        run = jt.simulate(device, plan)
        readings = run.temperatures + np.random.default_rng(seed).normal(0, 0.1, (601, 1))
        return Experiment(plan.time, plan.duty, channels=["T"], temperatures=readings, name="cell")

    log = session("0:0,60:0.5,500:-0.4,900:0.3,1300:0.8,1700:-0.6,2100:0.2", 1)
    identified = jt.identify(log)
    other = session("0:0,100:-0.5,600:0.7,1200:0.1,1500:-0.3,1900:0.6", 2)
    assert other.temperatures is not None
    band = identified.predict(other)
    later = other.time > 60
    error = (band.middle - other.temperatures)[later]
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.ptp(other.temperatures)
    assert ((other.temperatures > band.lower) & (other.temperatures < band.upper))[
        later
    ].mean() > 0.9


@pytest.mark.slow
def test_actuators_keep_the_names_of_the_log_s_columns():
    named = replace(recording(), cells=("immersion",))
    identified = jt.identify(named)
    assert identified.rig.driven == ("immersion",)
    assert identified.predict(named).coverage[0] > 0.9


def test_inputs_that_cool_where_they_are_positive_are_cells_of_that_polarity():
    time = np.arange(0.0, 1200.0, 10.0)
    duty = np.where(time < 300, 0.0, np.where(time < 700, 0.5, -0.5))[:, None]
    readings = 20 - 8 * duty + 0.01 * np.sin(time)[:, None]
    log = screened_log(Experiment(time, duty, channels=["T"], temperatures=readings, name="cooler"))
    first = fit_first_order(duty, readings[:, 0], np.ones(len(time), bool), 10.0)
    family = Family.of(log, [first], None, False)
    assert family.cells == (0,)
    tables = family.tables(frozenset())
    assert tables["driver"]["polarity"] == -1
    assert [cell["name"] for cell in tables["cells"]] == ["P1"]
    assert not tables["heaters"]
