"""A page of the small rig `tclab` at rest, without a link, for tests of the web application."""

from functools import cache

import numpy as np
from hand_clock import START

from jaxtwin import Twin
from jaxtwin.live import Reading, RigState, Sample, StopRequest
from jaxtwin.serve import Access, Desk, FrameRing, Page, TwinBeside, web_app

TOKEN = "the-token-of-a-test"
SECOND = 10**9


class NoSource:
    """A source that gives nothing."""

    ended = False

    def __init__(self) -> None:
        self.states = {"rig": "live"}


@cache
def twin() -> Twin:
    return Twin("tclab")


def page(ring: FrameRing | None = None, **about: object) -> Page:
    beside = TwinBeside(twin(), "values of the rig file")
    told = {"source": "a test", "is_live": True, "recording": "", "control": True, **about}
    return Page(FrameRing() if ring is None else ring, NoSource(), beside, told)


def read(
    page: Page,
    readings: list[float],
    second: int,
    state: RigState | None = None,
    counts: tuple[int, ...] = (0, 0),
) -> RigState:
    """Hands a sample with the counts of its outputs and a reading to a page, as a turn of the
    service does."""
    at = START + second * SECOND
    state = RigState() if state is None else state
    values = np.array(readings)
    for record in (
        Sample("rig", "b", at, second * 10**6, second, counts, 23.0),
        Reading("rig", "b", at, second * 10**6, second, values, False, None),
    ):
        state = state.after(record)
        page.on_record(record, state)
    page.on_time(state, at)
    return state


class Bench:
    """A page with its application. Nobody takes orders from its desk."""

    def __init__(self, *, allow_control: bool = True):
        self.page = page()
        self.desk = Desk(StopRequest())
        access = Access.of("127.0.0.1", 8000, allow_control=allow_control)
        self.access = Access(access.hosts, TOKEN, allow_control)
        self.app = web_app(self.page, self.desk, self.access)


@cache
def bench(*, allow_control: bool = True) -> Bench:
    return Bench(allow_control=allow_control)
