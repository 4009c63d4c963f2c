"""Quantities in other units than those of jaxtwin: converted, or refused in one sentence."""

from typing import Any

import numpy as np
import pint
import pytest

import jaxtwin as jt
from jaxtwin._arguments import finite_number
from jaxtwin.errors import MatchError, ParameterError, RecordingError

UNITS: Any = pint.UnitRegistry()


def test_quantities_of_pint_are_converted():
    """70 degF are 21.1 degC; 1 min is 60 s."""
    found = jt.Experiment(
        UNITS.Quantity([0, 1, 2], "min"),
        UNITS.Quantity([50, 50, 0], "percent"),
        channels=["T"],
        temperatures=UNITS.Quantity([68, 70, 72], "degF"),
        ambient=UNITS.Quantity(293.15, "K"),
    )
    assert found.time.tolist() == [0, 60, 120]
    assert found.duty[:, 0].tolist() == [0.5, 0.5, 0]
    assert found.temperatures is not None
    np.testing.assert_allclose(found.temperatures[:, 0], [20, 21.11, 22.22], atol=0.01)
    assert found.ambient == pytest.approx(20)
    with pytest.raises(RecordingError, match="time: expected s, got volt"):
        jt.Experiment(UNITS.Quantity([0, 1], "V"), [0, 0])


@pytest.mark.parametrize("duration", [600, "10 min", UNITS.Quantity(10, "min")])
def test_a_schedule_takes_times_with_units(duration):
    assert jt.Experiment.schedule("0:0.5", duration=duration, step="1 min").duration == 600


def test_a_schedule_refuses_other_quantities():
    with pytest.raises(
        RecordingError, match=r"duration: expected a number in s, or text .* '10 K'"
    ):
        jt.Experiment.schedule("0:0.5", duration="10 K")


def test_values_of_parameters_take_units():
    twin = jt.Twin("dual-cell", {"R_E": "1900 mohm", "T_amb": "295.15 K"})
    assert (twin.values["R_E"], twin.values["T_amb"]) == (pytest.approx(1.9), pytest.approx(22))
    by_pint = twin.with_values({"R_E": UNITS.Quantity(0.002, "kohm")})
    assert by_pint.values["R_E"] == pytest.approx(2)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            {"R_E": "2 m"},
            "parameter R_E: expected finite numbers, got '2 m', .* 'm' does not measure",
        ),
        (
            {"R_E": "two"},
            "parameter R_E: expected finite numbers, got 'two', .*; they are in ohm, or",
        ),
        ({"R_E": UNITS.Quantity(2, "m")}, "parameter R_E: expected ohm, got meter"),
        (
            {"T_amb": 295.15},
            'expected 5 to 30 degC, got 295.15; in K, .* 22 degC: write "295.15 K"',
        ),
    ],
)
def test_values_in_another_unit_are_refused(values, said):
    with pytest.raises(ParameterError, match=said):
        jt.Twin("dual-cell", values)


def test_numbers_elsewhere_have_no_unit():
    """A conversion to a number would lose it."""
    with pytest.raises(RecordingError, match="t0: expected a finite number without a unit"):
        finite_number("t0", UNITS.Quantity(1, "min"), RecordingError)


def test_an_ambient_temperature_in_kelvin_is_refused():
    with pytest.raises(RecordingError, match=r"ambient: .* got 294; in K, that is 20.85 degC"):
        jt.Experiment([0, 1], [0, 0], ambient=294)


def test_times_in_nanoseconds_are_refused():
    with pytest.raises(RecordingError, match=r"a hundred years, got 2e.12; are they in ms or ns"):
        jt.Experiment([0, 1e12, 2e12], [0, 0, 0])


@pytest.mark.slow
def test_a_recording_in_kelvin_is_not_matched():
    twin = jt.Twin("dual-cell")
    run = twin.simulate(jt.Experiment.schedule("0:0.5", duration=30, cells=2))
    recording = run.to_recording(seed=1, name="bench")
    assert recording.temperatures is not None
    kelvin = jt.Experiment(
        recording.time,
        recording.duty,
        channels=recording.channels,
        temperatures=recording.temperatures + 273.15,
    )
    with pytest.raises(
        MatchError, match=r"recording 1: temperatures: expected degC, got 289.* in K"
    ):
        jt.match(twin, kelvin)


@pytest.mark.slow
def test_a_match_takes_files_and_goes_on_behind_gaps(tmp_path):
    """The duty is held in the gap, and is in counts of the rig's driver."""
    twin = jt.Twin("single-cell")
    run = twin.simulate(jt.Experiment.schedule("0:0.5,80:0", duration=120, cells=1))
    recording = run.to_recording(seed=1)
    there = (recording.time < 50) | (recording.time > 70)
    assert recording.temperatures is not None
    table = {
        "time_s": recording.time[there],
        **{f"pwm_P{k + 1}": 255 * duty for k, duty in enumerate(recording.duty[there].T)},
        **{
            f"{name}_degC": values
            for name, values in zip(
                recording.channels, recording.temperatures[there].T, strict=True
            )
        },
    }
    lines = [
        ",".join(table),
        *(",".join(map(repr, map(float, row))) for row in zip(*table.values(), strict=True)),
    ]
    path = tmp_path / "bench.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    fit = jt.match(twin, path, free=["R_E"], max_iterations=3)
    assert list(fit.runs) == ["bench"]
    assert fit["R_E"].value == pytest.approx(float(np.asarray(twin.values["R_E"])), rel=0.02)
    assert "bench: the duty is held over a gap of 22 s behind 49 s" in fit.summary()
    assert "bench: the duty is held over a gap" in jt.validate(fit, path, warm_up=20).summary()
    split = jt.match(twin, path, free=["R_E"], max_iterations=3, gaps="split")
    assert list(split.runs) == ["bench part 1", "bench part 2"]
