"""A saved fit comes back whole, and a damaged file says what is wrong with it."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import (
    Experiment,
    Fit,
    Twin,
    load_rig,
    match,
    prediction_band,
    profile,
    read_parameters,
    simulate,
    validate,
)
from jaxtwin.errors import MatchError, ParameterError
from jaxtwin.matching import FittedParameters, Huber, Noise
from jaxtwin.matching._fit import solution_of

FREE = ["C_load", "R_E", "T_amb"]
TRUTH = {"C_load": 24.0, "R_E": 1.9}
NAMES = ("monday", 'tuesday "2".\n')


def recording(ambient: float, seed: int, name: str) -> Experiment:
    drive = Experiment.schedule("0:0.4,60:-0.3", duration=120, step=2.0, channels=("T",))
    seen = simulate(Twin("single-cell", {**TRUTH, "T_amb": ambient}), drive).temperatures
    seen = seen + 0.05 * np.random.default_rng(seed).standard_normal(seen.shape)
    seen[10] += 3.0
    return Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen, name=name)


@pytest.fixture(scope="module")
def recordings() -> list[Experiment]:
    return [recording(20.0, 0, NAMES[0]), recording(23.0, 1, NAMES[1])]


@pytest.fixture(scope="module")
def fit(recordings: list[Experiment]) -> Fit:
    """With weights by masks and by the robust loss, bounds of its own, and a value at one."""
    return match(
        Twin("single-cell"),
        recordings,
        free=FREE,
        bounds={"R_E": (1.95, 8.0)},
        masks={"monday": [(30.0, 40.0, 0.5)]},
        loss=Huber(2.0),
        starts=2,
        max_iterations=12,
    )


@pytest.fixture(scope="module")
def saved(fit: Fit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fit") / "fit.toml"
    fit.save(path)
    return path


def same(fit: Fit, other: Fit) -> None:
    """All that a fit holds beside its recordings."""
    for name in ("recordings", "fingerprints", "channels", "recording_values", "rmse", "status"):
        assert getattr(fit, name) == getattr(other, name)
    for name in ("converged", "optima", "wall_time", "solver_gap", "noise", "cost"):
        assert getattr(fit, name) == getattr(other, name)
    assert (fit.date, fit.versions) == (other.date, other.versions)
    # NaN is the same as NaN here.
    assert str(fit.fit_percent) == str(other.fit_percent)
    assert str(fit.history) == str(other.history)
    assert str(fit.parameters) == str(other.parameters)
    assert fit.twin.values == other.twin.values
    mine, theirs = solution_of(fit), solution_of(other)
    np.testing.assert_allclose(mine.vector, theirs.vector, rtol=1e-14)
    for field in fields(fit.uncertainty):
        mine, theirs = (getattr(result.uncertainty, field.name) for result in (fit, other))
        if isinstance(mine, np.ndarray):
            np.testing.assert_allclose(mine, theirs, rtol=1e-13)
        else:
            assert str(mine) == str(theirs)
    for name in fit.recordings:
        np.testing.assert_array_equal(fit.weights[name], other.weights[name])
    assert fit.events == other.events
    mine, theirs = solution_of(fit).problem, solution_of(other).problem
    assert mine.unknowns == theirs.unknowns
    assert (mine.common_error, mine.loss) == (theirs.common_error, theirs.loss)
    assert mine.twin.values == theirs.twin.values
    assert fit.summary() == other.summary()


@pytest.mark.slow
def test_a_saved_fit_comes_back_whole(fit: Fit, saved: Path):
    loaded = Fit.load(saved)
    same(fit, loaded)
    assert loaded["R_E"].at_bound
    assert loaded["C_load"].standard_error == fit["C_load"].standard_error
    assert {name: float(twin.values["T_amb"]) for name, twin in loaded.twins.items()} == {
        name: fit.recording_values[name]["T_amb"] for name in NAMES
    }


number = st.floats(0, 1e9)
anything = st.floats(allow_nan=True, allow_infinity=True)
percent = st.floats(-1e9, 100) | st.just(float("nan"))


@pytest.mark.slow
@settings(max_examples=30)
@given(data=st.data())
def test_any_fit_comes_back_whole(fit: Fit, tmp_path_factory: pytest.TempPathFactory, data):
    """Whatever its numbers are: NaN and infinity where they may stand, any text, any weights."""
    rows = FittedParameters(
        {
            name: replace(
                row,
                standard_error=data.draw(anything),
                prior_to_data_ratio=data.draw(anything),
                warnings=tuple(data.draw(st.lists(st.text(max_size=5), max_size=2))),
            )
            for name, row in fit.parameters.items()
        }
    )
    matrix = np.array(data.draw(st.lists(anything, min_size=16, max_size=16))).reshape(4, 4)
    solution = solution_of(fit)
    shape = solution.problem.sample_weights[0].shape
    some = st.sampled_from([0.0, 0.3, 1.0])
    weights = np.array(data.draw(st.lists(some, min_size=shape[0], max_size=shape[0])))
    changed = replace(
        fit,
        rmse=data.draw(number),
        cost=data.draw(number),
        status=data.draw(st.text()),
        date=data.draw(st.text()),
        noise=(Noise(data.draw(number), data.draw(number)), fit.noise[1]),
        fit_percent=dict.fromkeys(fit.fit_percent, data.draw(percent)),
        history=(*fit.history, replace(fit.history[0], cost=data.draw(anything))),
        parameters=rows,
        uncertainty=replace(fit.uncertainty, inverse_hessian=matrix),
        _solution=replace(
            solution,
            noise_model=replace(
                solution.noise_model,
                channel_weights=(weights[:, None], solution.noise_model.channel_weights[1]),
                events=((data.draw(number),), ()),
            ),
        ),
    )
    path = tmp_path_factory.mktemp("fit") / "fit.toml"
    changed.save(path)
    same(changed, Fit.load(path))


@pytest.mark.slow
def test_a_saved_fit_is_a_parameter_file(fit: Fit, saved: Path):
    values = read_parameters(saved, fit.twin.rig, NAMES[1])
    assert values == {name: float(value) for name, value in fit.twins[NAMES[1]].values.items()}
    assert Twin("single-cell", saved).values["C_load"] == fit["C_load"].value
    assert Twin("single-cell").with_values(str(saved)).values["R_E"] == 1.95


@pytest.mark.slow
def test_without_its_recordings_it_predicts_and_says_what_it_cannot(
    saved: Path, fit: Fit, recordings: list[Experiment]
):
    loaded = Fit.load(saved)
    assert loaded.to_dataframe().loc["C_load", "value"] == fit["C_load"].value
    unseen = recording(18.0, 2, "wednesday")
    band = prediction_band(loaded, NAMES[1], experiment=unseen)
    other = prediction_band(fit, NAMES[1], experiment=unseen)
    np.testing.assert_allclose(band.middle, other.middle, rtol=1e-12)
    assert validate(saved, unseen).rmse == validate(fit, unseen).rmse
    for ask in (
        lambda: loaded.runs,
        lambda: loaded.camera,
        lambda: loaded.experiments,
        lambda: loaded.plant_fit_percent,
        lambda: profile(loaded, "C_load"),
        lambda: prediction_band(loaded),
    ):
        with pytest.raises(
            MatchError, match=r"(?s)loaded without them; pass .* to Fit.load\(path, experiments="
        ):
            ask()


@pytest.mark.slow
def test_with_its_recordings_it_has_its_runs_again(
    saved: Path, fit: Fit, recordings: list[Experiment]
):
    """In any order and under any name: they are known by their contents."""
    second = recordings[1]
    other = Experiment(
        second.time, second.duty, channels=("T",), temperatures=second.temperatures, name="other"
    )
    loaded = Fit.load(saved, experiments=[other, recordings[0]])
    for name in NAMES:
        np.testing.assert_array_equal(loaded.runs[name].temperatures, fit.runs[name].temperatures)
        np.testing.assert_allclose(loaded.camera[name].error, fit.camera[name].error, atol=1e-9)
    values = fit["C_load"].value * np.array([0.98, 1.0, 1.02])
    first, second = (profile(each, "C_load", values).excess for each in (fit, loaded))
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_another_recording_is_refused(saved: Path, recordings: list[Experiment]):
    words = r"experiments: expected .* got monday, wednesday, of which none has .* of 'tuesday"
    with pytest.raises(MatchError, match=words):
        Fit.load(saved, experiments=[recordings[0], recording(18.0, 2, "wednesday")])


@pytest.mark.slow
def test_another_rig_is_refused(saved: Path):
    with pytest.raises(ParameterError, match=r"fit.rig_fingerprint: the rig 'dual-cell' .* not"):
        Fit.load(saved, rig="dual-cell")
    assert Fit.load(saved, rig=load_rig("single-cell")).twin.rig.name == "single-cell"


@pytest.mark.slow
@pytest.mark.parametrize("comment", ["# \u00b0C, 'as' built", "# '''", '# \\ """', "#\t\u200b"])
def test_a_fit_holds_the_text_of_its_rig(fit: Fit, tmp_path: Path, comment: str):
    """Neither the rig file nor the folder of the match is needed, whatever stands in the file."""
    file = tmp_path / "own.toml"
    file.write_bytes(f"{comment}\r\n{fit.twin.rig.text}".encode())
    own = replace(fit, twin=Twin(load_rig(file), dict(fit.twin.values)))
    own.save(tmp_path / "fit.toml")
    file.unlink()
    text = Fit.load(tmp_path / "fit.toml").twin.rig.text
    assert text.replace("\r\n", "\n") == f"{comment}\n{fit.twin.rig.text}"


