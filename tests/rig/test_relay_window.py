"""A relay with a window: its minimum times hold, and the mean over many windows is the duty."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
import pytest
from heated_box import heated_box
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RigError
from jaxtwin.rig._heater import RelayWindow


@st.composite
def relays(draw: st.DrawFn) -> RelayWindow:
    period = draw(st.floats(0.1, 60))
    shortest = st.floats(0, 1).map(lambda part: part * period)
    return RelayWindow(period, draw(shortest), draw(shortest))


duties = st.one_of(st.just(0.0), st.just(1.0), st.floats(0, 1))


def phases(relay: RelayWindow, asked: list[float]) -> tuple[Sequence[tuple[bool, float]], float]:
    """The phases, on or off with their lengths, and the time on in all."""
    carried, parts, total = 0.0, [], 0.0
    for duty in asked:
        on, carried = relay.on_time(duty, carried)
        total += on
        parts += [(True, on), (False, relay.period - on)]
    joined = [
        (level, sum(length for _, length in group))
        for level, group in groupby(
            [part for part in parts if part[1] > 0], key=lambda part: part[0]
        )
    ]
    return joined, total


@given(relays(), st.lists(duties, min_size=1, max_size=60))
def test_each_phase_is_long_enough_and_the_mean_is_kept(relay: RelayWindow, asked):
    """The last phase may go on."""
    joined, total = phases(relay, asked)
    for is_on, length in joined[:-1]:
        assert length >= (relay.minimum_on if is_on else relay.minimum_off) - 1e-9
    # Half of the widest step between two on times that may be chosen.
    between = relay.minimum_on <= relay.period - relay.minimum_off
    quantum = max(relay.minimum_on, relay.minimum_off) if between else relay.period
    assert abs(total - relay.period * sum(asked)) <= quantum / 2 + 1e-9 * len(asked)


@given(relays(), st.floats(0.001, 0.999))
def test_a_constant_duty_is_the_mean_of_many_windows(relay: RelayWindow, duty: float):
    _, total = phases(relay, [duty] * 400)
    assert total / (400 * relay.period) == pytest.approx(duty, abs=0.5 / 400)


def test_short_times_are_gathered():
    """A duty of 0.1 of 10 s with at least 4 s on is a pulse of 4 s in two windows of five."""
    relay = RelayWindow(10.0, minimum_on=4.0)
    carried, on = 0.0, []
    for _ in range(10):
        time, carried = relay.on_time(0.1, carried)
        on.append(time)
    assert set(on) == {0.0, 4.0}
    assert abs(sum(on) - 10) <= 2


def box(table: str):
    return heated_box(('power = "12 W"', f'power = "12 W"\ntime_proportional = {table}'))


def test_a_rig_file_states_it():
    rig = box('{ period = "10 s", minimum_on = "1500 ms" }')
    assert [heater.time_proportional for heater in rig.heaters] == [
        None,
        RelayWindow(10.0, 1.5, 0.0),
    ]
    assert rig.fingerprint == heated_box().fingerprint  # a twin has the mean


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            '{ period = "10 s", minimum_on = "11 s" }',
            r"heaters\[bulb\]\.time_proportional\.minimum_on: expected at most the period of",
        ),
        (
            '{ period = "10 s", minimum_off = "-1 s" }',
            r"minimum_off: expected .*got '-1 s'",
        ),
        ('{ period = "0 s" }', r"time_proportional\.period: expected .*got '0 s'"),
        ('{ period = "10 K" }', r"period: expected a time above 0"),
        ('{ minimum_on = "1 s" }', r"period"),
        ('{ period = "10 s", minimum = "1 s" }', r"minimum"),
    ],
)
def test_wrong_tables_are_refused(table: str, message: str):
    with pytest.raises(RigError, match=message):
        box(table)


def test_numbers_are_those_of_the_rule():
    relay = RelayWindow(10.0, 2.0, 3.0)
    assert relay.on_time(0.5, 0.0) == (5.0, 0.0)
    assert relay.on_time(0.05, 0.0) == (0.0, 0.5)
    assert relay.on_time(0.15, 0.0) == (2.0, -0.5)
    assert relay.on_time(0.8, 0.0) == (7.0, 1.0)
    assert relay.on_time(0.9, 0.0) == (10.0, -1.0)
    assert relay.on_time(0.0, 1.0) == (0.0, 1.0)
    assert relay.on_time(1.0, -1.0) == (10.0, -1.0)
    np.testing.assert_allclose(relay.on_time(0.1, 0.6), (2.0, -0.4))
