"""A controller whose heaters are switched by relays with minimum times, in Python, files and C."""

from itertools import groupby
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from compiled_c import compiled, ran
from heated_box import cell_and_heater, heated_box
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import Twin
from jaxtwin.c_export import export_c
from jaxtwin.control import (
    PID,
    GainScheduled,
    LiveLoop,
    TimeProportional,
    loop_margins,
    read_controller,
    save_controller,
    simulate_closed_loop,
)
from jaxtwin.errors import ControlError
from jaxtwin.rig import Rig


@pytest.fixture(scope="module", name="rig")
def make_rig() -> Rig:
    return cell_and_heater("on-off")


@pytest.mark.slow
@given(
    st.integers(2, 12),
    st.floats(0, 1),
    st.floats(0, 1),
    st.lists(st.one_of(st.just(0.0), st.just(1.0), st.floats(0, 1)), min_size=1, max_size=40),
)
@settings(deadline=None, max_examples=50)
def test_phases_are_long_enough_and_the_mean_is_kept(window, on, off, asked):
    """With a PID of gain 1 the duty is the reference less the measurement."""
    h = 0.5
    relay = TimeProportional(
        PID(1.0, limits=(0, 1), sample_time_s=h),
        period_s=window * h,
        minimum_on_s=on * window * h,
        minimum_off_s=off * window * h,
    )
    with jax.enable_x64(True):
        step = jax.jit(lambda *args: relay.step(*args))
        state = relay.init(np.zeros(1), np.zeros(1))
        levels = []
        for duty in asked:
            for _ in range(window):
                level, state = step(state, np.array([duty]), np.zeros(1))
                levels.append(float(level[0]))
    assert set(levels) <= {0.0, 1.0}
    phases = [(level, h * len(list(group))) for level, group in groupby(levels)]
    for level, length in phases[:-1]:
        assert length >= (relay.minimum_on_s if level else relay.minimum_off_s) - 1e-9
    assert abs(sum(levels) - window * sum(asked)) <= window / 2 + 1e-6


def test_the_mean_of_a_loop_is_that_of_its_controller_and_shows_the_ripple(rig: Rig):
    """Heaters are 0 or 1, the cell has its duty, and the temperature swings about the reference."""
    twin, pid = Twin(rig), PID(0.1, 0.002)
    relay = TimeProportional(pid, period_s=20, minimum_on_s=2, minimum_off_s=3)
    run = simulate_closed_loop(twin, relay, 40, duration=1500)
    assert set(np.unique(run.duty[:, 1:])) == {0, 1}
    mean = simulate_closed_loop(twin, pid, 40, duration=1500)
    late = run.loop.time > 900
    assert np.all((run.duty[late, 0] > 0.05) & (run.duty[late, 0] < 0.95))
    np.testing.assert_allclose(
        run.duty[late, 1:].mean(axis=0), mean.duty[late, 1:].mean(axis=0), atol=0.03
    )
    output = run.output[late, 0]
    assert output.mean() == pytest.approx(40, abs=0.1)
    assert 0.05 < np.ptp(output) < 5


