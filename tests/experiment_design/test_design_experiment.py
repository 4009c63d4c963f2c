"""The designed schedule is the best of all, and a match of its recording has the predicted errors.

The rig is the bundled single cell with few free parameters.
"""

import itertools
import json
import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import chi2
from small_results import fit

from jaxtwin import (
    Experiment,
    Fit,
    Rig,
    Twin,
    design_experiment,
    load_rig,
    match,
    match_many,
    read_recording,
    simulate,
    write_recording,
)
from jaxtwin._compilation import compiling_seconds
from jaxtwin.cli import run
from jaxtwin.data import data_folder
from jaxtwin.errors import MatchError
from jaxtwin.experiment_design import ExperimentDesign
from jaxtwin.experiment_design._design_experiment import _ScheduleSearch
from jaxtwin.experiment_design._experiment_design import PlannedSchedule
from jaxtwin.experiment_design._information import (
    NoisePrediction,
    PriorInformation,
    make_design_problem,
)
from jaxtwin.experiment_design._schedules import make_schedules
from jaxtwin.experiment_design._search import random_schedules

TRUTH = {"C_load": 24.0, "R_loss": 6.0, "R_Th": 1.7, "T_amb": 20.0, "T_start": 18.5}
FREE = list(TRUTH)
NOISE = 0.05
SETTINGS: dict[str, Any] = {"duration": 240, "hold": 40, "bounds": (-0.6, 0.6), "levels": 3}


def recorded(drive: Experiment, seed: int) -> Experiment:
    """A recording of the true rig with white noise."""
    seen = simulate(Twin("single-cell", TRUTH), drive).temperatures
    seen = seen + NOISE * np.random.default_rng(seed).standard_normal(seen.shape)
    return Experiment(
        drive.time, drive.duty, channels=drive.channels, temperatures=seen, name=f"bench {seed}"
    )


BUNDLED = data_folder() / "rigs" / "single-cell.toml"
STEPS = Experiment.schedule("0:0.4,300:-0.3", duration=600, channels=("T",))


@pytest.fixture(scope="module")
def fitted() -> Fit:
    return match(Twin("single-cell"), recorded(STEPS, 0), free=FREE)


@pytest.fixture(scope="module")
def design(fitted: Fit) -> ExperimentDesign:
    return design_experiment(fitted, **SETTINGS)


def rig_with_free(folder: Path, names: Iterable[str], *changes: tuple[str, str]) -> Rig:
    """The single cell with only these parameters free."""
    text = BUNDLED.read_text(encoding="utf-8")
    for old, new in changes:
        text, count = re.subn(old, new, text, flags=re.MULTILINE)
        assert count, old
    text = text.replace("free = true", "free = false")
    for name in names:
        text = re.sub(rf"^({name} = .*)free = false", r"\1free = true", text, flags=re.MULTILINE)
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


@pytest.mark.slow
def test_information_on_a_cooling_block_is_that_of_an_exponential(tmp_path: Path):
    """A block without a cell, 40 K above the room, that cools through R: the reading is
    g Delta exp(-t / RC), its derivative with respect to log R is that times t / RC. A match
    weights it as if its noise, of 0.25 K with an autocorrelation time of 64 s, were independent."""
    rig = rig_with_free(
        tmp_path,
        ["R_loss"],
        (r'contacts = \{ V11 = "R_pc" \}', 'contacts = { V11 = "1e5 K/W" }'),
        (r'^film_exponent = "n_film"\n', ""),
        (r"^(n_film|R_pc) = .*\n", ""),
    )
    twin = Twin(rig, {"T_amb": 20.0, "T_start": 60.0, "T_sink": 20.0})
    design = design_experiment(twin, duration=300, hold=150, levels=2)
    time, constant = np.arange(301.0), 5.0 * 30.0
    slope = 0.95 * 40 * time / constant * np.exp(-time / constant)
    prior, variance = 1.5**-2, 0.25**2
    normal = prior + slope @ slope / (64 * variance)
    noise = variance * toeplitz((63 / 65) ** time)
    meat = prior + slope @ noise @ slope / (64 * variance) ** 2
    expected = 5.0 * np.sqrt(meat) / normal
    assert design.best.standard_errors["R_loss"] == pytest.approx(expected, rel=1e-3)
    assert design.standard_errors["R_loss"] == pytest.approx(5.0 * 1.5, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [pytest.param("D", marks=pytest.mark.long), "A"])
