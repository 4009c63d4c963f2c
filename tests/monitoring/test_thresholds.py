"""A calibration is kept to the last bit, and refused where it is wrong."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from jaxtwin.errors import ObserverError
from jaxtwin.monitoring import MonitorCalibration, Reference, Tail
from jaxtwin.monitoring._thresholds import FAMILIES, nominal_calibration

POSITIVE = some.floats(min_value=1e-300, max_value=1e300, allow_subnormal=False)
NAMES = some.text(
    some.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1, max_size=5
)
TAILS = some.tuples(
    some.floats(-1e6, 1e6),
    POSITIVE,
    POSITIVE,
    some.sampled_from(["recordings", "simulations", "usual"]),
    some.floats(0, 1e6),
    some.floats(0, 1e6),
)
REFERENCES = some.tuples(some.floats(-1e6, 1e6), some.floats(0, 1e6), some.integers(1, 99))


@settings(max_examples=40, deadline=None)
@given(
    sample_time=POSITIVE,
    numbers=some.dictionaries(NAMES, POSITIVE, max_size=3),
    memory=some.dictionaries(NAMES, some.floats(-0.9, 0.9), max_size=3),
    tails=some.fixed_dictionaries(
        {family: some.lists(TAILS, min_size=1, max_size=2) for family in FAMILIES}
    ),
    references=some.dictionaries(NAMES, REFERENCES, max_size=3),
)
def test_a_file_keeps_a_calibration_to_the_last_bit(
    sample_time, numbers, memory, tails, references
):
    calibration = MonitorCalibration(
        sample_time=sample_time,
        scales=numbers,
        memory=memory,
        tails={name: tuple(Tail(*one) for one in several) for name, several in tails.items()},
        still=numbers,
        references={name: Reference(*one) for name, one in references.items()},
    )
    with tempfile.TemporaryDirectory() as folder:
        assert MonitorCalibration.load(calibration.save(Path(folder) / "c.toml")) == calibration


@settings(max_examples=60, deadline=None)
@given(place=some.integers(0, 10**6), text=some.text(max_size=4))
def test_a_damaged_file_is_read_or_refused_with_its_name(place: int, text: str):
    with tempfile.TemporaryDirectory() as folder:
        path = nominal_calibration(("T1",), 1.0).save(Path(folder) / "c.toml")
        whole = path.read_text(encoding="utf-8")
        place = place % len(whole)
        damaged = whole[:place] + text + whole[place + 2 :]
        path.write_bytes(damaged.encode("utf-8", "surrogatepass"))
        message = ""
        try:
            MonitorCalibration.load(path).for_seconds(86_400.0)
        except ObserverError as error:
            message = str(error)
    assert not message or message.startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sample_time_s = 1.0", "", "sample_time_s: expected a number above 0, got None"),
        ('"T1" = 1.0', '"T1" = true', "scales.T1: expected a number above 0, got True"),
        (
            '[memory]\n"T1" = 0.0',
            '[memory]\n"T1" = 1.5',
            "memory.T1: expected a number above -1 and below 1, got 1.5",
        ),
        ("[still]", "[stil]", "still: expected a table, got None"),
        ("[[tails.joint]]", "[[tails.joined]]", "tails.joint: expected tables, got None"),
        ('source = "usual"', "source = 1", "tails.sum: expected source, hours and spread"),
    ],
)
def test_a_wrong_entry_is_refused_by_file_and_name(
    tmp_path: Path, old: str, new: str, message: str
):
    path = nominal_calibration(("T1",), 1.0).save(tmp_path / "c.toml")
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(ObserverError, match=rf"c\.toml: {message}"):
        MonitorCalibration.load(path)


def test_a_longer_time_has_higher_thresholds_and_the_highest_tail_counts():
    calibration = nominal_calibration(("T1",), 1.0)
    day, month = calibration.for_seconds(86_400.0), calibration.for_seconds(30 * 86_400.0)
    assert all(month[family] > day[family] for family in FAMILIES)
    wide = Tail(0.0, 1.0, 100.0, "recordings")
    several = calibration.with_tails({"sum": (Tail(1.0, 1.0, 1.0, "simulations"), wide)})
    assert several.deciding("sum", 86_400.0) == wide
    assert several.threshold("sum", 86_400.0) == wide.threshold(86_400.0)
    assert several.tails["ratio"] == calibration.tails["ratio"]
