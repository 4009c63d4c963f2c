"""A gap is not the end of a recording: matches of recordings with lost rows, moved clocks, uneven
times and shared samples, compared with the match of the whole recording."""

from functools import cache

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.matching._recordings import check_distinct

FREE = ["R_1", "R_2", "C_1", "C_2", "T_amb", "T_start"]
TRUTH = {"T_amb": 22.0, "T_start": 22.0}


@cache
def whole() -> jt.Experiment:
    plan = jt.Experiment.schedule("0:0.5/0.6,300:0.8/0.3,600:0.3/0.8", duration=900, cells=2)
    return jt.simulate(jt.Twin("tclab").with_values(TRUTH), plan).to_recording(seed=1, name="r")


def rows_of(rows: np.ndarray, jump: float = 0.0, name: str = "r") -> jt.Experiment:
    of = whole()
    time = of.time + jump * (of.time >= 450)
    readings = np.asarray(of.temperatures)[rows]
    return jt.Experiment(
        time[rows], of.duty[rows], channels=of.channels, temperatures=readings, name=name
    )


@cache
def error_of_whole() -> float:
    return jt.match(jt.Twin("tclab"), whole(), free=FREE)["R_1"].standard_error


@pytest.mark.parametrize(
    ("rows", "jump", "wider"),
    [
        (np.r_[0:400, 403:901], 0.0, 1.1),
        (np.r_[0:901], 2.6e6, 1.1),
        (np.r_[0:300, 300:901:10], 0.0, 4.0),
        (np.r_[0:600:10, 600:901], 0.0, 4.0),
        (np.unique(np.random.default_rng(3).choice(901, 200, replace=False)), 0.0, 4.0),
    ],
)
def test_a_match_goes_on_behind_gaps(rows: np.ndarray, jump: float, wider: float):
    fit = jt.match(jt.Twin("tclab"), rows_of(rows, jump), free=FREE)
    assert fit.recordings == ("r",)
    assert fit["R_1"].value == pytest.approx(60.0, abs=4 * fit["R_1"].standard_error)
    assert fit["R_1"].standard_error < wider * error_of_whole()
    assert fit.rmse < 0.2
    assert "r: the duty is held over" in fit.summary() or "the clock was moved" in fit.summary()


def test_parts_begin_in_the_state_that_the_duty_has_left():
    """With one temperature for all nodes at the start of the second part the RMSE is 2.2 K."""
    fit = jt.match(jt.Twin("tclab"), rows_of(np.r_[0:400, 403:901]), free=FREE, gaps="split")
    assert fit.recordings == ("r part 1", "r part 2")
    assert fit.rmse < 0.2
    assert fit["R_1"].value == pytest.approx(60.0, abs=4 * fit["R_1"].standard_error)


def test_a_group_is_that_of_all_its_parts():
    recording = rows_of(np.r_[0:400, 403:901])
    fit = jt.match(jt.Twin("tclab"), recording, free=FREE, gaps="split", groups=["monday"])
    assert set(fit.groups.values()) == {"monday"}


@pytest.mark.parametrize(
    "part",
    [
        lambda of: of.between(100, 500),
        lambda of: of.between(100, 500).select(["T1"]),
        lambda of: rows_of(np.r_[0:901:7], name="p"),
        lambda of: jt.Experiment(
            np.arange(400.0),
            of.duty[100:500],
            channels=of.channels,
            temperatures=of.temperatures[100:500],
            name="p",
        ),
    ],
)
def test_a_part_beside_the_whole_is_refused(part):
    of = whole()
    for pair in ({"a": of, "p": part(of)}, {"p": part(of), "a": of}):
        with pytest.raises(
            jt.errors.MatchError, match=r"experiments: \d+ samples of \w are those of \w"
        ):
            check_distinct(pair)


def test_parts_that_overlap_are_refused():
    of = whole()
    with pytest.raises(jt.errors.MatchError, match="experiments: 100 samples of b are those of a"):
        check_distinct({"a": of.between(None, 500), "b": of.between(400, None)})


def test_what_shares_no_sample_is_not_refused():
    of = whole()
    first = jt.Experiment(
        of.time, of.duty, channels=["T1"], temperatures=np.asarray(of.temperatures)[:, 0]
    )
    second = jt.Experiment(
        of.time, of.duty, channels=["T2"], temperatures=np.asarray(of.temperatures)[:, 1]
    )
    check_distinct({"a": of.between(None, 450), "b": of.between(450, None)})
    check_distinct({"a": first, "b": second})


