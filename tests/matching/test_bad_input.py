"""What cannot be matched is refused before anything is computed, with a sentence that says why."""

from dataclasses import replace

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, match
from jaxtwin.errors import MatchError, ParameterError
from jaxtwin.matching import named_recordings

FREE = ["C_load", "T_amb", "T_start"]
TIME = np.arange(0, 60, 2.0)


def recording(seen: np.ndarray | float = 18.0, duty: float = 0.4, name: str = "x") -> Experiment:
    temperatures = np.broadcast_to(seen, TIME.shape)[:, None]
    return Experiment(
        TIME, np.full((30, 1), duty), channels=("T",), temperatures=temperatures, name=name
    )


WARMING = 18 + 0.2 * TIME


@pytest.mark.parametrize("given", [("x", "x (2)", "x"), ("x", "x (3)", "x"), ("x", "x", "x (2)")])
def test_no_two_recordings_share_a_name(given: tuple[str, ...]):
    runs = [recording(name=name) for name in given]
    names = list(named_recordings(Twin("single-cell"), runs))
    assert len(set(names)) == 3
    assert names[0] == "x"
    assert all(name.startswith("x") for name in names)


def test_a_name_that_is_there_once_stays():
    runs = [recording(name=name) for name in ("x", "x", "x (2)", "y")]
    names = list(named_recordings(Twin("single-cell"), runs))
    assert names[2:] == ["x (2)", "y"]


def test_readings_that_never_change_without_a_drive_tell_nothing():
    words = "x: expected a recording with some excitation, got none: every duty cycle is 0"
    with pytest.raises(MatchError, match=words):
        match(Twin("single-cell"), recording(18.0, 0.0), free=FREE)


@pytest.mark.parametrize(("left", "samples"), [(2.0, 1), (4.0, 2), (6.0, 3)])
def test_masks_must_leave_more_samples_than_unknowns(left: float, samples: int):
    words = f"more samples than the 3 unknowns.* got {samples} samples, the others are masked"
    with pytest.raises(MatchError, match=words):
        match(Twin("single-cell"), recording(WARMING), free=FREE, masks={"x": [(left, 58.0)]})


@pytest.mark.parametrize("name", ["R_E", "C_load"])
def test_a_parameter_with_several_values_is_refused(name: str):
    """Whether it is held or matched."""
    twin = Twin("single-cell").with_values({name: [1.5, 2.0]})
    with pytest.raises(ParameterError, match=f"parameter {name}: expected one value, got 2"):
        match(twin, recording(WARMING), free=FREE)


@pytest.mark.parametrize("spread", [1e308, 1e-200])
def test_a_prior_spread_whose_square_is_no_number_is_refused(spread: float):
    rig = Twin("single-cell").rig
    table = {**rig.parameters, "C_load": replace(rig.parameters["C_load"], prior_spread=spread)}
    with pytest.raises(MatchError, match=r"C_load: expected a prior spread of 1e-100 .*, got 1e"):
        match(Twin(replace(rig, parameters=table)), recording(WARMING), free=FREE)


def test_bounds_beside_the_free_names_are_refused_and_not_dropped():
    with pytest.raises(MatchError, match=r"free: .* give bounds as bounds=\{'C_load': \(1, 5\)\}"):
        match(Twin("single-cell"), recording(WARMING), free={"C_load": (1, 5)})


def test_a_recording_counts_once_under_any_name():
    several = [recording(WARMING, name="a"), recording(WARMING, name="b")]
    with pytest.raises(MatchError, match="experiments: b is the same recording as a"):
        match(Twin("single-cell"), several, free=FREE)


def test_a_recording_that_begins_beyond_the_bounds_of_its_start_is_refused():
    words = (
        r"x: temperatures: expected a start within the bounds of T_start, -10 to 100 degC, "
        r"got 108\.0 degC; other bounds are given by bounds="
    )
    with pytest.raises(MatchError, match=words):
        match(Twin("single-cell"), recording(WARMING + 90), free=FREE)
