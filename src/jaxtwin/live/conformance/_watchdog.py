"""Conformance: the watchdog, which only a duty that is applied may feed."""

from collections.abc import Callable, Iterator

from ..protocol._codec import encode
from ..protocol._messages import VERSION, Ask, Hello
from ._commands import OTHER_HOST, few, wrong_lines
from ._dialogue import Dialogue
from ._step_result import StepResult, found

# The time by which a watchdog may be late, s; it includes the device's next sample.
MARGIN_SECONDS = 1.5


def watchdog_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests when the watchdog switches off. The device has tripped afterwards."""
    watchdog, low = hello.watchdog or 0.0, few(hello)
    off = (0,) * len(low)
    talk.command(*off)
    talk.reports(pwm=off, owner=talk.owner)
    ok = talk.reports(watchdog + MARGIN_SECONDS, owner="", trip="")
    yield found(
        "silence with the cells off releases them, and is no trip", ok, "it does not, or is"
    )
    talk.order("reset")  # where it was one
    talk.reports(trip="")
    for what, lines in (
        ("a refused duty does not feed", _refused),
        ("no other line feeds", _others),
    ):
        fed = _trips(talk, hello, lambda lines=lines: lines(talk, low, hello))
        yield found(f"{what} the watchdog", fed is not None, "it has not tripped")
        talk.order("reset")
        talk.reports(trip="")
    took = _trips(talk, hello, lambda: None)
    late = f"no trip=watchdog within {watchdog + MARGIN_SECONDS:g} s"
    yield found("its watchdog trips", took is not None, late)
    ok = took is None or took >= 0.5 * watchdog
    yield found(
        "its watchdog trips no earlier than it says", ok, f"after {took or 0:.2f} s already"
    )


def _trips(talk: Dialogue, hello: Hello, feed: Callable[[], None]) -> float | None:
    """The time from the last duty to the trip, s, while `feed` sends other lines; `None` without
    a trip."""
    low, watchdog = few(hello), hello.watchdog or 0.0
    talk.command(*low)
    begin = talk.clock.now()
    talk.reports(pwm=low)
    while (took := (talk.clock.now() - begin) * 1e-9) < watchdog + MARGIN_SECONDS:
        feed()
        if talk.reports(min(0.2, watchdog / 4), pwm=(0,) * len(low), trip="watchdog"):
            return took
    return None


def _refused(talk: Dialogue, low: tuple[int, ...], hello: Hello) -> None:
    last = talk.command(*(hello.counts + 1,) * len(low))
    talk.command(*low, 1)
    talk.command(*low, owner=OTHER_HOST)
    talk.command(*low, number=last - 50)


def _others(talk: Dialogue, low: tuple[int, ...], hello: Hello) -> None:
    talk.say(encode(Ask(VERSION)))
    talk.order("reset")
    talk.order("reset", OTHER_HOST)
    talk.order("release", OTHER_HOST)
    for line in wrong_lines(talk, len(low)).values():
        talk.say(line)
