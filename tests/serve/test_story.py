"""Three sentences: the worst that is known comes first, and estimates are called expected."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin.live import Finding
from jaxtwin.observers import Moment
from jaxtwin.serve._story import Reason, Situation, is_rig_well, is_twin_right, what_comes

GOOD = Situation(
    channels=("T1", "T2"),
    readings=np.array([30.0, 31.0]),
    links={"a": "live"},
    refusals={},
    age=0.1,
    silent=0.1,
    faults={},
    trip="",
    still_on="",
    limit=80.0,
    findings=(),
    cause=None,
    is_awaited=False,
    acknowledged=0,
    problem="",
    ended=False,
    observed=1000.0,
    within=0.95,
    band=0.1,
    compared=300.0,
    later=Moment(np.array([30.0, 31.0]), np.array([0.1, 0.1])),
)
SECOND = 10**9
ALARM = Finding(
    "sudden", "T1 is 2 K above what is expected", "T1", 50 * SECOND, size=2.0, unit="K",
    found=60 * SECOND,
)  # fmt: skip
OVER = replace(ALARM, until=90 * SECOND)
LOOSE = Reason("contact of P1 2.5 times what it was", 0.98, 50.0)
NOTICE = Finding("changed", "R_E differs by +3 %", "R_E", severity="notice")


@pytest.mark.parametrize(
    ("changes", "level", "head"),
    [
        ({}, "good", "The rig is well"),
        ({"age": None}, "unknown", "Waiting for the rig"),
        ({"age": 60.0}, "critical", "No readings"),
        ({"readings": np.array([81.0, 20.0])}, "critical", "The rig is too hot"),
        ({"trip": "watchdog"}, "warning", "The device has switched off"),
        ({"findings": (NOTICE, ALARM)}, "warning", "T1 is 2 K above what is expected"),
        ({"findings": (NOTICE,)}, "notice", "R_E differs by +3 %"),
        ({"findings": (OVER,)}, "notice", "Over: T1 is 2 K above what is expected"),
        ({"findings": (OVER,), "faults": {"T1": "open"}}, "warning", "A channel has failed"),
        ({"findings": (OVER,), "cause": LOOSE}, "warning", "Contact of P1 2.5 times what it was"),
        (
            {"findings": (ALARM,), "acknowledged": 60 * SECOND},
            "notice",
            "T1 is 2 K above what is expected",
        ),
        ({"faults": {"T1": "open"}}, "warning", "A channel has failed"),
        ({"problem": "disk"}, "warning", "The server has a problem"),
        ({"silent": 4.0}, "warning", "The controller is silent"),
        ({"links": {"a": "live", "b": "down"}}, "warning", "A link is not live"),
        ({"still_on": "it reports heat", "age": None}, "critical", "The cells may be on"),
        ({"ended": True}, "unknown", "The recording is over"),
        ({"readings": np.full(2, np.nan)}, "good", "The rig is well"),
        ({"age": 60.0, "trip": "stop", "findings": (ALARM,)}, "critical", "No readings"),
        ({"trip": "x", "readings": np.array([90.0, 1.0])}, "critical", "The rig is too hot"),
    ],
)
def test_the_rig_is_well_or_the_worst_is_said(changes: dict, level: str, head: str) -> None:
    found = is_rig_well(GOOD._replace(**changes))
    assert (found.level, found.head) == (level, head)


texts = st.sampled_from(["", "something"])
findings = st.builds(
    Finding,
    st.sampled_from(["sudden", "drift", "frozen", "gone", "implausible", "changed"]),
    st.just("T1 is off"),
    st.sampled_from(["", "T1"]),
    severity=st.sampled_from(["notice", "warning", "critical"]),
    size=st.none() | st.floats(-5, 5),
    found=st.integers(1, 100),
    until=st.none() | st.integers(100, 200),
)
situations = st.builds(
    GOOD._replace,
    readings=st.lists(st.floats(-10, 120) | st.just(np.nan), min_size=2, max_size=2).map(np.array),
    links=st.dictionaries(
        st.sampled_from("ab"), st.sampled_from(["connecting", "live", "stale", "down"])
    ),
    age=st.none() | st.floats(0, 10),
    silent=st.floats(0, 10),
    faults=st.sampled_from([{}, {"T1": "open"}]),
    trip=texts,
    still_on=texts,
    limit=st.none() | st.just(80.0),
    findings=st.lists(findings, max_size=3),
    cause=st.none() | st.just(LOOSE),
    is_awaited=st.booleans(),
    acknowledged=st.sampled_from([0, 50, 100]),
    problem=texts,
    ended=st.booleans(),
    observed=st.floats(0, 1000),
    within=st.floats(0, 1),
)


@given(situations)
@settings(max_examples=1000)
def test_no_answer_is_greener_than_what_is_known(now: Situation) -> None:
    """The rig is well only where nothing speaks against it, and the twin is right only where it
    explains what is there."""
    is_alarmed = any(finding.is_alarm and finding.until is None for finding in now.findings)
    is_old = now.age is None or now.age > 3.0
    is_hot = now.limit is not None and bool(np.any(now.readings > now.limit))
    is_silent = now.silent > 3.0 or any(state != "live" for state in now.links.values())
    doubts = [
        now.findings, is_old, is_hot, is_silent, now.faults, now.trip, now.still_on, now.problem,
        now.ended,
    ]  # fmt: skip
    rig, twin = is_rig_well(now), is_twin_right(now)
    assert (rig.level == "good") == (not any(doubts))
    assert ("well" in f"{rig.head} {rig.text}") == (rig.level == "good")
    if is_alarmed or now.cause or is_old:
        assert twin.level != "good"


@pytest.mark.parametrize(
    ("changes", "level"),
    [
        ({}, "good"),
        ({"age": None}, "unknown"),
        ({"observed": 60.0}, "unknown"),
        ({"findings": (ALARM,)}, "warning"),
        ({"findings": (NOTICE,)}, "notice"),
        ({"cause": LOOSE}, "notice"),
        ({"within": 0.6}, "notice"),
    ],
)
def test_the_twin_is_right_if_it_expects_readings_as_well_as_it_says(
    changes: dict, level: str
) -> None:
    assert is_twin_right(GOOD._replace(**changes)).level == level


@pytest.mark.parametrize(
    ("mean", "level", "head"),
    [
        ([30.05, 31.0], "good", "Steady for the next minute"),
        ([33.0, 31.0], "good", "T1 warming by 3.0 K in a minute"),  # T2 is the hottest
        ([30.0, 29.0], "good", "Cooling by 2.0 K in a minute"),
        ([79.9, 31.0], "warning", "The limit is near"),
    ],
)
def test_what_comes_is_the_largest_change_or_the_limit(
    mean: list[float], level: str, head: str
) -> None:
    later = Moment(np.array(mean), np.array([0.1, 0.1]))
    found = what_comes(GOOD._replace(later=later))
    assert (found.level, found.head) == (level, head)
    assert "expected" in found.text


def test_a_finding_is_named_beside_whatever_is_worse() -> None:
    found = is_rig_well(GOOD._replace(findings=(OVER,), trip="watchdog"))
    assert found.head == "The device has switched off"
    assert found.text.endswith("Also: Over: T1 is 2 K above what is expected.")


def test_the_forecast_of_a_twin_that_does_not_explain_the_rig_is_not_green() -> None:
    for changes in ({"findings": (ALARM,)}, {"cause": LOOSE}):
        found = what_comes(GOOD._replace(**changes))
        assert (found.level, found.text[:32]) == ("notice", "By a twin that does not explain ")
    assert what_comes(GOOD._replace(findings=(OVER,))).level == "good"


def test_there_is_no_forecast_from_old_readings() -> None:
    for changes in ({"age": 10.0}, {"later": None}, {"ended": True}):
        assert what_comes(GOOD._replace(**changes)).level == "unknown"


def test_a_link_that_never_greets_is_named_with_the_reason() -> None:
    waiting = GOOD._replace(age=None, links={"/dev/ttyACM0": "connecting"})
    assert "/dev/ttyACM0 is connecting" in is_rig_well(waiting).text
    refused = waiting._replace(refusals={"/dev/ttyACM0": "is the rig 'tclab'"})
    assert "refused: is the rig 'tclab'" in is_rig_well(refused).text


def test_a_sure_cause_is_the_headline_with_its_size_and_clock_time() -> None:
    found = is_rig_well(GOOD._replace(findings=(ALARM, ALARM), cause=LOOSE))
    assert (found.head, found.since) == ("Contact of P1 2.5 times what it was", 50.0)
    assert found.text == "Estimate, 98 %, of 2 findings. The twin does not know it yet."


def test_what_may_be_the_cause_stands_below_the_finding() -> None:
    cause = LOOSE._replace(probability=0.6)
    found = is_rig_well(GOOD._replace(findings=(OVER,), cause=cause))
    assert (found.head[:8], found.since, found.until) == ("Over: T1", 50.0, 90.0)
    assert found.text == f"Most likely (estimate): {LOOSE.phrase}, 60 %."
    awaited = is_rig_well(GOOD._replace(findings=(ALARM,), is_awaited=True))
    assert awaited.text == "A diagnosis follows."


def test_the_twin_is_judged_by_the_share_of_readings_in_its_band() -> None:
    text = is_twin_right(GOOD._replace(within=0.947)).text
    assert text.startswith("95 % of the readings of the last 5 minutes are within ±0.1 K")
