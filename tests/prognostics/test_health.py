"""The health of a rig: what sessions say without their priors, trends, limits and bad input."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest
from aged_sessions import NAME, session
from matplotlib import pyplot
from small_results import fit

import jaxtwin as jt
from jaxtwin.prognostics._assess import _by_change, session_of


def aged(values: Sequence[float] | np.ndarray, **options: object) -> jt.prognostics.Health:
    fits = {f"day {number}": session(value) for number, value in enumerate(values)}
    return jt.health(fits, list(range(len(values))), names=[NAME], **options)  # pyright: ignore


@pytest.mark.parametrize("error", [0.01, 0.3])
def test_a_session_says_the_same_with_a_prior_and_without(error: float):
    """The posterior of a normal estimate and a normal prior, and the estimate that it came from."""
    found = session_of(session(2.0, error, prior=True)).estimates[NAME]
    assert found.value == pytest.approx(np.log(2.0))
    assert found.error == pytest.approx(error)


def test_a_session_says_nothing_of_what_its_prior_alone_determines():
    assert NAME not in session_of(session(2.0, 2.0, prior=True)).estimates


def test_values_of_single_recordings_are_no_parameters_of_the_rig():
    assert "T_amb" not in session_of(fit()).estimates
    assert set(session_of(fit()).estimates) <= {"R_E", "R_pc"}


def test_a_trend_is_found_with_its_size():
    """A resistance that grows by a tenth in four days, equally each day."""
    found = aged(2.0 * 1.1 ** (np.arange(5) / 4))
    assert found[NAME].change == pytest.approx(0.1)
    assert found[NAME].value == pytest.approx(2.2)
    low, high = found[NAME].change_interval
    assert 0.05 < low < 0.1 < high < 0.15
    assert found.time_unit == "day"
    assert "what changed most: R_E, +10 %" in found.summary()


def test_what_changed_most_is_first_and_p_values_are_those_of_holm():
    """Of three parameters the smallest p-value counts three times, the second twice, and none is
    below one before it."""
    rows = [aged(values)[NAME] for values in ([2.0, 2.1, 2.1, 2.2], [2.0, 2.1, 2.2, 2.3])]
    third = replace(rows[0], name="again")
    found = _by_change([*rows, third])
    assert found[0].trend is rows[1].trend
    own = [row.trend.p_value for row in found]
    assert [row.p_value for row in found] == pytest.approx([3 * own[0], 2 * own[1], 2 * own[1]])


def test_a_last_session_that_is_unlike_those_before_is_named():
    found = aged([2.0, 2.01, 1.99, 2.0, 2.3])
    assert found[NAME].last_distance > 5
    assert "day 4 is unlike those before: R_E" in found.summary()
    assert abs(aged([2.0, 2.01, 1.99, 2.0, 2.0])[NAME].last_distance) < 1


def test_limits_above_and_below_are_passed_in_their_direction():
    values = 2.0 * 1.1 ** (np.arange(5) / 4)
    above = aged(values, limits={NAME: 2.4}, within=8.0)
    assert above[NAME].is_upward
    assert above.probabilities[NAME] > 0.9
    assert aged(values, limits={NAME: 4.0}, within=8.0).probabilities[NAME] < 0.01
    assert aged(values, limits={NAME: 1.8}, within=8.0).probabilities[NAME] < 0.01
    assert aged(values, limits={NAME: 2.05}, within=0.0).probabilities[NAME] > 0.95
    assert "R_E passes 2.4 ohm within 8 days with a probability of 0.9" in above.summary()


def test_the_champion_of_a_store_and_its_parents_are_sessions(tmp_path: Path):
    """Not a challenger that waits; without times, versions of one second are refused."""
    store = jt.TwinStore(tmp_path / "twins.db")
    store.add(session(2.0), reason="first match", aliases=["champion"])
    for number in (1, 2):
        store.add(
            session(2.0 + 0.1 * number), reason="a refit", parent=number, aliases=["champion"]
        )
    store.add(session(9.0), reason="waits", parent="champion", aliases=["challenger"])
    found = jt.health(store, ["2026-01-01", "2026-01-08", "2026-01-15"])
    assert found.sessions == ("version 1", "version 2", "version 3")
    np.testing.assert_allclose(found[NAME].values, [2.0, 2.1, 2.2])
    assert found.times.tolist() == [0.0, 7.0, 14.0]
    assert found.within == 14.0


@pytest.mark.slow
def test_observed_sessions_say_where_a_parameter_that_drifts_is_at_their_end():
    """R_E grows by a twentieth from session to session. What the observer assumed before the first
    reading, a healthy value within 10 %, does not draw the estimates to itself."""
    twin, noise = jt.Twin("single-cell"), jt.ProcessNoise(names=("R_E",), slow=0.1, reading=0.1)
    drive = jt.Experiment.schedule("0:0.5,300:0.8", duration=600)
    healthy = float(twin.values["R_E"])
    observed = []
    for number in range(4):
        aged = twin.with_values({"R_E": healthy * 1.05**number})
        recording = aged.simulate(drive).to_recording(noise=0.1, seed=number)
        observed.append(jt.observe(twin, replace(recording, name=f"session {number}"), noise))
    found = jt.health(observed)
    assert found.sessions == ("session 0", "session 1", "session 2", "session 3")
    row = found["R_E"]
    truth = healthy * 1.05 ** np.arange(4)
    assert np.all(np.abs(np.log(row.values / truth)) < 3 * row.errors)
    assert np.all(row.errors < 0.04)
    assert row.change == pytest.approx(1.05**3 - 1, abs=0.04)


def test_dates_are_taken_as_text_and_as_dates():
    fits = [session(2.0)] * 3
    texts = jt.health(fits, ["2026-01-01", "2026-01-02T12:00", "2026-01-05T00:00+00:00"])
    assert texts.times.tolist() == [0.0, 1.5, 4.0]
    mixed = jt.health(fits, ["2026-01-01", date(2026, 1, 2), datetime(2026, 1, 5, tzinfo=UTC)])
    assert mixed.times.tolist() == [0.0, 1.0, 4.0]
    days = jt.health(fits, [date(2026, 1, 1), date(2026, 1, 2), date(2026, 2, 1)])
    assert days.times.tolist() == [0.0, 1.0, 31.0]


def test_the_picture_has_sessions_trend_and_limit():
    found = aged([2.0, 2.05, 2.1, 2.2], limits={NAME: 2.5}, within=5.0)
    figure = found.plot()
    (axes,) = figure.axes
    dots = next(line for line in axes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(np.asarray(dots.get_ydata(), float), found[NAME].values)
    (limit,) = [line for line in axes.lines if line.get_gid() == "limit"]
    assert set(np.asarray(limit.get_ydata())) == {2.5}
    assert axes.get_xlim()[1] >= 8.0
    pyplot.close("all")


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (lambda: ([session(2.0)] * 2,), {}, "expected 3 or more, because two always lie on a line"),
        (lambda: ([session(2.0)] * 3, [1, 2]), {}, "one for each of 3 sessions, got 2"),
        (lambda: ([session(2.0)] * 3, [1, 3, 2]), {}, "times that increase"),
        (lambda: ([session(2.0)] * 3, [1, 1, 1]), {}, "times that increase"),
        (lambda: ([session(2.0)] * 3, ["monday", 2, 3]), {}, "a date such as '2026-01-31'"),
        (lambda: ([session(2.0)] * 3, [date(2026, 1, 1), 2, 3]), {}, "all dates or all numbers"),
        (lambda: ([session(2.0)] * 3,), {"names": ["R_X"]}, "unknown parameter 'R_X'"),
        (lambda: ([session(2.0)] * 3,), {"limits": {"R_E": -1}}, "R_E: expected a number above 0"),
        (lambda: ([session(2.0)] * 3,), {"limits": {"R_X": 1}}, "unknown parameter 'R_X'"),
        (lambda: ([session(2.0)] * 3,), {"limits": {"C_esp": 1}}, "that 3 sessions determine"),
        (lambda: ([session(2.0)] * 3,), {"within": -1}, "within: expected a number of at least 0"),
        (lambda: ([session(2.0)] * 3,), {"names": ["T_amb"]}, "got none among T_amb"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_in_one_sentence(arguments, options, message: str):
    with pytest.raises((jt.errors.MatchError, jt.errors.ParameterError)) as problem:
        jt.health(*arguments(), **options)
    assert message in str(problem.value)


def test_a_parameter_that_is_not_there_is_answered_with_those_that_are():
    with pytest.raises(jt.errors.ParameterError, match="Known: R_E"):
        aged([2.0, 2.0, 2.1])["R_e"]
