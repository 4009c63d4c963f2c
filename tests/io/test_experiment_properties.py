"""Facts about every experiment: round trips through files, splits, and single wrong numbers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, read_recording, write_recording

channel_names = st.from_regex(r"\w([\w .-]{0,6}\w)?", fullmatch=True).filter(
    lambda name: name != "ambient"
)


@st.composite
def contents(draw, fewest: int = 2) -> dict[str, Any]:
    """What an experiment without a gap may hold, by field.

    Not yet the experiment: its types are checked on samples that beartype draws at random, and
    hypothesis allows no other randomness in a strategy.
    """
    n = draw(st.integers(fewest, 12))
    steps = draw(npst.arrays(np.float64, n - 1, elements=st.floats(0.5, 1.4)))
    cells = draw(st.integers(1, 3))
    channels = draw(st.lists(channel_names, max_size=3, unique=True))
    degC = st.floats(-120, 84)  # elsewhere are codes of sensors, and rooms in kelvin
    fields = {
        "time": draw(st.floats(-1e6, 1e6)) + np.concatenate([[0.0], np.cumsum(steps)]),
        "duty": draw(npst.arrays(np.float64, (n, cells), elements=st.floats(-1, 1))),
        "channels": channels,
        "ambient": draw(st.none() | degC | npst.arrays(np.float64, n, elements=degC)),
    }
    if channels and draw(st.booleans()):
        shape = (n, len(channels))
        missing = draw(npst.arrays(bool, shape).filter(lambda holes: not holes.all()))
        temperatures = draw(npst.arrays(np.float64, shape, elements=degC))
        fields["temperatures"] = np.where(missing, np.nan, temperatures)
    return fields


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder for all the examples of this module."""
    return tmp_path_factory.mktemp("recordings")


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".nc"])
@given(fields=contents())
def test_a_file_gives_back_every_number_to_the_last_bit(folder, ending, fields):
    experiment = Experiment(**fields)
    again = read_recording(write_recording(experiment, folder / f"run{ending}"))
    assert again == experiment
    assert again.channels == experiment.channels
    for field in ("time", "duty", "temperatures", "ambient"):
        was, now = getattr(experiment, field), getattr(again, field)
        assert (was is None) == (now is None)
        assert was is None or np.array_equal(was, now, equal_nan=True)
    assert again.name == "run"
    assert [file.name for file in folder.iterdir() if file.stem != "run"] == []


def _both_recorded(experiment: Experiment, t: float) -> bool:
    late = experiment.time >= t
    return bool(experiment.sampled[late].any() and experiment.sampled[~late].any())


@given(fields=contents(fewest=4), data=st.data())
def test_two_parts_share_no_sample_and_lose_none(fields, data):
    experiment = Experiment(**fields)
    t = float(experiment.time[data.draw(st.integers(2, len(experiment.time) - 2))])
    assume("temperatures" not in fields or _both_recorded(experiment, t))
    early, late = experiment.between(None, t), experiment.between(t, None)
    np.testing.assert_array_equal(np.concatenate([early.time, late.time]), experiment.time)
    np.testing.assert_array_equal(np.concatenate([early.duty, late.duty]), experiment.duty)


@given(fields=contents(), data=st.data(), wrong=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_one_number_that_is_not_finite_is_found_wherever_it_stands(fields, data, wrong):
    held = [field for field in fields if isinstance(fields[field], np.ndarray)]
    field = data.draw(st.sampled_from(held))
    if np.isnan(wrong) and field not in ("time", "duty"):
        wrong = np.inf  # temperatures may miss samples
    fields[field].flat[data.draw(st.integers(0, fields[field].size - 1))] = wrong
    with pytest.raises(RecordingError, match=f"{field.rstrip('s')}.* got {wrong} at sample"):
        Experiment(**fields)


@given(fields=contents(), data=st.data())
def test_two_times_in_the_wrong_order_are_found(fields, data):
    k = data.draw(st.integers(0, len(fields["time"]) - 2))
    fields["time"][[k, k + 1]] = fields["time"][[k + 1, k]]
    with pytest.raises(RecordingError, match="expected increasing times"):
        Experiment(**fields)


@given(fields=contents(), data=st.data())
def test_the_fingerprint_changes_with_the_last_bit_of_any_number(fields, data):
    before = Experiment(**fields).fingerprint
    held = [field for field in ("duty", "temperatures") if field in fields]
    field = data.draw(st.sampled_from(held))
    index = data.draw(st.integers(0, fields[field].size - 1))
    assume(not np.isnan(fields[field].flat[index]))
    fields[field].flat[index] = np.nextafter(fields[field].flat[index], 0.1)
    assert Experiment(**fields).fingerprint != before or fields[field].flat[index] == 0.1