def test_two_runs_that_begin_alike_are_two():
    """Without noise they are equal until the duty differs."""
    twin = jt.Twin("tclab")
    runs = [
        jt.simulate(
            twin, jt.Experiment.schedule(f"0:0.5/0.5,300:{duty}/0.1", duration=600, cells=2)
        )
        for duty in (0.1, 0.9)
    ]
    check_distinct({str(k): run.to_recording(noise=0.0) for k, run in enumerate(runs)})


HOT_BLOCK = """
format = 1
name = "block"
ambient = { temperature = "T_room" }
sensors = { noise = "0.1 K" }
channels = [{ name = "T", nodes = ["block"] }]
heaters = [{ name = "H", power = "50 W", contacts = ["block"] }]
bodies = [{ name = "block", capacitance = "C", initial_temperature = "T_start" }]
links = [{ resistance = "R", between = ["block-ambient"] }]
[parameters]
C = { value = 200.0, unit = "J/K", bounds = [10.0, 5000.0], free = true }
R = { value = 5.0, unit = "K/W", bounds = [0.1, 100.0], free = true }
[parameters.T_room]
value = 22.0
unit = "degC"
bounds = [5.0, 40.0]
prior = { spread = 3.0 }
free = true
scope = "recording"
[parameters.T_start]
value = 22.0
unit = "degC"
bounds = [0.0, 400.0]
free = true
scope = "recording"
"""


def test_a_body_with_its_own_start_may_begin_hot(tmp_path):
    file = tmp_path / "block.toml"
    file.write_text(HOT_BLOCK, encoding="utf-8")
    twin = jt.Twin(jt.load_rig(file))
    plan = jt.Experiment.schedule("0:0.2,900:0.6", duration=1800, step=10)
    hot = jt.simulate(twin.with_values({"T_start": 150.0}), plan).to_recording(seed=1)
    fit = jt.match(twin, hot)
    assert fit.mean_fit_percent > 99
    with pytest.raises(
        jt.errors.MatchError, match="start within the bounds of T_start, 0 to 40 degC"
    ):
        jt.match(twin, hot, bounds={"T_start": (0.0, 40.0)})


def test_a_channel_at_the_end_of_its_range_is_named():
    of = whole()
    readings = np.minimum(np.asarray(of.temperatures), 40.0)
    recording = jt.Experiment(
        of.time, of.duty, channels=of.channels, temperatures=readings, name="r"
    )
    lines = " ".join(jt.match(jt.Twin("tclab"), recording, free=FREE).summary().split())
    assert "r: T1 stands at its highest value, 40 degC, in 766 of 901 samples" in lines
    assert "stands at" not in jt.match(jt.Twin("tclab"), of, free=FREE).summary()


@pytest.mark.parametrize("code", [-127.0, 999.9, 1372.0])
def test_readings_that_no_part_of_the_rig_can_have_are_named(code: float):
    """A DS18B20 that is not there, and thermocouples beyond their range."""
    of = whole()
    readings = np.array(of.temperatures)
    readings[[400, 700], 1] = code
    recording = jt.Experiment(
        of.time, of.duty, channels=of.channels, temperatures=readings, name="r"
    )
    lines = " ".join(jt.match(jt.Twin("tclab"), recording, free=FREE).summary().split())
    assert f"r: T2: 2 readings, the first {code:g} degC at 400 s, are beyond" in lines


@pytest.mark.parametrize("resolution", [0.0625, 0.25, 0.5])
def test_a_coarse_sensor_that_settles_is_not_at_the_end_of_its_range(resolution: float):
    """A first-order response to a step, read by a sensor of that resolution."""
    from jaxtwin.matching._recording_notes import recording_notes

    time = np.arange(0, 3000.0)
    for noise in (0.0, 0.05):
        readings = 21 + 40 * (1 - np.exp(-np.maximum(time - 300, 0) / 300))
        readings += np.random.default_rng(1).normal(0, noise, time.shape) if noise else 0
        coarse = resolution * np.round(readings / resolution)
        recording = jt.Experiment(time, 0.5 * (time > 300), channels=["T"], temperatures=coarse)
        assert recording_notes(recording, jt.Twin("tclab")) == []
