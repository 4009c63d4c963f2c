"""The handling of commands by a device: the host that it obeys, the commands that it refuses, and
its trips.

A single host commands, the owner. It is the first host that sends a duty while there is no owner,
and remains the owner as long as it keeps sending. A trip switches the cells off and lasts until a
host resets it on purpose.
"""

from typing import final

from ._messages import Duty, Order

Answer = tuple[str, str]
"""The event with which a device answers a command: its kind and reason."""


@final
class OutputStage:
    """The output stage of a device: it decides which counts are applied to the cells.

    **Arguments:**

    - `cells`: the number of cells.
    - `counts`: the counts of full duty.
    - `watchdog`: time without a command after which the cells are switched off, s.
    - `relay`: the name of the relay in the supply, which every trip opens; `""` without one.
    """

    def __init__(self, cells: int, counts: int, watchdog: float, relay: str = ""):
        self.pwm = (0,) * cells
        """The counts that are applied now."""
        self.owner = ""
        """The host that commands; `""` if there is none."""
        self.number: int | None = None
        """The number of the owner's last command that was applied."""
        self.trip_reason = ""
        """The reason of the trip in a single word; `""` if the device has not tripped."""
        self.supplied = True
        """Whether the relay in the supply is closed; always without one."""
        self._relay = relay
        self._off = self.pwm
        self._counts = counts
        self._watchdog = watchdog
        self._commanded = 0.0

    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        """Handles a command at time `now`, s.

        **Returns:** the event to send; `None` for an ordinary duty.
        """
        match command:
            case Order(kind="stop"):  # anyone may stop
                return self.trip("stop")
            case Order(kind="relay"):  # anyone, too
                return self.trip("relay") if command.name == self._relay else ("refused", "relay")
            case Order(kind="reset") if self.trip_reason:
                self.trip_reason, self.supplied = "", True
                return "reset", ""
        if self.owner not in ("", command.owner):
            return "refused", "owner"
        if isinstance(command, Order):
            if command.kind == "release":
                self._switch_off()
            return None
        if self.trip_reason:
            return "refused", "tripped"
        if len(command.pwm) != len(self.pwm) or max(map(abs, command.pwm)) > self._counts:
            # The command is not clipped: a host that sends such a command has a defect.
            return "refused", "range"
        self.pwm, self.owner, self.number = command.pwm, command.owner, command.number
        self._commanded = now
        return None

    def check(self, now: float) -> Answer | None:
        """Checks for silence. Returns the event to send, if there is any."""
        if not self.owner or now - self._commanded <= self._watchdog:
            return None
        if not any(self.pwm):
            self._switch_off()
            return None
        return self.trip("watchdog")

    def trip(self, reason: str) -> Answer:
        """Switches the cells off until a reset."""
        self._switch_off()
        self.supplied = not self._relay
        self.trip_reason = self.trip_reason or reason  # the first reason is kept
        return "trip", reason

    def _switch_off(self) -> None:
        self.pwm, self.owner, self.number = self._off, "", None
