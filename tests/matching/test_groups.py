"""Days that differ: values of groups under a hierarchical prior, on recordings of known truth."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_results
from matplotlib import pyplot
from small_rigs import CAMERA, small_rig_file, zone

from jaxtwin import (
    Experiment,
    Fit,
    Twin,
    load_rig,
    match,
    match_many,
    plots,
    profile,
    simulate,
    validate,
)
from jaxtwin.errors import MatchError, ParameterError, RigError
from jaxtwin.matching import prediction_band
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._group_values import new_group_values
from jaxtwin.matching._match_group import check_given
from jaxtwin.matching._problem import LinearPrior
from jaxtwin.matching._unknowns import Unknowns
from jaxtwin.rig import Parameter, Rig

PARAMETERS = """
[parameters.k]
value = 200.0
unit = "W/(m K)"
bounds = [50.0, 800.0]
prior = { spread = 0.3 }
free = true

[parameters.R_pc]
value = 0.6
unit = "K/W"
bounds = [0.02, 20.0]
prior = { spread = 1.0, between_groups = 1.0 }
free = true
scope = "group"

[parameters.d_x]
value = 0.0
unit = "mm"
bounds = [-20.0, 20.0]
prior = { spread = 3.0, between_groups = 4.0 }
free = true
scope = "group"

