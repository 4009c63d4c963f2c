"""The handling of commands by a device: the host that it obeys, the commands that it refuses, and
its trips.

A single host commands, the owner. It is the first host that sends a duty while there is no owner,
and remains the owner as long as it keeps sending newer ones. A trip switches the cells off and
lasts until a host resets it on purpose.
"""

from typing import final

from ._messages import Duty, Order

# The event with which a device answers a command: its kind and reason.
Answer = tuple[str, str]


@final
class OutputStage:
    """The output stage of a device: it decides which counts are applied to the cells.

    **Arguments:**

    - `cells`: the number of cells.
    - `counts`: the counts of full duty.
    - `watchdog`: time without a command after which the cells are switched off, s.
    - `relay`: the name of the relay in the supply, which every trip opens; `""` without one.
    - `heaters`: how many of the cells, the last ones, only heat.
    """

    def __init__(self, cells: int, counts: int, watchdog: float, relay: str = "", heaters: int = 0):
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
        self._lowest = (-counts,) * (cells - heaters) + (0,) * heaters
        self._watchdog = watchdog
        self._commanded = 0.0
        self._newest = "", 0  # the owner and the number of the last duty that was applied

    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        """Handles a command at time `now`, s.

        **Returns:** the event to send; `None` for an ordinary duty, and where nothing changes.
        """
        if isinstance(command, Duty):
            return self._drive(command, now)
        match command.kind:
            case "stop":  # anyone may stop
                return self.trip("stop")
            case "relay":  # anyone, too
                return self.trip("relay") if command.name == self._relay else ("refused", "relay")
            case "reset" if self.trip_reason:  # anyone, because nobody commands
                self.trip_reason, self.supplied = "", True
                return "reset", ""
        if self.owner not in ("", command.owner):
            return "refused", "owner"
        if command.kind == "release":
            self._switch_off()
        return None

    def on_time(self, now: float) -> Answer | None:
        """Checks for silence. Returns the event to send, if there is any."""
        if not self.owner or now - self._commanded <= self._watchdog:
            return None
        if not any(self.pwm):
            self._switch_off()
            return None
        return self.trip("watchdog")

    def trip(self, reason: str) -> Answer | None:
        """Switches the cells off until a reset. Returns the event to send: none if the device has
        tripped already, because the first reason is kept."""
        self._switch_off()
        self.supplied = not self._relay
        if self.trip_reason:
            return None
        self.trip_reason = reason
        return "trip", reason

    def _drive(self, duty: Duty, now: float) -> Answer | None:
        """Applies a duty, or refuses it. Only a duty that is applied feeds the watchdog."""
        if why := self._refusal(duty):
            return "refused", why
        self.pwm, self.owner, self.number = duty.pwm, duty.owner, duty.number
        self._newest = duty.owner, duty.number
        self._commanded = now
        return None

    def _refusal(self, duty: Duty) -> str:
        """The reason why a duty is not applied; `""` if it is."""
        if self.owner not in ("", duty.owner):
            return "owner"
        if self.trip_reason:
            return "tripped"
        if len(duty.pwm) != len(self.pwm) or not all(
            lowest <= count <= self._counts
            for lowest, count in zip(self._lowest, duty.pwm, strict=True)
        ):
            # It is not clipped: a host that sends such a command has a defect.
            return "range"
        owner, number = self._newest
        if duty.owner == owner and not 0 < (duty.number - number) % 2**32 < 2**31:
            # A link that repeats a line for ever must not keep the cells on without a host.
            return "old"
        return ""

    def _switch_off(self) -> None:
        self.pwm, self.owner, self.number = self._off, "", None
