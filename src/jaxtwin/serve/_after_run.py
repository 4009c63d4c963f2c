"""What the readings show after a run of the page: whether the rig that reports off is off."""

from typing import final

from ..live import Finding, Guard, Record, Replay, RigConnection, RigState
from ..live._switch_off import STILL_HEATS
from ..live.safety._off_watch import OffWatch, heat_sentence
from ._page import Page


@final
class AfterRun:
    """Watches the readings after a run, while the page goes on. It consumes the records of a
    source. If the rig heats, it is an alarm, and `stop` and the command that opens the relay are
    sent until the readings show that it cools, for a minute at most.

    **Arguments:**

    - `source`: the connection, or a replay, on which there are no runs.
    - `page`: the page, which tells what is seen.
    """

    def __init__(self, source: RigConnection | Replay, page: Page):
        self._source, self._page = source, page
        self._watch: OffWatch | None = None
        self._stops = False

    @property
    def is_watching(self) -> bool:
        """Whether it is not known yet."""
        return self._watch is not None

    def begin(self, guard: Guard, state: RigState) -> None:
        """Begins to watch at the end of a run.

        **Arguments:**

        - `guard`: the guard of the run, whose twins know how the rig would cool.
        - `state`: what is known of the rig.
        """
        self._watch, self._stops = guard.off_watch(state, self._source.clock.now()), False

    def end(self) -> None:
        """Ends the watch: another run begins."""
        self._watch, self._page.heats = None, ""

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes a record."""
        if self._watch is not None:
            self._watch.on_record(record, state)

    def on_time(self, state: RigState, now: int) -> None:
        """Tells what the readings show, once they do."""
        watch = self._watch
        if watch is None:
            return
        watch.on_time(state, now)
        if self._stops and isinstance(self._source, RigConnection):
            self._source.send_order("stop")
        if not watch.verdict:
            return
        self._watch = None
        if watch.verdict == "off":
            self._page.heats = ""
            cools = "it cools now" if self._stops else "the cells are off"
            self._page.say("notice", f"{cools}, {watch.detail}")
        elif watch.verdict == "unknown":
            self._page.say("notice", f"the device reports off; {watch.detail}")
        else:
            self._page.say("critical", f"the rig heats after a stop: {watch.detail}")
        if watch.verdict == "heats" and not self._stops:
            text = heat_sentence(watch.detail)
            self._page.heats = text
            self._page.on_finding(Finding(STILL_HEATS, text, severity="critical"))
            watch.again(state, now)
            self._watch, self._stops = watch, True
