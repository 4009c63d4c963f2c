"""Control of a rig with a cell, which also cools, and heaters, which cannot: each has limits of its
own."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from compiled_c import compiled, ran
from heated_box import cell_and_heater, heated_box

from jaxtwin import Twin, linearize
from jaxtwin.c_export import export_c
from jaxtwin.control import (
    PID,
    AbstractController,
    DecoupledPI,
    LiveLoop,
    Relay,
    design_lqi,
    design_mpc,
    design_uniformity_mpc,
    most_even_point,
    read_controller,
    save_controller,
    simulate_closed_loop,
)
from jaxtwin.control.loops._measures import saturation_share
from jaxtwin.errors import ControlError
from jaxtwin.rig import Rig

# The limits of a cell, P1, and of the heaters foil and wire.
EACH = ((-1.0, 0.0, 0.0), 1.0)


@pytest.fixture(scope="module", name="rig")
def make_rig() -> Rig:
    return cell_and_heater("on-off")


@pytest.fixture(scope="module", name="twin")
def make_twin(rig: Rig) -> Twin:
    return Twin(rig)


def controllers(twin: Twin, **settings: Any) -> list[AbstractController]:
    model = linearize(twin, duty=[0.2, 0.2, 0.2]).discretise(1.0)
    return [
        PID(0.2, 0.004, **settings),
        PID(0.2, 0.004, anti_windup="clamping", **settings),
        PID(
            [0.2, 0.1, 0.3], [0.004, 0.0, 0.02], 0.1, 2.0, setpoint_weight=[0.5, 1, 0.8], **settings
        ),
        design_lqi(model, **settings),
        design_mpc(model, horizon=8, **settings),
    ]


def test_limits_are_those_of_each(rig: Rig):
    assert PID(0.1).for_rig(rig).limits == EACH
    assert PID(0.1, limits=(-0.5, 0.8)).for_rig(rig).limits == ((-0.5, 0.0, 0.0), 0.8)
    assert PID(0.1, limits=(0.1, 1)).for_rig(rig).limits == (0.1, 1.0)
    own = PID(0.1, limits=((-1, 0, 0.2), (0.3, 0.4, 1)))
    assert own.for_rig(rig).limits == ((-1.0, 0.0, 0.2), (0.3, 0.4, 1.0))
    assert PID(0.1).for_rig(heated_box()).limits == (0, 1)
    assert PID(0.1).for_rig(Twin("dual-cell").rig).limits == (-1, 1)
    assert PID(0.1).for_rig(rig).for_rig(rig).limits == EACH


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            (-1, -0.2),
            "PID: limits: expected a highest duty above 0 for the heater foil of single-cell",
        ),
        (((-1, 0), 1), "PID: limits: expected numbers, or one for each of P1, foil, wire"),
        ((-1, (1, 1, 1, 0.9)), "or one for each of P1, foil, wire of single-cell, got 4"),
    ],
)
def test_limits_that_the_rig_cannot_have_are_refused(rig: Rig, limits, message: str):
    with pytest.raises(ControlError, match=message):
        PID(0.1, limits=limits).for_rig(rig)


@pytest.mark.parametrize("limits", [((0, 0.5), (1, 0.4)), ((-2, 0), 1), (0, 1, 1)])
def test_wrong_limits_are_refused(limits):
    with pytest.raises(ControlError, match="PID: limits: expected the lowest and the highest duty"):
        PID(0.1, limits=limits)


def test_a_rig_of_heaters_alone_still_refuses_limits_below_0():
    with pytest.raises(ControlError, match="expected limits from 0 on, because the heaters"):
        simulate_closed_loop(Twin(heated_box()), PID(0.1, limits=(-1, 1)), "0:30", duration=10)


@pytest.mark.c_compiler
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize(
    ("kinds", "precision", "tolerance"),
    [
        (slice(4), "double", 1e-12),
        pytest.param(slice(4), "float", 1e-5, marks=pytest.mark.slow),
        pytest.param(slice(4, 5), "double", 1e-9, marks=pytest.mark.slow),
        pytest.param(slice(4, 5), "float", 0.01, marks=pytest.mark.slow),
    ],
)
def test_files_and_c_have_the_limits_of_each(
    twin: Twin, rig: Rig, tmp_path: Path, kinds: slice, precision: Any, tolerance: float
):
    """The C commands the duty of Python, also far beyond all limits."""
    for number, controller in enumerate(controllers(twin)[kinds]):
        file = tmp_path / "controller.toml"
        save_controller(file, controller, rig)
        read = read_controller(file, rig)
        assert read.limits == EACH
        folder = tmp_path / f"{precision}{number}"
        sources = export_c(controller, folder, rig=rig, name="loop", precision=precision)
        assert "from -1 to 1 (P1), 0 to 1 (foil, wire)" in sources.header.read_text()
        program = compiled(sources, MAIN)
        sizes = len(controller.output_weights(twin.channels)), len(rig.driven)
        time = np.arange(120)
        rows = np.stack([20 + 25 * np.sin(time / 12), 20 + 3 * np.cos(time / 17)], axis=1)
        rows[0] = 20, 20
        found = ran(program, rows)
        state = read.init(np.zeros(sizes[1]), rows[0, 1:])
        expected, step = [], jax.jit(lambda *args, of=read: of.step(*args))
        for reference, reading in rows:
            duty, state = step(state, np.array([reference]), np.array([reading]))
            expected.append(np.asarray(duty))
        np.testing.assert_allclose(found, expected, atol=tolerance)
        lowest = np.min(expected, axis=0)
        assert lowest[0] < -0.05
        assert lowest[1:].min() >= 0


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


# The largest undershoot, K. An integral for each brought the cell to rest at -0.13 beside heaters
# at 0.38, after 0.35, 2.1, 0.02 and 1.2 K.
MAX_UNDERSHOOT = {
    ("back-calculation", 0.004): 0.1,
    ("back-calculation", 0.02): 1.25,
    ("clamping", 0.004): 0.03,
    ("clamping", 0.02): 1.2,
}


@pytest.mark.parametrize(("anti_windup", "Ki"), MAX_UNDERSHOOT)
def test_cell_and_heaters_do_not_work_against_each_other(twin: Twin, anti_windup: Any, Ki: float):
    """All were at their limits, on the way down the cell at -1 and the heaters at 0."""
    pid = PID(0.2, Ki, anti_windup=anti_windup)
    run = simulate_closed_loop(twin, pid, "0:60,150:25", duration=600)
    assert run.duty.max() > 0.999
    assert run.duty.min(axis=0).tolist() == [-1, 0, 0]
    rest = run.duty[-60:]
    np.testing.assert_array_equal(rest, np.broadcast_to(rest[:, :1], rest.shape))
    assert run.output[-1, 0] == pytest.approx(25, abs=0.01)
    undershoot = 25 - run.output[run.loop.time > 151, 0].min()
    assert undershoot <= MAX_UNDERSHOOT[anti_windup, Ki]


@pytest.mark.parametrize("anti_windup", ["back-calculation", "clamping"])
@pytest.mark.parametrize(
    ("Kp", "Ki", "b", "start"),
    [
        (0.2, 0.004, 1.0, (0.0, 0.0, 0.0)),
        (0.2, 0.004, 0.5, (-0.5, 0.7, 0.0)),
        ([0.2, 0.1, 0.3], [0.004, 0.006, 0.002], [0.2, 0.9, 1.0], (-0.9, 0.1, 1.0)),
        ([0.2, 0.1, 0.3], [0.004, 0.0, 0.002], 1.0, (0.3, 0.2, 0.0)),
    ],
)
@pytest.mark.usefixtures("float64")
def test_at_rest_no_duty_has_the_other_sign(rig: Rig, anti_windup, Kp, Ki, b, start):
    """Whatever gains and set-point weights each has, wherever it started, and after all limits."""
    pid = PID(Kp, Ki, setpoint_weight=b, anti_windup=anti_windup).for_rig(rig)
    state = pid.init(np.array(start), np.array([25.0]))
    first, _ = pid.step(state, np.array([25.0]), np.array([25.0]))
    np.testing.assert_allclose(first, start, atol=1e-12)
    step, duty = jax.jit(lambda *args: pid.step(*args)), first
    for reference, error in [(25.0, 20.0), (25.0, -20.0), (15.0, -3.0), (25.0, 0.5)]:
        for _ in range(400):
            duty, state = step(state, np.array([reference]), np.array([reference - error]))
        for _ in range(2000):
            duty, state = step(state, np.array([reference]), np.array([reference]))
        assert np.min(duty) >= -1e-6 or np.max(duty) <= 1e-6, (reference, duty)


def test_a_loop_cools_with_its_cell(twin: Twin):
    """Also below the room, which heaters alone cannot hold; each is at a limit of its own."""
    run = simulate_closed_loop(twin, PID(0.2, 0.004), "0:25,100:17", duration=300)
    assert run.duty[:, 0].min() < -0.05
    assert run.duty[:, 1:].min() == 0
    assert run.loop.limits == EACH
    assert run.output[-1, 0] == pytest.approx(17, abs=1.0)
    table = run.to_dataframe()
    assert {"duty P1", "duty foil", "power wire"} <= set(table.columns)
    is_off, is_full = run.duty[:, 1:].min(axis=1) < 1e-3, run.duty.max(axis=1) > 0.999
    share = np.mean((is_off | is_full)[:-1])
    assert float(saturation_share(run.loop)) == pytest.approx(share, abs=0.02)
    cell_at_limit = (run.duty[:-1, 0] < -0.998) | (run.duty[:-1, 0] > 0.998)
    foil_at_limit = (run.duty[:-1, 1] < 0.002) | (run.duty[:-1, 1] > 0.998)
    assert run.saturation_shares == pytest.approx(
        {
            "P1": np.mean(cell_at_limit),
            "foil": np.mean(foil_at_limit),
            "wire": np.mean(foil_at_limit),
        },
        abs=0.01,
    )
    values = dict(run.measures()["value"].items())
    assert values["saturation_share foil"] == run.saturation_shares["foil"]
    assert run.saturation_shares["P1"] < run.saturation_shares["foil"]
    with pytest.raises(ControlError, match=r"a duty of -1 to 1 can hold, got -80"):
        simulate_closed_loop(twin, PID(0.2, 0.004), "0:-80", duration=30)


def test_a_loop_on_a_rig_has_the_limits_of_each(twin: Twin):
    loop = LiveLoop(twin, PID(0.2, 0.004), "0:22", duration=30)
    assert loop._controller.limits == EACH


@pytest.mark.slow
def test_every_kind_cools_with_its_cell(twin: Twin):
    model = linearize(twin, duty=[0.2, 0.2, 0.2])
    kinds = [
        *controllers(twin),
        Relay(0.3, 0.0, 0.1),
        design_uniformity_mpc(model, sample_time_s=2.0, horizon=10),
    ]
    for controller in kinds:
        run = simulate_closed_loop(twin, controller, "0:25,100:17", duration=300)
        assert run.duty[:, 0].min() < -0.02, controller
        assert run.duty[:, 1:].min() >= 0, controller


def test_a_decoupled_controller_has_limits_of_each(rig: Rig):
    pi = DecoupledPI(
        0.1, 0.001, 0.2, 0.002, measured=[["T"]] * 3, decoupling=np.eye(3), sample_time_s=1.0
    ).for_rig(rig)
    state = pi.init(np.zeros(3), np.full(3, 20.0))
    duty, _ = pi.step(state, np.full(3, -20.0), np.full(3, 20.0))
    assert np.asarray(duty).tolist() == [-1, 0, 0]


def test_points_below_the_room_are_reached_by_cooling(twin: Twin):
    """Equal duty of all: the heaters are off where the cell cools."""
    point = linearize(twin, temperatures=16.0).operating_point
    assert point.duty[0] < 0
    assert np.asarray(point.duty)[1:].tolist() == [0, 0]
    rest = twin.simulate(schedule_of(point.duty), duration=4000.0).temperatures[-1]
    assert rest == pytest.approx(16.0, abs=0.01)
    even = most_even_point(twin, 16.0)
    assert even.duty[0] < 0
    assert np.all(np.asarray(even.duty)[1:] > -1e-9)


def schedule_of(duty: Any) -> str:
    return "0:" + "/".join(f"{float(one):.12f}" for one in duty)