def test_the_search_finds_the_best_of_all_schedules(tmp_path: Path, criterion: Any):
    """All 27 schedules of three steps and three levels, by finite differences of `simulate`."""
    names, bounds = ["C_load", "R_loss"], (-0.5, 0.5)
    twin = Twin(rig_with_free(tmp_path, names))
    design = design_experiment(
        twin, duration=180, hold=60, bounds=bounds, levels=3, criterion=criterion
    )
    time, counts = np.arange(181.0), 255
    white = 0.25**2 * 64
    noise = 0.25**2 * toeplitz((63 / 65) ** time)
    spreads = np.array([twin.rig.parameters[name].prior_spread for name in names], float)

    def objective(duty: np.ndarray) -> float:
        drive = Experiment(time, duty[np.minimum(time // 60, 2).astype(int)], channels=("T",))
        slopes = np.stack([log_slope(twin, drive, name) for name in names])
        prior = np.diag(spreads**-2.0)
        inverse = np.linalg.inv(prior + slopes @ slopes.T / white)
        covariance = inverse @ (prior + slopes @ noise @ slopes.T / white**2) @ inverse
        scaled = covariance / np.outer(spreads, spreads)
        return float(np.linalg.det(scaled) if criterion == "D" else np.trace(scaled))

    levels = np.rint(np.linspace(*bounds, 3) * counts) / counts
    all_ = [np.array(steps)[:, None] for steps in itertools.product(levels, repeat=3)]
    best = min(map(objective, all_))
    found = objective(design.best.counts / counts)
    assert found == pytest.approx(best, rel=1e-3)
    power = 1 / 4 if criterion == "D" else 1 / 2
    size = 1 if criterion == "D" else 2
    assert design.best.mean_error == pytest.approx((found / size) ** power, rel=1e-3)


def log_slope(twin: Twin, drive: Experiment, name: str) -> np.ndarray:
    """The derivative of the reading with respect to the logarithm of a parameter."""
    value, step = float(twin.values[name]), 1e-3
    up, down = (
        simulate(twin.with_values({name: value * np.exp(way)}), drive).temperatures[:, 0]
        for way in (step, -step)
    )
    return (up - down) / (2 * step)


@pytest.mark.slow
def test_what_is_known_today_are_the_errors_of_the_fit(fitted: Fit, design: ExperimentDesign):
    assert design.names == ("C_load", "R_loss", "R_Th")
    for name in design.names:
        assert design.standard_errors[name] == pytest.approx(fitted[name].standard_error, rel=1e-4)


@pytest.mark.slow
def test_the_design_is_better_than_what_it_is_compared_with(design: ExperimentDesign):
    assert set(design.references) == {"bench 0", "PRBS"}
    for reference in design.references.values():
        assert design.best.mean_error < reference.mean_error < 1
    errors = [step.mean_error for step in design.history]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(design.best.mean_error)


@pytest.mark.long
def test_matches_of_designed_recordings_err_as_predicted(design: ExperimentDesign):
    """Sixteen times both recordings with other noise. The squared errors in units of the predicted
    ones have a chi-squared distribution with as many degrees of freedom as there are matches."""
    sets = [
        [recorded(STEPS, seed), recorded(design.schedule, 1000 + seed)] for seed in range(1, 17)
    ]
    fits = match_many(Twin("single-cell"), sets, free=FREE)
    for name in design.names:
        found = np.array([fit[name].value for fit in fits if fit is not None])
        assert len(found) == len(sets)
        deviations = np.log(found / TRUTH[name])
        row = design.to_dataframe().loc[name]
        predicted = row["designed"] / row["value"]
        total = np.sum((deviations / predicted) ** 2)
        assert chi2.ppf(1e-3, len(found)) < total < chi2.ppf(1 - 1e-3, len(found))


@pytest.mark.slow
def test_other_schedules_and_settings_compile_nothing(fitted: Fit, design: ExperimentDesign):
    assert design is not None
    before = compiling_seconds()
    again = design_experiment(fitted, **SETTINGS | {"seed": 3, "criterion": "A"})
    assert compiling_seconds() == before
    assert again.criterion == "A"


@pytest.mark.slow
def test_the_schedule_is_quantised_and_can_be_written_and_driven(
    design: ExperimentDesign, tmp_path: Path
):
    schedule = design.schedule
    np.testing.assert_array_equal(np.rint(schedule.duty * 255), schedule.duty * 255)
    assert np.abs(schedule.duty).max() <= 0.6
    assert schedule.duration == 240
    assert np.all(schedule.switch_times % 40 == 0)
    back = read_recording(design.save(tmp_path / "plan.csv"))
    assert back == schedule
    words = Experiment.schedule(design.text, duration=240, channels=("T",))
    np.testing.assert_allclose(words.duty, schedule.duty, atol=1e-6)


@pytest.mark.slow
def test_schedules_that_get_too_hot_are_left_out(fitted: Fit, design: ExperimentDesign):
    """The limit is 110 degC; a larger margin stands for a lower limit."""
    hottest = design.best.highest_reading
    margin = 110.0 - hottest + 3.0
    cooler = design_experiment(fitted, **SETTINGS, margin=margin)
    assert cooler.best.is_allowed
    assert cooler.best.highest_reading <= hottest - 3.0
    assert cooler.best.mean_error >= design.best.mean_error
    run = simulate(fitted.mean_twin, cooler.schedule)
    assert run.temperatures.max() == pytest.approx(cooler.best.highest_reading, abs=0.05)
    with pytest.raises(MatchError, match="expected a schedule whose readings stay below"):
        design_experiment(fitted, **SETTINGS, margin=100)


@pytest.mark.slow
def test_a_loaded_fit_gives_the_same_design(fitted: Fit, design: ExperimentDesign, tmp_path: Path):
    fitted.save(tmp_path / "fit.toml")
    loaded = design_experiment(Fit.load(tmp_path / "fit.toml"), **SETTINGS)
    np.testing.assert_array_equal(loaded.best.counts, design.best.counts)
    assert loaded.best.mean_error == pytest.approx(design.best.mean_error, rel=1e-6)
    assert set(loaded.references) == {"PRBS"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 4000}, "duration: expected above 0 and at most 3600 s"),
        ({"hold": 50}, "hold: expected a time that divides"),
        ({"hold": 0.5}, "hold: expected a multiple of the 1 s"),
        ({"bounds": (0.5, 0.2)}, "bounds: expected the lowest and the highest"),
        ({"bounds": (0.5, 0.5005)}, "bounds: expected at least two of the driver's 255 counts"),
        ({"levels": 1}, "levels: expected a whole number"),
        ({"names": ["T_amb"]}, "names: expected some of the matched parameters C_load"),
        ({"group": "Monday"}, "group: expected one of"),
        ({"starts": 0}, "starts: expected a whole number"),
    ],
)
def test_what_does_not_fit_is_refused(fitted: Fit, settings: dict[str, Any], message: str):
    with pytest.raises(MatchError, match=message):
        design_experiment(fitted, **SETTINGS | settings)


