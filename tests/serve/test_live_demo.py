"""The story of the demo: what its script asks for, and when."""

import numpy as np
import pytest
from hand_clock import START
from small_page import SECOND, page, twin

from jaxtwin.live import Reading, RigState, Sample, StopRequest
from jaxtwin.serve import Desk, TwinBeside
from jaxtwin.serve._desk import DriveOrder, RefitOrder
from jaxtwin.serve._live_demo import (
    LOOSE_AT,
    REFIT_SECONDS,
    REST_SECONDS,
    REST_STEP,
    STEP_SECONDS,
    DemoScript,
    demo_faults,
    demo_rig,
)

Orders = list[tuple[int, object]]


REFIT_AT = int(REST_STEP * STEP_SECONDS + REFIT_SECONDS)


def told(
    until: int, stopped_at: float = float("inf"), tripped_at: int = -1, silent_at: int = -1
) -> tuple[Orders, list[str]]:
    """The orders of the script with their times, and the lines of its story."""
    shown, desk = page(), Desk(StopRequest())
    shown.ring.append("run", {"state": "idle", "duty": [], "text": ""})
    script, state = DemoScript(desk, shown), RigState()
    orders: Orders = []
    for second in range(0, until, 5):
        at = START + second * SECOND
        values = np.full(len(twin().channels), 23.0)
        script.on_record(
            Reading("rig", "b", at, second * 10**6, second, values, False, None), state
        )
        # The duty changes between two samples, the first of which may be lost.
        for number in (1, 2) if second != silent_at else (2,):
            counts = ((second + number - 2) // int(STEP_SECONDS), 0)
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
            if isinstance(taken.order, DriveOrder):
                shown.ring.append("run", {"state": "driving", "duty": [], "text": ""})
    lines = shown.ring.newest_of("log") or []
    return orders, [line["text"] for line in lines]


def test_the_duty_steps_and_one_refit_follows_the_fault() -> None:
    orders, lines = told(REFIT_AT + 120)
    drives = [(at, one) for at, one in orders if isinstance(one, DriveOrder)]
    assert [at for at, _ in drives] == [int(STEP_SECONDS) * k for k in range(len(drives))]
    assert len({one.duty for _, one in drives}) > len(drives) / 2
    assert [one.reset for _, one in drives[:3]] == [False, True, True]
    refits = [(at, one) for at, one in orders if isinstance(one, RefitOrder)]
    assert refits == [(REFIT_AT, RefitOrder(REFIT_SECONDS + REST_SECONDS))]
    begin = REFIT_AT - REFIT_SECONDS - REST_SECONDS
    # A contact that comes loose meanwhile looks like another rig.
    assert begin > LOOSE_AT + STEP_SECONDS
    assert next(one.duty for at, one in reversed(drives) if at <= begin) == (0.0, 0.0)
    assert ["comes loose" in line for line in lines] == [True, False]


@pytest.mark.parametrize("event", ["tripped_at", "silent_at"])
def test_a_session_in_which_the_duty_is_not_known_begins_anew(event: str) -> None:
    orders, _ = told(REFIT_AT + 600, **{event: REFIT_AT - 180})
    drives = [(at, one.duty) for at, one in orders if isinstance(one, DriveOrder)]
    (refit_at,) = (at for at, one in orders if isinstance(one, RefitOrder))
    assert refit_at == REFIT_AT + 420
    rests = [at for at, duty in drives if duty == (0.0, 0.0)]
    assert rests == [STEP_SECONDS * (REST_STEP - 1), refit_at - REFIT_SECONDS - STEP_SECONDS]


def test_the_story_ends_when_another_twin_is_right() -> None:
    shown = page()
    shown.ring.append("run", {"state": "idle", "duty": [], "text": ""})
    script, state = DemoScript(Desk(StopRequest()), shown), RigState()

    def lines(level: str) -> str:
        shown.ring.append("story", {"twin": {"level": level}})
        reading = Reading("rig", "b", START, 10**6, 1, np.full(2, 23.0), False, None)
        script.on_record(reading, state)
        script.on_time(state, START)
        return " ".join(line["text"] for line in shown.ring.newest_of("log") or [])

    assert "closed" not in lines("good")  # it is the first twin
    shown.follow(TwinBeside(twin(), "another"))
    assert "closed" not in lines("unknown")
    assert "closed" in lines("good")


def test_who_stops_the_rig_stops_the_story() -> None:
    orders, _ = told(600, stopped_at=100.0)
    assert max(at for at, _ in orders) < 100.0


def test_the_fault_is_one_of_the_rig() -> None:
    (fault,) = demo_faults().rig
    assert (fault.model, fault.time, fault.size) == ("loosen", LOOSE_AT, 3.0)
    assert fault.part in demo_rig().driven