[parameters.T_amb]
value = 20.0
unit = "degC"
bounds = [0.0, 40.0]
prior = { spread = 3.0 }
free = true
scope = "recording"
"""
TRUTH = {"monday": {"R_pc": 0.5, "d_x": 2.0}, "friday": {"R_pc": 1.5, "d_x": -5.0}}
NOISE = 0.05


def rig_file(folder: Path) -> Path:
    return small_rig_file(
        folder,
        ["2 cm"] * 4,
        ["2 cm"],
        [{"V12": "R_pc"}],
        thickness="1 mm",
        density="8960 kg/m^3",
        specific_heat="390 J/(kg K)",
        conductivity="k",
        film_coefficient="15 W/(m^2 K)",
        sink_resistance="0.5 K/W",
        sensors=CAMERA.replace("60", "20") + 'registration = { shift_x = "d_x" }',
        channels="".join(
            zone(name, x, (0.0, 2.0))
            for name, x in {"T1": (1.0, 2.5), "T2": (2.5, 5.5), "T3": (5.5, 7.0)}.items()
        ),
        ambient="T_amb",
        parameters=PARAMETERS,
    )


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return load_rig(rig_file(tmp_path_factory.mktemp("rig")))


def recording(rig: Rig, day: str, number: int, **values: float) -> Experiment:
    """A minute of rest and four of heating on a day, with noise."""
    drive = Experiment.schedule(f"60:{0.4 + 0.2 * number}", duration=300, step=2.0)
    run = simulate(Twin(rig, {"k": 240.0, "T_amb": 18.0 + number, **TRUTH[day], **values}), drive)
    noise = np.random.default_rng([number, len(day)]).normal(0, NOISE, run.temperatures.shape)
    return Experiment(
        drive.time,
        drive.duty,
        channels=run.channels,
        temperatures=run.temperatures + noise,
        name=f"{day} {number}",
        group=day,
    )


@pytest.fixture(scope="module")
def monday(rig: Rig) -> list[Experiment]:
    return [recording(rig, "monday", number) for number in range(2)]


@pytest.fixture(scope="module")
def friday(rig: Rig) -> list[Experiment]:
    return [recording(rig, "friday", number) for number in range(2)]


@pytest.fixture(scope="module")
def both(rig: Rig, monday, friday) -> Fit:
    return match(Twin(rig), [*monday, *friday])


@pytest.fixture(scope="module")
def first(rig: Rig, monday) -> Fit:
    return match(Twin(rig), monday)


@pytest.mark.long
def test_the_profile_of_a_value_of_a_group_has_its_standard_error_and_prior(both: Fit):
    """The reading is linear in the camera's shift for a tenth of a millimetre: the excess is the
    square of the number of standard errors, as by hand, with the prior between groups in both."""
    at, error = both.group_values["monday"]["d_x"], both.uncertainty.standard_errors["d_x[monday]"]
    steps = np.array([-3.0, -1.0, 1.0, 3.0])
    found = profile(both, "d_x[monday]", at + steps * error)
    np.testing.assert_allclose(found.excess, steps**2, rtol=0.03)
    with pytest.raises(
        ParameterError, match=r"one of the matched values .*d_x\[friday\], .*got 'd_x'"
    ):
        profile(both, "d_x")


def rows() -> tuple[Parameter, Parameter]:
    """A shared parameter, and one of which each group has a value."""
    free = Parameter("k", 1.0, prior_spread=2.0, prior_value=0.5)
    return free, replace(free, name="u", scope="group", group_spread=0.7)


def test_values_of_groups_have_the_covariance_of_a_hierarchical_model():
    unknowns = Unknowns.of(rows(), (0, 1, 1, 2))
    prior = LinearPrior.between_groups(unknowns)
    precision = prior.matrix.T @ prior.matrix
    covariance = np.linalg.inv(precision[1:, 1:])
    np.testing.assert_allclose(covariance, 0.7**2 * np.eye(3) + 2.0**2, rtol=1e-12)
    np.testing.assert_allclose(prior.matrix @ unknowns.prior_means(), prior.values)
    assert unknowns.labels("abcd", "xyz") == ("k", "u[x]", "u[y]", "u[z]")
    assert unknowns.layout.entry_indices().tolist() == [[0, 1], [0, 2], [0, 2], [0, 3]]


@pytest.mark.parametrize("groups", [1, 3])
def test_a_new_group_is_the_normal_distribution_given_the_others(groups: int):
    """The joint normal of known groups and a new one, conditioned on the known by the textbook."""
    unknowns = Unknowns.of(rows(), tuple(range(groups)))
    values = np.array([1.0, 2.5, -0.3, 1.1])[: groups + 1]
    joint = 0.7**2 * np.eye(groups + 1) + 2.0**2
    gain = joint[-1, :-1] @ np.linalg.inv(joint[:-1, :-1])
    expected = new_group_values(unknowns, values)
    assert expected.mean == pytest.approx([0.5 + gain @ (values[1:] - 0.5)])
    assert expected.variance == pytest.approx([joint[-1, -1] - gain @ joint[:-1, -1]])
    # What is not known of the vector adds to it.
    added = expected.covariance(np.full((groups + 1, groups + 1), 0.04)) - np.diag(
        expected.variance
    )
    assert added == pytest.approx(np.array([[0.04 * gain.sum() ** 2]]))


@pytest.mark.slow
def test_two_days_are_told_apart(both: Fit):
    """Shifts to a millimetre, contacts within three of their standard errors."""
    assert both.converged
    assert set(both.group_values) == set(TRUTH)
    errors = both.uncertainty.standard_errors
    for day, truth in TRUTH.items():
        found = both.group_values[day]
        assert abs(found["d_x"] - truth["d_x"]) < 1.0
        assert abs(found["d_x"] - truth["d_x"]) < 3 * errors[f"d_x[{day}]"]
        assert abs(found["R_pc"] - truth["R_pc"]) < 3 * errors[f"R_pc[{day}]"]
    assert both["k"].value == pytest.approx(240.0, rel=0.05)


@pytest.mark.slow
def test_the_row_of_a_groups_parameter_is_what_all_groups_share(both: Fit):
    """Between the days' values, drawn to the prior, and as uncertain as two days leave it."""
    row = both["R_pc"]
    values = [math.log(both.group_values[day]["R_pc"] / 0.6) for day in TRUTH]
    assert math.log(row.value / 0.6) == pytest.approx(sum(values) / 3, rel=1e-6)
    assert row.scope == "group"
    assert (row.prior_spread, row.group_spread) == (1.0, 1.0)
    # One over three is the variance that the spreads leave, the rest is that of the values.
    assert math.sqrt(1 / 3) < row.relative_standard_error < math.sqrt(1 / 3) + 0.1


@pytest.mark.long
def test_many_sets_have_values_for_each_group(rig: Rig, monday, friday, both: Fit):
    """The same as a match of the set by itself; a group that is missing in a set is refused."""
    days = ["monday", "monday", "friday", "friday"]
    fits = match_many(Twin(rig), [[*monday, *friday], [*monday, *friday[::-1]]], groups=days)
    for fit in fits:
        assert fit is not None
        for day in TRUTH:
            assert fit.group_values[day] == pytest.approx(both.group_values[day], rel=1e-3)
    with pytest.raises(MatchError, match=r"grouped alike .* \(0, 1, 1\) in set 1 and \(0, 0, 1\)"):
        match_many(Twin(rig), [[*monday, friday[0]], [monday[0], *friday]])


