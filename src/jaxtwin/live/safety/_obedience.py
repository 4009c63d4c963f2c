"""Interlock: the device applies the commanded duty, and no other host commands it."""

from collections import deque
from typing import NamedTuple, final

from ..protocol._records import Command, Document, Record, Sample
from ..protocol._rig_state import RigState
from ._interlock import AbstractInterlock, Finding

# The largest accepted difference between applied and commanded counts.
MAX_COUNT_DIFFERENCE = 1


class _Sent(NamedTuple):
    time: int
    number: int
    pwm: tuple[int, ...]


@final
class Obedience(AbstractInterlock):
    """Compares the counts that a device reports with those that were commanded.

    A driver may apply a command late and by a ramp. Its counts must therefore lie between the
    lowest and the highest of all commands that were in force within the delay before the report. A
    command that is older than the delay must have been acknowledged, and no command may be that has
    not been sent: a device that makes up numbers proves nothing by them. A report is as old as the
    device's clock says: that a busy host reads it late is no fault of the device.

    **Arguments:**

    - `cells`: the names of the cells.
    - `delay`: longest time until a driver applies a command, ramp included, s.
    """

    def __init__(self, cells: tuple[str, ...], delay: float):
        self._owner = ""
        self._cells = cells
        self._delay = round(delay * 1e9)
        self._sent: deque[_Sent] = deque()
        self._off = (0,) * len(cells)

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        match record:
            case Document(kind="start"):  # what was commanded before belongs to another run
                self._sent.clear()
            case Command(kind="duty"):
                self._owner = record.owner
                self._sent.append(_Sent(record.arrival, record.number, record.pwm))
            case Sample() if self._sent:
                return self._contradiction(record, state.time_of(record))
        return None

    def on_time(self, state: RigState, now: int) -> Finding | None:
        # The command that was in force at the beginning of the delay is still needed.
        while len(self._sent) > 1 and self._sent[1].time <= now - 2 * self._delay:
            self._sent.popleft()
        return None

    def _contradiction(self, record: Sample, made_at: int) -> Finding | None:
        if record.relay == "off":
            return Finding("device-trip", "the relay in the supply has been opened")
        if not record.pwm:
            return None
        if record.trip:
            return Finding("device-trip", f"the device has switched off by itself: {record.trip}")
        if record.owner not in ("", self._owner):
            return Finding("commander", f"another host, {record.owner}, commands the cells")
        return (
            self._disobedience(record, made_at)
            or self._unsent(record)
            or self._unacknowledged(record, made_at)
        )

    def _disobedience(self, sample: Sample, made_at: int) -> Finding | None:
        earlier, within = self._off, []
        for sent in self._sent:
            if sent.time <= made_at - self._delay:
                earlier = sent.pwm
            elif sent.time <= sample.arrival:
                within.append(sent.pwm)
        for cell, applied, *commanded in zip(
            self._cells, sample.pwm, earlier, *within, strict=True
        ):
            if (
                not min(commanded) - MAX_COUNT_DIFFERENCE
                <= applied
                <= max(commanded) + MAX_COUNT_DIFFERENCE
            ):
                return Finding(
                    "disobedience",
                    f"{cell} gets {applied} counts; {commanded[-1]} were commanded",
                    cell,
                )
        return None

    def _unsent(self, sample: Sample) -> Finding | None:
        last = self._sent[-1].number
        if sample.number is None or (last - sample.number) % 2**32 < 2**31:
            return None
        return Finding(
            "disobedience",
            f"the device acknowledges command {sample.number}; the last one sent was {last}",
        )

    def _unacknowledged(self, sample: Sample, made_at: int) -> Finding | None:
        old = [sent for sent in self._sent if sent.time <= made_at - self._delay]
        if not old:
            return None
        if sample.number is None or (sample.number - old[-1].number) % 2**32 >= 2**31:
            waited = (made_at - old[-1].time) * 1e-9
            return Finding("unacknowledged", f"no command was acknowledged for {waited:.1f} s")
        return None