@pytest.mark.parametrize("rig", ["single-cell", "dual-cell"])
def test_before_any_match_a_twin_is_known_as_its_priors_say(rig: str):
    """Each free parameter once, also those that differ between groups of recordings."""
    twin = Twin(rig)
    prior = PriorInformation.of_twin(twin)
    rows = {row.name: row for row in prior.unknowns.entry_parameters}
    assert len(rows) == prior.unknowns.size
    assert set(rows) == {name for name, row in twin.rig.parameters.items() if row.free}
    deviations = np.array([row.standard_deviation for row in rows.values()], float)
    np.testing.assert_allclose(np.sqrt(np.diag(prior.covariance())), deviations, rtol=1e-4)


@pytest.mark.slow
def test_each_schedule_is_assessed_in_its_place():
    """In batches of four, with two left over, as by itself."""
    twin = Twin("single-cell")
    prior = PriorInformation.of_twin(twin)
    schedules = make_schedules(
        twin, duration=120, hold=60, bounds=(-0.4, 0.4), levels=5, interval=10.0
    )
    problem = make_design_problem(prior, schedules, NoisePrediction.of(twin), ())
    search = _ScheduleSearch(prior, schedules, problem, "D", np.array([0, 1]), 0.0)
    counts = random_schedules(schedules, 5, seed=0)
    found = search.assess(counts)
    assert [candidate.counts.tolist() for candidate in found] == [c.tolist() for c in counts]
    (last,) = search.assess(counts[-1:])
    assert found[-1].objective == pytest.approx(last.objective, rel=1e-12)
    assert len({candidate.objective for candidate in found}) > 1
    assert search.evaluations == len(counts) + 1


