"""Conformance: trips, their end by a reset, and the release."""

from collections.abc import Iterator

from ..protocol._messages import Data, Hello, Notice
from ._commands import OTHER_HOST, few
from ._dialogue import Dialogue
from ._step_result import StepResult, found


def trip_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests trips, beginning with a device that its watchdog has tripped."""
    low = few(hello)
    off = (0,) * len(low)
    number = talk.command(*low)
    yield found("refuses every duty after a trip", talk.refuses(number, "tripped"), "does not")
    yield from _second_stop(talk)
    number = talk.order("reset", OTHER_HOST)
    ok = talk.tells("reset", "", number) and talk.reports(pwm=off, owner="", trip="")
    yield found("a reset ends the trip, and is an event", ok, "it does not, or is none")
    ok = talk.keeps(0.5, pwm=off, owner="", trip="")
    yield found("the cells stay off after a reset", ok, "they do not")
    _heat(talk, low)
    talk.order("stop", OTHER_HOST)
    ok = talk.tells("trip", "stop")
    yield found("a trip is an event", ok, "no event with kind=trip why=stop")
    ok = talk.reports(pwm=off, trip="stop")
    yield found("anyone may stop", ok, "no data with trip=stop")
    ok = talk.keeps(0.3, pwm=off, owner="", number=None)
    yield found("nobody commands while it has tripped", ok, "data with an owner, or with heat")
    _reset(talk)
    if hello.relay:
        yield from _relay(talk, hello)
    yield from _releases(talk, low)


def _second_stop(talk: Dialogue) -> Iterator[StepResult]:
    talk.order("stop")
    talk.order("stop", OTHER_HOST)
    messages = list(talk.listen(1.0))
    samples = [message for message in messages if isinstance(message, Data)]
    ok = bool(samples) and all(sample.trip == "watchdog" for sample in samples)
    yield found("keeps the first reason of a trip", ok, "data without trip=watchdog after a stop")
    ok = not any(isinstance(message, Notice) and message.kind == "trip" for message in messages)
    yield found("a stop after a trip is no second trip", ok, "another event with kind=trip")


def _relay(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    low = few(hello)
    off = (0,) * len(low)
    ok = talk.reports(relay="on")
    yield found("a reset closes the relay", ok, "no data with relay=on")
    _heat(talk, low)
    number = talk.order("relay", OTHER_HOST, f"not {hello.relay}"[:32])
    ok = talk.refuses(number, "relay") and talk.reports(pwm=low, relay="on")
    yield found("refuses a relay of another name", ok, "no event with why=relay")
    talk.order("relay", OTHER_HOST, hello.relay)
    ok = talk.reports(pwm=off, relay="off", trip="relay")
    yield found("anyone may open the relay", ok, "no data with relay=off trip=relay")
    _reset(talk)
    _heat(talk, low)
    talk.order("stop")
    ok = talk.reports(pwm=off, relay="off", trip="stop")
    yield found("every trip opens the relay", ok, "no data with relay=off trip=stop")
    _reset(talk)


def _releases(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    _heat(talk, low)
    number = talk.order("release")
    ok = talk.reports(pwm=(0,) * len(low), owner="", trip="")
    yield found("a release switches off and is no trip", ok, "it does not")
    talk.command(*low, number=number - 1)
    ok = talk.keeps(0.3, pwm=(0,) * len(low), owner="")
    yield found("after a release an old duty is refused", ok, "it is applied")
    _heat(talk, low)
    talk.order("release")  # and at once, before the watchdog could release it
    number = talk.command(*low, owner=OTHER_HOST)
    ok = talk.reports(pwm=low, owner=OTHER_HOST, number=number)
    yield found("after a release another may command", ok, "he is refused")
    talk.order("release", OTHER_HOST)


def _heat(talk: Dialogue, low: tuple[int, ...]) -> None:
    talk.command(*low)
    talk.reports(pwm=low)


def _reset(talk: Dialogue) -> None:
    talk.order("reset")
    talk.reports(trip="")