@pytest.mark.slow
def test_a_rig_that_is_not_as_its_file_says_must_be_given(
    fit: Fit, recordings: list[Experiment], tmp_path: Path
):
    changed = replace(fit.twin.rig, cells=(replace(fit.twin.rig.cells[0], name="Q"),))
    other = match(Twin(changed, dict(fit.twin.values)), recordings, free=["C_load"])
    other.save(tmp_path / "fit.toml")
    with pytest.raises(ParameterError, match=r"fit.rig_text: expected the text of the rig file"):
        Fit.load(tmp_path / "fit.toml")
    assert Fit.load(tmp_path / "fit.toml", rig=changed).twin.rig == changed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "instead", "words"),
    [
        (r"(?s)\n\[fit\].*", "", r"fit: expected a file that Fit.save wrote"),
        (r"\nformat = 1", "\nformat = 2", r"fit.format: expected 1, got 2"),
        (r"\nrmse = .*", "", r"fit.rmse: missing, every file needs it here"),
        (r"\nrmse = .*", "\nrmse = 'low'", r"fit.rmse: expected a valid number.*, got 'low'"),
        (r"\nrmse = .*", "\nrmse = nan", r"fit.rmse: expected a finite number.*, got nan"),
        (r"\nconverged = .*", "\nconverged = 1", r"fit.converged: expected a valid bo.*, got 1"),
        (r"\ncovariance = \[\n.*", "\ncovariance = [", r"fit.unknowns.covariance: expected 4"),
        (
            r"\nlabels = .*",
            "\nlabels = ['R_E']",
            r"prior_to_data_ratio: expected 1 numbers, one for",
        ),
        (
            r"\nlabels = .*",
            "\nlabels = ['R_E', 'a', 'b', 'c']",
            r"fit.unknowns.labels: expected .* got R_E, a, b, c",
        ),
        (
            r"\nnoise = \[\n.*",
            "\nnoise = [{ standard_deviation = -1.0, autocorrelation_time = 1.0 },",
            r"fit.noise.0: expected finite numbers, 0 or above, got .*-1.0",
        ),
        (
            r"\nC_load = {(.*)free = true",
            r"\nC_load = {\1free = 1",
            r"C_load.free: expected a valid",
        ),
        (
            r"\nchannel_weights = \[\n    \[\d+",
            "\nchannel_weights = [\n    [1000000000000000",
            r"fit.recordings.monday.channel_weights: expected weights of 61 samples, got 10000",
        ),
        (
            r"(?s)\n\[fit.recordings.*",
            "\n[fit.recordings]",
            r"recordings: expected at least 1 entr",
        ),
        (r"\nC_load = .*", "", r"parameters.C_load: expected a row for each.*, got none"),
        (
            r"\nC_load = { value = .*?,",
            "\nC_load = { value = nan,",
            r"C_load: .*got nan",
        ),
        (r"\[fit.parameters.R_E\]\n", "[fit.more]\n", r"fit.parameters.R_E: expected .* got none"),
        (r"\ninitial = .*", "\ninitial = inf", r"fit.parameters.C_load.initial: .*got inf"),
        (
            r"\nsamples = 61",
            "\nsamples = 60",
            r"sample_weights: expected weights of 60 samples, got 61",
        ),
        (r'\[recordings."monday"\]\n.*', "", r"recordings.monday.T_amb: expected the value"),
        (
            r"\[fit.recordings.monday\]",
            "[fit.recordings.friday]",
            r"recordings.friday.T_amb: expected",
        ),
    ],
)
def test_a_damaged_file_says_where(saved: Path, tmp_path: Path, pattern, instead, words):
    text, count = re.subn(pattern, instead, saved.read_text("utf-8"), count=1)
    assert count == 1
    path = tmp_path / "damaged.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(ParameterError, match=f"damaged.toml: .*{words}"):
        Fit.load(path)


@pytest.mark.slow
def test_a_channel_that_never_changes_is_named_and_left_out_of_the_mean(fit: Fit):
    monday, tuesday = fit.fit_percent
    found = replace(fit, fit_percent={monday: np.nan, tuesday: 80.0})
    assert found.mean_fit_percent == 80.0
    assert "monday: T constant" in found.summary()
    assert found.to_dict()["fit_percent"]["monday"]["T"] is None


@pytest.mark.slow
def test_access_is_plain_and_unknown_names_are_met_with_the_nearest(fit: Fit):
    assert list(fit.parameters) == list(fit.twin.rig.parameters)
    assert fit["R_E"] is fit.parameters["R_E"]
    for ask in (lambda: fit["R_e"], lambda: fit.parameters["R_e"]):
        with pytest.raises(ParameterError, match="unknown parameter 'R_e', did you mean 'R_E'"):
            ask()
    frame = fit.to_dataframe()
    assert list(frame.index) == list(fit.parameters)
    assert frame.loc["C_load", "standard_error"] == fit["C_load"].standard_error
    assert "<th>C_load</th>" in fit._repr_html_()
    assert "<th>R_loss</th>" not in fit._repr_html_()
