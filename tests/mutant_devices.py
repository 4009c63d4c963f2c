"""Firmware with a defect each, for the conformance test to find: virtual rigs that differ from the
honest one in a single act."""

import re
from dataclasses import replace

from jaxtwin.live import Duty, Order, OutputStage, VirtualRig, deframe, encode_line

Answer = tuple[str, str]
"""The event with which a device answers a command: its kind and reason."""


class Stage(OutputStage):  # pyright: ignore[reportGeneralTypeIssues]
    """An honest output stage, whose parts a mutant replaces."""

    def feed(self, now: float) -> None:
        """Resets the watchdog."""
        self._commanded = now


class FedByRefusedDuties(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        self._commanded = now
        return super()._drive(duty, now)


class FedByItsOwnerOnly(Stage):
    """Also by what it refuses, but not by another host."""

    def _drive(self, duty: Duty, now: float) -> Answer | None:
        if duty.owner == self.owner:
            self._commanded = now
        return super()._drive(duty, now)


class FedByOrders(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order):
            self._commanded = now
        return super().obey(command, now)


class KeepsAnOwnerAtRest(Stage):
    def on_time(self, now: float) -> Answer | None:
        return super().on_time(now) if any(self.pwm) else None


class TripsAtRest(Stage):
    def on_time(self, now: float) -> Answer | None:
        silent = self.owner and now - self._commanded > self._watchdog
        return self.trip("watchdog") if silent else None


class ReleasedByAnyone(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order) and command.kind == "release":
            command = replace(command, owner=self.owner or command.owner)
        return super().obey(command, now)


class KeepsTheLastReason(Stage):
    def trip(self, reason: str) -> Answer | None:
        answer = super().trip(reason)
        self.trip_reason = reason
        return answer


class TellsEachStop(Stage):
    def trip(self, reason: str) -> Answer | None:
        return super().trip(reason) or ("trip", reason)


class TripsInSilence(Stage):
    def trip(self, reason: str) -> Answer | None:
        super().trip(reason)
        return None


class ClipsNegativeCounts(Stage):
    """What is below the lowest counts is cut to them, and not refused."""

    def _drive(self, duty: Duty, now: float) -> Answer | None:
        pwm = tuple(max(counts, -self._counts) for counts in duty.pwm)
        return super()._drive(replace(duty, pwm=pwm), now)


class CoolsNever(Stage):
    """Negative counts are taken for none."""

    def _drive(self, duty: Duty, now: float) -> Answer | None:
        answer = super()._drive(duty, now)
        self.pwm = tuple(max(counts, 0) for counts in self.pwm)
        return answer


class LosesTheSign(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        answer = super()._drive(duty, now)
        self.pwm = tuple(map(abs, self.pwm))
        return answer


class SwapsCells(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        return super()._drive(replace(duty, pwm=duty.pwm[::-1]), now)


class ClipsPositiveCounts(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        pwm = tuple(min(counts, self._counts) for counts in duty.pwm)
        return super()._drive(replace(duty, pwm=pwm), now)


class WrapsCounts(Stage):
    """As a byte does."""

    def _drive(self, duty: Duty, now: float) -> Answer | None:
        pwm = tuple(counts % (self._counts + 1) if counts > 0 else counts for counts in duty.pwm)
        return super()._drive(replace(duty, pwm=pwm), now)


class LooksAtTheFirstCell(Stage):
    """The range of the others is not checked."""

    def _refusal(self, duty: Duty) -> str:
        if len(duty.pwm) != len(self.pwm):
            return super()._refusal(duty)
        return super()._refusal(replace(duty, pwm=duty.pwm[:1] * len(self.pwm)))


class FillsUpCells(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        pwm = (*duty.pwm, *self._off[len(duty.pwm) :])
        return super()._drive(replace(duty, pwm=pwm), now)


class CutsOffCells(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        return super()._drive(replace(duty, pwm=duty.pwm[: len(self.pwm)]), now)


class ObeysAnyone(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        return super()._drive(replace(duty, owner=self.owner or duty.owner), now)


class SwitchedOffByAnyone(Stage):
    """It takes a duty of zeros from a host that does not command."""

    def _refusal(self, duty: Duty) -> str:
        return "" if not any(duty.pwm) else super()._refusal(duty)


class RefusesInSilence(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        super()._drive(duty, now)
        return None


class AppliesRepeats(Stage):
    def _refusal(self, duty: Duty) -> str:
        why = super()._refusal(duty)
        return "" if why == "old" and duty.number == self.number else why


class AppliesTheOld(Stage):
    def _refusal(self, duty: Duty) -> str:
        why = super()._refusal(duty)
        return "" if why == "old" and duty.number != self.number else why


class ForgetsWhoCommanded(Stage):
    def _switch_off(self) -> None:
        super()._switch_off()
        self._newest = "", 0


class NeverTrips(Stage):
    def on_time(self, now: float) -> Answer | None:
        return None


class TripsEarly(Stage):
    def on_time(self, now: float) -> Answer | None:
        return super().on_time(now + 0.7 * self._watchdog)


class TripsLate(Stage):
    def on_time(self, now: float) -> Answer | None:
        return super().on_time(now - self._watchdog)


class ForgetsItsTrip(Stage):
    """After half a second."""

    tripped = 0.0

    def on_time(self, now: float) -> Answer | None:
        if not self.trip_reason:
            self.tripped = now
        elif now - self.tripped > 0.5:
            self.trip_reason = ""
        return super().on_time(now)


class RevivedByADuty(Stage):
    def _drive(self, duty: Duty, now: float) -> Answer | None:
        self.trip_reason = ""
        return super()._drive(duty, now)


class ResetByItsOwnerOnly(Stage):
    last = ""

    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order) and command.kind == "reset" and command.owner != self.last:
            return "refused", "owner"
        self.last = self.owner or self.last
        return super().obey(command, now)


class HeatsAfterAReset(Stage):
    before: tuple[int, ...] = ()

    def trip(self, reason: str) -> Answer | None:
        self.before = self.pwm if any(self.pwm) else self.before
        return super().trip(reason)

    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        answer = super().obey(command, now)
        if answer == ("reset", ""):
            self.pwm = self.before or self.pwm
        return answer


class ResetTakesTheCells(Stage):
    """A reset without a trip switches off, whoever sends it."""

    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order) and command.kind == "reset":
            self._switch_off()
        return super().obey(command, now)


class StoppedByItsOwnerOnly(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order) and command.kind == "stop" and command.owner != self.owner:
            return "refused", "owner"
        return super().obey(command, now)


class StopsWithoutATrip(Stage):
    def trip(self, reason: str) -> Answer | None:
        if reason != "stop":
            return super().trip(reason)
        self._switch_off()
        return "trip", reason


class ReleaseTrips(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        released = isinstance(command, Order) and command.kind == "release"
        owned = self.owner
        answer = super().obey(command, now)
        return self.trip("release") if released and owned and not self.owner else answer


class ReleaseKeepsHeat(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        before = self.pwm
        answer = super().obey(command, now)
        if isinstance(command, Order) and command.kind == "release" and not self.owner:
            self.pwm = before
        return answer


class ReleaseKeepsTheOwner(Stage):
    def obey(self, command: Duty | Order, now: float) -> Answer | None:
        owner, number = self.owner, self.number
        answer = super().obey(command, now)
        if isinstance(command, Order) and command.kind == "release":
            self.owner, self.number = owner, number
        return answer


class KeepsItsOwnerInATrip(Stage):
    def trip(self, reason: str) -> Answer | None:
        owner, number = self.owner, self.number
        answer = super().trip(reason)
        self.owner, self.number = owner or self.owner, number
        return answer


# Mutants of the output stage, and the step of the conformance test that finds each.
STAGES: tuple[tuple[type[Stage], str], ...] = (
    (FedByRefusedDuties, "a refused duty does not feed the watchdog"),
    (FedByItsOwnerOnly, "a refused duty does not feed the watchdog"),
    (FedByOrders, "no other line feeds the watchdog"),
    (KeepsAnOwnerAtRest, "silence with the cells off releases them, and is no trip"),
    (TripsAtRest, "silence with the cells off releases them, and is no trip"),
    (ReleasedByAnyone, "refuses the release of another"),
    (KeepsTheLastReason, "keeps the first reason of a trip"),
    (TellsEachStop, "a stop after a trip is no second trip"),
    (TripsInSilence, "a trip is an event"),
    (ClipsNegativeCounts, "refuses what it cannot apply"),
    (ClipsPositiveCounts, "refuses what it cannot apply"),
    (WrapsCounts, "refuses what it cannot apply"),
    (LooksAtTheFirstCell, "refuses what it cannot apply"),
    (FillsUpCells, "refuses what it cannot apply"),
    (CutsOffCells, "refuses what it cannot apply"),
    (RefusesInSilence, "refuses what it cannot apply"),
    (CoolsNever, "gives each cell its own counts, of either sign"),
    (LosesTheSign, "gives each cell its own counts, of either sign"),
    (SwapsCells, "gives each cell its own counts, of either sign"),
    (ObeysAnyone, "refuses another commander"),
    (SwitchedOffByAnyone, "refuses another commander"),
    (AppliesRepeats, "refuses a repeated number"),
    (AppliesTheOld, "refuses an older number"),
    (ForgetsWhoCommanded, "after a release an old duty is refused"),
    (NeverTrips, "its watchdog trips"),
    (TripsLate, "its watchdog trips"),
    (TripsEarly, "its watchdog trips no earlier than it says"),
    (ForgetsItsTrip, "keeps the first reason of a trip"),
    (RevivedByADuty, "refuses every duty after a trip"),
    (ResetByItsOwnerOnly, "a reset ends the trip, and is an event"),
    (HeatsAfterAReset, "the cells stay off after a reset"),
    (ResetTakesTheCells, "a reset without a trip changes nothing"),
    (StoppedByItsOwnerOnly, "anyone may stop"),
    (StopsWithoutATrip, "anyone may stop"),
    (ReleaseTrips, "a release switches off and is no trip"),
    (ReleaseKeepsHeat, "a release switches off and is no trip"),
    (ReleaseKeepsTheOwner, "after a release another may command"),
    (KeepsItsOwnerInATrip, "nobody commands while it has tripped"),
)


class Rig(VirtualRig):  # pyright: ignore[reportGeneralTypeIssues]
    """An honest virtual rig, whose ears a mutant replaces."""

    def receive(self, data: bytes, client: object = None) -> bool:
        """Hears each line by itself; a script sends whole lines."""
        lines = data.splitlines(keepends=True)
        return sum(self.hear(line, client) for line in lines) > 0

    def hear(self, line: bytes, client: object) -> bool:
        return super().receive(line, client)

    @property
    def now(self) -> float:
        return self.twin.time / self.hello.rate


class FedByLines(Rig):
    """By every line with a right checksum."""

    def hear(self, line: bytes, client: object) -> bool:
        if deframe(b"", line).frames and isinstance(self.stage, Stage):
            self.stage.feed(self.now)
        return super().hear(line, client)


class FedByBytes(Rig):
    def hear(self, line: bytes, client: object) -> bool:
        if isinstance(self.stage, Stage):
            self.stage.feed(self.now)
        return super().hear(line, client)


class Lenient(Rig):
    """It hears another text than was sent."""

    pattern, by = "", ""

    def hear(self, line: bytes, client: object) -> bool:
        frames = deframe(b"", line).frames
        if len(frames) == 1 and isinstance(frames[0], str):
            line = encode_line(re.sub(self.pattern, self.by, frames[0]))
        return super().hear(line, client)


class ReadsLeadingZeros(Lenient):
    pattern, by = r"(pwm=|,)0+(?=\d)", r"\1"


class ReadsNumbersWithZeros(Lenient):
    pattern, by = r" n=0+(?=\d)", " n="


class ReadsMinusZero(Lenient):
    pattern, by = r"-0\b", "0"


class ReadsPlus(Lenient):
    pattern, by = r"=\+", "="


class CutsFractions(Lenient):
    pattern, by = r"(=\d+)\.\d+", r"\1"


class PassesOverUnknownKeys(Lenient):
    pattern, by = r" more=1", ""


class TakesAKeyTwice(Lenient):
    pattern, by = r"( n=\d+)(.*)\1", r"\1\2"


class PassesOverBlanks(Lenient):
    pattern, by = r" +", " "


class PassesOverEmptyEntries(Lenient):
    pattern, by = r",$", ""


class ReadsAnyCase(Lenient):
    pattern, by = r"^Duty", "duty"


class NeedsNoOwner(Lenient):
    pattern, by = r"^(duty n=\d+)(?! owner| pwm=.* owner)", r"\1 owner=me"

    def hear(self, line: bytes, client: object) -> bool:
        self.by = rf"\1 owner={self.stage.owner or 'me'}"
        return super().hear(line, client)


class IgnoresLaterVersions(Lenient):
    pattern, by = r"^hello version=3.*", "silence"


class ChecksNoSum(Rig):
    def hear(self, line: bytes, client: object) -> bool:
        text = line.rstrip(b"\r\n").rpartition(b"*")[0]
        if text.isascii() and text.decode().isprintable() and text:
            line = encode_line(text.decode())
        return super().hear(line, client)


class GreetsInAnotherWay(Rig):
    def hear(self, line: bytes, client: object) -> bool:
        heard = super().hear(line, client)
        self.hello = replace(self.hello, boot=f"{self.hello.boot[:8]}x")
        return heard


class CountsNothing(Rig):
    def _count(self, stream: str) -> int:
        return 0


# Mutants of the reading of lines, and the step of the conformance test that finds each.
RIGS: tuple[tuple[type[Rig], str], ...] = (
    (FedByLines, "no other line feeds the watchdog"),
    (FedByBytes, "no other line feeds the watchdog"),
    (ReadsLeadingZeros, "a line with a leading zero changes nothing"),
    (ReadsNumbersWithZeros, "a line with a zero before its number changes nothing"),
    (ReadsMinusZero, "a line with a minus zero changes nothing"),
    (ReadsPlus, "a line with numbers that are none changes nothing"),
    (CutsFractions, "a line with a fraction of a count changes nothing"),
    (PassesOverUnknownKeys, "a line with an unknown key changes nothing"),
    (TakesAKeyTwice, "a line with a key twice changes nothing"),
    (PassesOverBlanks, "a line with two spaces changes nothing"),
    (PassesOverEmptyEntries, "a line with an empty entry changes nothing"),
    (ReadsAnyCase, "a line with an unknown word changes nothing"),
    (NeedsNoOwner, "a line without an owner changes nothing"),
    (ChecksNoSum, "a line that is damaged changes nothing"),
    (IgnoresLaterVersions, "answers the hello of another version"),
    (GreetsInAnotherWay, "greets in the same way each time"),
    (CountsNothing, "counts up its messages and its time, and speaks once a second"),
)