@pytest.mark.parametrize(("hold", "is_multiple"), [(40.0, True), (60.0, True), (30.0, False)])
def test_a_level_is_held_for_whole_sample_intervals(hold: float, is_multiple: bool):
    arguments: dict[str, Any] = {"duration": 120.0, "bounds": (0.0, 0.8), "levels": 2}
    make = partial(make_schedules, Twin("single-cell"), hold=hold, interval=20.0, **arguments)
    if is_multiple:
        assert make().steps == 120 / hold
    else:
        with pytest.raises(MatchError, match="hold: expected a multiple of the 20 s"):
            make()


@pytest.mark.slow
def test_a_fit_whose_parameters_all_ended_at_bounds_is_refused():
    with pytest.raises(MatchError, match="parameter of the rig that is not at a bound, got none"):
        design_experiment(fit(), duration=20, hold=10)


@pytest.mark.slow
def test_the_command_writes_a_plan_a_table_and_a_picture(
    fitted: Fit,
    design: ExperimentDesign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    fitted.save("fit.toml")
    write_recording(fitted.experiments[0], "bench.csv")
    command = [
        "design",
        "single-cell",
        "bench.csv",
        "--parameters",
        "fit.toml",
        "--out",
        "plan.csv",
    ]
    settings = ["--duration", "240", "--hold", "40", "--levels", "3"]
    more = ["--plot", "plan.png", "--json", "plan.json"]
    assert run([*command, *settings, *more, "--bounds=-0.6:0.6"]) == 0
    shown = capsys.readouterr().out
    assert design.text in shown
    assert "PRBS" in shown
    gained = f"errors {100 * design.best.mean_error:.3g} % of today's"
    assert f"{gained} (D-optimal; " in shown
    assert read_recording("plan.csv") == design.schedule
    numbers = json.loads(Path("plan.json").read_text())
    assert numbers["schedule"] == design.text
    assert numbers["mean_error"]["designed"] == pytest.approx(design.best.mean_error, rel=1e-6)
    assert Path("plan.png").read_bytes().startswith(b"\x89PNG")
    assert run([*command, "--bounds", "low"]) == 2
    assert "--bounds: expected LOW:HIGH" in capsys.readouterr().err


def test_the_text_of_a_schedule_has_each_of_its_duty_cycles():
    """Also where the duty changes at every sample."""
    drive = Experiment([0.0, 1.0, 2.0, 3.0], [[0.1], [0.2], [-0.3], [-0.3]], channels=("T",))
    counts = np.array([[26], [51], [-77]])
    planned = PlannedSchedule("designed", drive, counts, {}, 1.0, 30.0, 40.0, True)
    found = ExperimentDesign("made", "D", (), (), (), {}, planned, {}, 1.0, ())
    assert found.text == "0:0.1,1:0.2,2:-0.3"
