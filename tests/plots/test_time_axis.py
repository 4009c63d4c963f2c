"""The axis of time is in a unit that can be read, or shows the clock of a recording with a date."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import pyplot

from jaxtwin.plots._panels import time_axis


def labels(time: list[float], start: datetime | None = None) -> tuple[str, list[str]]:
    figure, axes = pyplot.subplots()
    axes.plot(time, time)
    axes.set_xlim(time[0], time[-1])
    time_axis(axes, np.array(time), start)
    figure.canvas.draw()
    texts = [text.get_text() for text in axes.get_xticklabels()]
    pyplot.close(figure)
    return axes.get_xlabel(), texts


@pytest.mark.parametrize(
    ("last", "label", "texts"),
    [
        (1000.0, "time, s", ["0", "200", "400", "600", "800", "1000"]),
        (7200.0, "time, min", ["0", "20", "40", "60", "80", "100", "120"]),
        (36_000.0, "time, h", ["0", "2", "4", "6", "8", "10"]),
        (864_000.0, "time, days", ["0", "2", "4", "6", "8", "10"]),
    ],
)
def test_the_unit_is_one_that_can_be_read(last: float, label: str, texts: list[str]) -> None:
    assert labels([0.0, last]) == (label, texts)


def test_a_recording_with_a_date_shows_its_clock() -> None:
    start = datetime(2024, 5, 3, 18, 50, 30)
    label, texts = labels([0.0, 3000.0], start)
    assert (label, texts[0], texts[-1]) == ("time of 3 May 2024", "19:00", "19:40")


def test_midnight_is_its_day() -> None:
    label, texts = labels([0.0, 3 * 86_400.0], datetime(2024, 5, 31, 12, 0))
    assert label == "time, from 31 May 2024 to 3 Jun 2024"
    assert "1 Jun" in texts
    assert "12:00" in texts


@given(
    st.floats(-1e6, 1e6),
    st.floats(1.0, 1e7),
    st.none() | st.datetimes(datetime(1990, 1, 1), datetime(2090, 1, 1)),
)
def test_any_time_has_a_few_ticks_within_it(
    first: float, length: float, start: datetime | None
) -> None:
    figure, axes = pyplot.subplots()
    axes.set_xlim(first, first + length)
    time_axis(axes, np.array([first, first + length]), start)
    ticks = axes.get_xticks()
    assert 1 <= len(ticks) <= 13
    tolerance = 1e-6 * (length + abs(first))
    assert first - tolerance <= ticks[0]
    assert ticks[-1] <= first + length + tolerance
    if start is not None:
        moment = start + timedelta(seconds=float(ticks[0]))
        second = moment.second + moment.microsecond / 1e6
        assert abs(second - round(second)) < 1e-2
    pyplot.close(figure)