@pytest.mark.slow
def test_a_picture_shows_the_values_of_each_group(both: Fit, first: Fit):
    """With their intervals, beside that of the value that the groups share."""
    contact, shift = plots.plot_group_values(both).axes[:2]
    values = [both.group_values[day]["R_pc"] for day in TRUTH]
    np.testing.assert_allclose(np.asarray(contact.lines[0].get_ydata(), float), values)
    (band,) = (patch for patch in contact.patches if patch.get_gid() == "shared")
    path = band.get_path().transformed(band.get_patch_transform())
    heights = np.asarray(path.vertices, float)[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx(both["R_pc"].interval)
    error = both.uncertainty.standard_errors["d_x[monday]"]
    (ends, _) = (np.asarray(path.vertices)[:, 1] for path in shift.collections[0].get_paths())
    assert float(np.ptp(ends)) == pytest.approx(2 * 1.96 * error, rel=1e-3)
    alone = plots.plot_group_values({"a": first, "b": both}, ["k"]).axes
    assert [axes.get_title(loc="left") for axes in alone] == ["k, W/(m K)"]
    with pytest.raises(MatchError, match="expected a match of several groups"):
        plots.plot_group_values(first)
    with pytest.raises(MatchError, match=r"names among R_pc, d_x, .* got 'k'"):
        plots.plot_group_values(both, ["k"])
    pyplot.close("all")


@pytest.mark.slow
def test_a_day_is_not_explained_by_the_values_of_another(rig: Rig, monday, friday, both: Fit):
    """By twenty times the noise."""
    for recording, other in ((monday[0], "friday"), (friday[0], "monday")):
        run = simulate(both.twin_of_group(other), recording)
        assert np.std(run.temperatures - recording.temperatures) > 20 * NOISE


@pytest.mark.slow
def test_shared_values_alone_do_not_explain_two_days(rig: Rig, monday, friday, both: Fit):
    shared = match(Twin(rig), [*monday, *friday], groups=["one"] * 4)
    assert shared.rmse > 3 * both.rmse


@pytest.mark.slow
def test_groups_given_by_name_take_the_place_of_the_recordings_own(rig: Rig, monday, friday, both):
    unnamed = [
        Experiment(e.time, e.duty, channels=e.channels, temperatures=e.temperatures, name=e.name)
        for e in (*monday, *friday)
    ]
    fit = match(Twin(rig), unnamed, groups=["monday", "monday", "friday", "friday"])
    np.testing.assert_allclose(solution_of(fit).vector, solution_of(both).vector)


@pytest.mark.slow
def test_a_day_that_the_fit_knows_is_predicted_with_its_values(rig: Rig, both: Fit):
    """To what noise leaves: 0.05 K."""
    unseen = recording(rig, "friday", 2)
    known = validate(both, unseen)
    assert known.rmse < 1.3 * NOISE
    assert known.predictions[0].twin.values["d_x"] == both.group_values["friday"]["d_x"]
    assert validate(both, unseen, group="monday").rmse > 10 * known.rmse


def test_what_an_earlier_match_knows_is_a_normal_prior_of_the_next():
    """Its whitened form has the density of the textbook; unknowns that come behind have none."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    covariance, mean, point = root @ root.T, rng.normal(size=5), rng.normal(size=5)
    prior = LinearPrior.normal(mean, covariance)
    away = (point - mean)[:3]
    squares = np.sum((prior.matrix @ point - prior.values) ** 2)
    assert squares == pytest.approx(away @ np.linalg.inv(covariance) @ away)
    assert not prior.matrix[:, 3:].any()


@pytest.mark.slow
def test_a_first_part_or_another_recording_of_a_new_day_improves_its_prediction(
    rig: Rig, first: Fit, friday
):
    """A minute and a half of it, or another recording of the same day: each better than nothing."""
    unseen = recording(rig, "friday", 2)
    nothing = validate(first, unseen).rmse
    part = validate(first, unseen, given=150)
    whole = validate(first, unseen, given=friday[:1])
    assert part.rmse < nothing / 3
    assert whole.rmse < 1.5 * NOISE
    assert set(part.predictions[0].estimated) == {"T_amb", "R_pc", "d_x"}
    assert "150 s, from which its group follows" in part.kind
    assert "given friday 0" in whole.kind


@pytest.mark.slow
def test_bands_of_a_new_day_hold_and_those_of_a_known_one_are_narrow(
    rig: Rig, first: Fit, both: Fit
):
    unseen = recording(rig, "friday", 2)
    assert unseen.temperatures is not None
    late = unseen.time > 60

    def inside_and_width(band) -> tuple[float, float]:
        inside = (unseen.temperatures >= band.lower) & (unseen.temperatures <= band.upper)
        return float(inside[late].mean()), float((band.upper - band.lower)[late].mean())

    new = inside_and_width(prediction_band(first, experiment=unseen))
    known = inside_and_width(prediction_band(both, experiment=unseen))
    assert new[0] > 0.9
    assert known[0] > 0.9
    assert new[1] > 5 * known[1]


@pytest.mark.slow
def test_a_saved_fit_knows_its_groups(both: Fit, tmp_path, monday, friday):
    both.save(tmp_path / "fit.toml")
    loaded = Fit.load(tmp_path / "fit.toml", rig=both.twin.rig, experiments=[*friday, *monday])
    assert loaded.groups == both.groups
    assert loaded.group_values == {
        day: pytest.approx(values, rel=1e-12) for day, values in both.group_values.items()
    }
    mine, theirs = solution_of(loaded), solution_of(both)
    np.testing.assert_allclose(mine.vector, theirs.vector, rtol=1e-12)
    assert loaded["R_pc"].group_spread == 1.0
    expected, found = (new_group_values(s.problem.unknowns, s.vector) for s in (theirs, mine))
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-12)
    assert "friday: R_pc = " in loaded.summary()


def test_a_recording_without_a_group_among_others_is_refused(rig: Rig, monday):
    unnamed = Experiment(
        monday[0].time,
        monday[0].duty,
        channels=monday[0].channels,
        temperatures=monday[0].temperatures,
        name="unnamed",
    )
    with pytest.raises(MatchError, match=r"got \['monday', ''\] for monday 0, unnamed"):
        match(Twin(rig), [monday[0], unnamed])
    with pytest.raises(MatchError, match=r"groups: expected a name for each .* got \['monday'\]"):
        match(Twin(rig), monday, groups=["monday"])
    with pytest.raises(MatchError, match=r"groups: expected a name .* got 'monday'"):
        match(Twin(rig), monday, groups="monday")


@pytest.mark.slow
def test_a_first_part_corrects_a_group_that_the_fit_knows(rig: Rig, first: Fit):
    """The day was matched with another contact than it has in a later recording of the same name:
    the prior is narrow, and the first part moves it towards what it shows."""
    later = recording(rig, "friday", 2)
    as_matched = validate(first, later, group="monday", warm_up=150)
    corrected = validate(first, later, group="monday", given=150)
    assert corrected.rmse < as_matched.rmse
    known = first.group_values["monday"]["R_pc"]
    new = validate(first, later, group="friday", given=150).predictions[0].estimated["R_pc"]
    moved = corrected.predictions[0].estimated["R_pc"]
    assert abs(moved - known) < abs(new - known)


@pytest.mark.slow
def test_what_is_given_was_not_matched(rig: Rig, first: Fit, monday, friday):
    with pytest.raises(MatchError, match="has not seen, got 'monday 0', which it was matched to"):
        validate(first, monday[0], given=150)
    with pytest.raises(MatchError, match="has not seen, got 'monday 0'"):
        validate(first, friday[0], given=monday[:1], group="monday")
    with pytest.raises(MatchError, match="has not seen, got 'monday 0'"):
        prediction_band(first, experiment=friday[0], given=monday[:1], group="monday")
    with pytest.raises(MatchError, match=r"given: expected beside a Fit, .* got beside a Twin"):
        validate(Twin(rig), monday[0], given=150)


@pytest.mark.parametrize(
    ("old", "new"), [('scope = "group"', 'scope = "shared"'), (", between_groups = 1.0", "")]
)
def test_a_scope_and_a_spread_between_groups_belong_together(tmp_path, old: str, new: str):
    path = rig_file(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(RigError, match=r"between_groups: expected .* got (1|none) with scope = "):
        load_rig(path)


@pytest.mark.slow
def test_what_is_given_is_of_a_single_group():
    with pytest.raises(MatchError, match="recordings of a single group, got friday, sunday; name"):
        check_given(small_results.fit(), ["sunday", "friday"])


@pytest.mark.long
def test_a_better_start_gets_weights_of_its_own(rig: Rig):
    """Three steps from a far start leave twice the residuals of the best start, whose weights are
    not those of the far one."""
    far = Twin(rig, {"R_pc": 19.0, "k": 60.0})
    days = [recording(rig, "monday", number) for number in range(2)]
    alone = match(far, days, max_iterations=3)
    best = match(far, days, starts=4, seed=3, max_iterations=3)
    assert alone.rmse > 2 * best.rmse
    of_alone, of_best = (solution_of(fit).noise_model.common_mode for fit in (alone, best))
    assert of_alone.effective > 1.5 * of_best.effective
