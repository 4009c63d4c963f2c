"""References as text: held, along a line, and along an S-curve."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.control.loops._references import reference_samples

TIMES = np.arange(0.0, 101.0, 5.0)


def test_a_ramp_is_a_line_that_ends_at_its_time():
    found = reference_samples("test", "0:16, 20:20, ramp 60:40, 80:30", TIMES, 1)[:, 0]
    held = np.where(TIMES < 20, 16.0, np.where(TIMES < 80, 40.0, 30.0))
    rising = (TIMES >= 20) & (TIMES < 60)
    expected = np.where(rising, np.interp(TIMES, [20, 60], [20, 40]), held)
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_a_curve_is_level_at_both_ends_and_half_way_at_half_the_time():
    times = np.linspace(0, 100, 100_001)
    found = reference_samples("test", "0:10/20,curve 100:30/-20", times, 2)
    np.testing.assert_allclose(found[[0, 50_000, -1]], [[10, 20], [20, 0], [30, -20]], atol=1e-12)
    rates = np.gradient(found, times, axis=0)
    np.testing.assert_allclose(rates[[0, -1]], 0, atol=1e-3)
    np.testing.assert_allclose(rates[50_000], 1.5 * np.array([0.2, -0.4]), rtol=1e-6)


@given(
    st.sampled_from(["ramp", "curve"]),
    st.lists(st.floats(-50, 150), min_size=2, max_size=6),
)
def test_a_change_stays_between_its_ends_and_meets_them(shape: str, values: list[float]):
    ends = np.linspace(0, 100, len(values))
    first, *others = (
        f"{time!r}:{value!r}" for time, value in zip(ends.tolist(), values, strict=True)
    )
    text = ",".join([first, *(f"{shape} {entry}" for entry in others)])
    times = np.union1d(TIMES, ends)
    found = reference_samples("test", text, times, 1)[:, 0]
    np.testing.assert_allclose(found[np.searchsorted(times, ends)], values, atol=1e-9)
    for a, b, low, high in zip(ends, ends[1:], values, values[1:], strict=False):
        inside = found[(times >= a) & (times <= b)]
        assert inside.min() >= min(low, high) - 1e-9
        assert inside.max() <= max(low, high) + 1e-9
