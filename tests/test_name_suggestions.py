"""Whoever mistypes a name is told the nearest one."""

from collections.abc import Callable

import pytest

from jaxtwin import (
    Experiment,
    JaxtwinError,
    Twin,
    load_rig,
    match,
    simulate,
    simulate_batch,
)
from jaxtwin._by_recording import ByRecording
from jaxtwin._name_suggestions import did_you_mean

DRIVE = Experiment.schedule("0:0.5", duration=3, channels=("T",))
RECORDED = Experiment([0, 1], [0, 1], channels=("T11", "T12"), temperatures=[[20, 20], [21, 21]])


def test_the_nearest_of_several_names():
    suggestion = did_you_mean(["R_tez", "alpa"], ["R_Tez", "alpha"])
    assert suggestion == "; did you mean 'R_Tez' and 'alpha'?"
    assert did_you_mean(["xyz"], ["R_Tez"]) == ""
    assert did_you_mean([], ["R_Tez"]) == ""


@pytest.mark.parametrize(
    ("ask", "name"),
    [
        (lambda: RECORDED.select(["T1l"]), "T1[12]"),
        (lambda: simulate(Twin("single-cell"), experiment("T1")), "T"),
        (lambda: simulate_batch(Twin("single-cell"), DRIVE, {"R_los": [1.0]}), "R_loss"),
        (lambda: match(Twin("single-cell"), measured(), free=["C_laod"]), "C_load"),
        (lambda: Twin("single-cell", {"R_los": 1.0}), "R_loss"),
        (lambda: load_rig("dual-cel"), "dual-cell"),
        (lambda: Twin("dual-cell").module("P11"), "P[12]"),
        (lambda: ByRecording({"monday": 1})["mondya"], "monday"),
    ],
)
def test_a_mistyped_name_is_answered_with_the_nearest(ask: Callable[[], object], name: str):
    with pytest.raises(JaxtwinError, match=f"did you mean '{name}'"):
        ask()


def experiment(channel: str) -> Experiment:
    return Experiment.schedule("0:0.5", duration=3, channels=(channel,))


def measured() -> Experiment:
    return Experiment([0, 1], [0, 1], channels=("T",), temperatures=[20, 21])
