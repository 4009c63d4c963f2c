"""The story of the demo: what its script asks for, and when."""

from collections.abc import Callable

import numpy as np
import pytest
from hand_clock import START
from small_page import SECOND, page

import jaxtwin as jt
from jaxtwin.live import Reading, RigState, Sample, StopRequest
from jaxtwin.serve import Desk
from jaxtwin.serve._desk import HoldOrder, RefitOrder
from jaxtwin.serve._live_demo import (
    HELD_SECONDS,
    LOOSE_AT,
    REFERENCES,
    REFIT_AT,
    REFIT_SECONDS,
    REST_SECONDS,
    ROOM,
    ROOM_AT,
    ROOM_SECONDS,
    DemoScript,
    demo_controller,
    demo_faults,
    demo_rig,
    reference_at,
)

Orders = list[tuple[int, object]]


def told(
    until: int,
    stopped_at: float = float("inf"),
    tripped_at: int = -1,
    silent_at: int = -1,
    uneven: Callable[[int], float] = lambda second: 0.0,
) -> tuple[Orders, list[str]]:
    """The orders of the script with their times, and the lines of its story. `uneven` is the
    difference between the halves of the plate at a second, K."""
    shown, desk = page(), Desk(StopRequest())
    shown.ring.append("run", {"state": "idle", "duty": [], "text": ""})
    script, state = DemoScript(desk, shown), RigState()
    orders: Orders = []
    for second in range(0, until, 5):
        at = START + second * SECOND
        values = np.array([45.0, 45.0 + uneven(second)])
        script.on_record(
            Reading("rig", "b", at, second * 10**6, second, values, False, None), state
        )
        # The duty changes between two samples, the first of which may be lost.
        for number in (1, 2) if second != silent_at else (2,):
            counts = ((second + number - 2) // 60, 0)
            script.on_record(
                Sample("rig", "b", at + number * SECOND // 10, 0, number, counts, None), state
            )
        if second >= stopped_at:
            text = "stopped by hand; the device reports off"
            shown.ring.append("run", {"state": "idle", "duty": [], "text": text})
        if second == tripped_at:
            text = "stopped: no controller sample for 3.1 s"
            shown.ring.append("run", {"state": "idle", "duty": [], "text": text})
        script.on_time(state, at)
        while (taken := desk.next()) is not None:
            orders.append((second, taken.order))
            if isinstance(taken.order, HoldOrder):
                shown.ring.append("run", {"state": "driving", "duty": [], "text": ""})
    lines = shown.ring.newest_of("log") or []
    return orders, [line["text"] for line in lines]


def test_the_references_step_and_one_refit_follows_the_fault() -> None:
    orders, lines = told(int(REFIT_AT) + 240)
    holds = [(at, one.references[0]) for at, one in orders if isinstance(one, HoldOrder)]
    high, low = REFERENCES
    assert [reference for _, reference in holds[:4]] == [high, low, high, ROOM]
    assert [at for at, _ in holds[:3]] == [int(HELD_SECONDS) * step for step in range(3)]
    assert all(reference == reference_at(at) for at, reference in holds)
    refits = [(at, one) for at, one in orders if isinstance(one, RefitOrder)]
    assert refits == [(int(REFIT_AT), RefitOrder(REFIT_SECONDS + REST_SECONDS))]
    begin = REFIT_AT - REFIT_SECONDS - REST_SECONDS
    # A contact that comes loose meanwhile looks like another rig.
    assert begin > LOOSE_AT
    # It begins at the temperature of the room, after minutes there.
    assert reference_at(begin) == ROOM
    assert begin - ROOM_AT > ROOM_SECONDS - 10
    assert sum("comes loose" in line for line in lines) == 1


def test_the_readings_say_whether_the_plate_is_even() -> None:
    def uneven(second: int) -> float:
        if reference_at(second) != reference_at(second - 60):
            return 0.0  # a step, in which it proves nothing
        return 2.0 * (LOOSE_AT <= second < REFIT_AT + 240)

    _, before = told(int(REFIT_AT) + 235, uneven=uneven)
    _, after = told(int(REFIT_AT) + 480, uneven=uneven)
    assert [sum("is worse" in line for line in lines) for lines in (before, after)] == [1, 1]
    assert [sum("even again" in line for line in lines) for lines in (before, after)] == [0, 1]
    _, healthy = told(int(REFIT_AT), uneven=lambda second: 0.0)
    assert not any("is worse" in line or "even again" in line for line in healthy)


@pytest.mark.parametrize("event", ["trip", "silence"])
def test_a_session_in_which_the_duty_is_not_known_begins_anew(event: str) -> None:
    at = 60 * (int(REFIT_AT) // 60 - 2)  # where the counts of the device change too
    until = int(REFIT_AT) + 600
    orders, _ = told(until, tripped_at=at) if event == "trip" else told(until, silent_at=at)
    (refit_at,) = (at for at, one in orders if isinstance(one, RefitOrder))
    assert refit_at == at + REFIT_AT - ROOM_AT
    rooms = [at for at, one in orders if isinstance(one, HoldOrder) and one.references == (ROOM,)]
    assert rooms == [int(ROOM_AT), at]


def test_who_stops_the_rig_stops_the_story() -> None:
    orders, _ = told(600, stopped_at=100.0)
    assert max(at for at, _ in orders) < 100.0


def test_the_fault_and_the_room_are_those_of_the_rig() -> None:
    (fault,) = demo_faults().rig
    assert (fault.model, fault.time, fault.size) == ("loosen", LOOSE_AT, 3.5)
    assert fault.part in demo_rig().driven
    values = jt.Twin(demo_rig()).values
    assert float(values["T_amb"]) == ROOM
    # What the story changes in the file of `new-rig`: the draught and the pads.
    assert [float(values[name]) for name in ("h", "R_pc_1", "R_pc_2")] == [60.0, 5.0, 5.0]


@pytest.mark.slow
def test_the_controller_is_about_the_one_that_is_tuned_on_the_rig() -> None:
    controller, design = demo_controller()
    tuning = jt.tune(
        jt.Twin(demo_rig()),
        controller,
        design.references,
        duration=design.duration,
        objective=design.objective,
    )
    assert tuning.after.objective > 0.9 * tuning.before.objective