def test_a_loop_is_checked_by_its_mean(rig: Rig):
    twin = Twin(rig)
    fast = TimeProportional(PID(20.0, 5.0), period_s=10)
    with pytest.raises(ControlError, match=r"expected one with which .* is stable"):
        LiveLoop(twin, fast, "0:30", duration=60)
    usual = PID(0.1, 0.002)
    relay = TimeProportional(usual, period_s=10)
    assert loop_margins(twin, relay, 40).is_stable
    np.testing.assert_array_equal(
        loop_margins(twin, relay, 40).response, loop_margins(twin, usual, 40).response
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"period_s": 1.0},
            "period_s: expected a multiple of the sample time of 1 s, at least",
        ),
        ({"period_s": 10.5}, "period_s: expected a multiple of the sample time of 1 s"),
        ({"period_s": -10}, "period_s: expected a multiple"),
        (
            {"period_s": 10, "minimum_on_s": 11},
            "minimum_on_s: expected a number from 0 to 10, in s",
        ),
        ({"period_s": 10, "minimum_off_s": -1}, "minimum_off_s: expected a number from 0 to 10"),
        ({"period_s": np.nan}, "period_s: expected a finite number"),
    ],
)
def test_wrong_times_are_refused(settings: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        TimeProportional(PID(0.1), **settings)


def test_rigs_that_it_cannot_switch_are_refused():
    relay = TimeProportional(PID(0.1), period_s=10)
    with pytest.raises(ControlError, match="expected a rig with heaters, got dual-cell"):
        relay.for_rig(Twin("dual-cell").rig)
    own = heated_box(('power = "12 W"', 'power = "12 W"\ntime_proportional = { period = "10 s" }'))
    with pytest.raises(ControlError, match="got bulb of heated box, which its device switches"):
        relay.for_rig(own)


def test_a_duty_that_is_no_number_is_not_hidden(rig: Rig):
    relay = TimeProportional(PID(0.1), period_s=4).for_rig(rig)
    duty, _ = relay.step(
        relay.init(np.zeros(3), np.array([20.0])), np.array([20.0]), np.array([np.nan])
    )
    assert np.isnan(np.asarray(duty)).all()


CONTROLLERS = {
    "pid": PID(0.2, 0.004, 0.1, 2.0, setpoint_weight=0.8),
    "scheduled": GainScheduled([PID(0.1, 0.001), PID(0.2, 0.002)], at=[20.0, 40.0]),
}


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_its_file_has_the_controller_in_a_table(rig: Rig, tmp_path: Path, kind: str):
    relay = TimeProportional(
        CONTROLLERS[kind], period_s=20, minimum_on_s=2, minimum_off_s=3
    ).for_rig(rig)
    file = tmp_path / "relay.toml"
    save_controller(file, relay, rig)
    read = read_controller(file, rig)
    assert isinstance(read, TimeProportional)
    assert jax.tree.structure(read) == jax.tree.structure(relay)
    for found, expected in zip(jax.tree.leaves(read), jax.tree.leaves(relay), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('Kp = "0.2 1/K"', 'Kp = "0.2 K"', r"relay.toml: controller\.Kp: expected a gain"),
        ('kind = "pid"', 'kind = "pidd"', r"relay.toml: controller\.kind: expected one of"),
        (
            'kind = "pid"',
            'kind = "pid"\nlimits = [0, 1]',
            r"controller\.limits: expected it",
        ),
        ('period = "20.0 s"', 'period = "1 s"', "relay.toml: .*period_s: expected a multiple"),
    ],
)
def test_wrong_files_are_refused(rig: Rig, tmp_path: Path, old: str, new: str, message: str):
    file = tmp_path / "relay.toml"
    save_controller(file, TimeProportional(CONTROLLERS["pid"], period_s=20), rig)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(ControlError, match=message):
        read_controller(file, rig)


@pytest.mark.c_compiler
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize(
    ("period", "on", "off", "precision"),
    [(12, 3, 2, "double"), (5, 3, 4, "double"), (4, 0, 0, "double"), (12, 3, 2, "float")],
)
def test_the_c_switches_as_python_does(rig: Rig, tmp_path: Path, period, on, off, precision: Any):
    relay = TimeProportional(
        PID(0.05, 0.004), period_s=period, minimum_on_s=on, minimum_off_s=off
    ).for_rig(rig)
    sources = export_c(relay, tmp_path, rig=rig, name="loop", precision=precision)
    program = compiled(sources, MAIN)
    time = np.arange(600)
    rows = np.stack([20 + 8 * np.sin(time / 40), 20 + 3 * np.cos(time / 17)], axis=1)
    found = ran(program, rows)
    state = relay.init(np.zeros(3), rows[0, 1:])
    step = jax.jit(lambda *args: relay.step(*args))
    expected = []
    for reference, reading in rows:
        duty, state = step(state, np.array([reference]), np.array([reading]))
        expected.append(np.asarray(duty))
    assert set(np.unique(np.array(expected)[:, 1:])) == {0, 1}
    np.testing.assert_allclose(found, expected, atol=1e-12 if precision == "double" else 1e-5)


MAIN = """
#include <stdio.h>
#include "loop.h"
int main(void)
{
    double r, y;
    loop_state state;
    int is_first = 1, i;
    while (scanf("%lf %lf", &r, &y) == 2) {
        loop_real reference[LOOP_OUTPUTS], reading[LOOP_READINGS], duty[LOOP_CELLS];
        reference[0] = (loop_real)r;
        reading[0] = (loop_real)y;
        for (i = 0; i < LOOP_CELLS; ++i) {
            duty[i] = 0;
        }
        if (is_first) {
            loop_init(&state, duty, reading);
            is_first = 0;
        }
        loop_step(&state, reference, reading, duty);
        for (i = 0; i < LOOP_CELLS; ++i) {
            printf("%.17g ", (double)duty[i]);
        }
        printf("\\n");
    }
    return 0;
}
"""
