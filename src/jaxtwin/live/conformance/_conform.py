"""Tests whether a device follows the protocol, by a script of greetings, commands and faults.

It commands the cells for short times with a low duty. Set a low current limit on the supply, or
disconnect the cells, before running it.
"""

import secrets
from collections.abc import Callable, Iterator

from ...rig import Rig
from ..protocol._clock import Clock
from ..protocol._codec import encode
from ..protocol._framing import encode_line
from ..protocol._identity import Identity
from ..protocol._messages import VERSION, Ask, Beat, Data, Hello, Message, Notice
from ..protocol._transport import Transport
from ._dialogue import ANSWERS_WITHIN, Dialogue, StepResult, step_result

# Conformance: the duty that a device applies, and the lines that change nothing.

# The counts that the script commands.
SMALL = 10

# A second host, which the script pretends to be.
OTHER_HOST = "conform-other"


def few(hello: Hello) -> tuple[int, ...]:
    """A low duty for all cells."""
    return (SMALL,) * len(hello.cells)


def command_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests which duty a device applies, and whose."""
    cells, low = len(hello.cells), few(hello)
    talk.order("reset")
    yield step_result(
        "is off at first", talk.reports(pwm=(0,) * cells, owner="", trip=""), "is not"
    )
    number = talk.command(*low)
    yield step_result(
        "applies a duty, and says whose and which",
        talk.reports(pwm=low, owner=talk.owner, number=number),
        f"no data with pwm={SMALL},... owner={talk.owner} n={number}",
    )
    for sign in (1, -1):
        signs = [1 if hello.lowest(cell) == 0 else sign * (-1) ** cell for cell in range(cells)]
        own = tuple(sign * (SMALL + cell) for cell, sign in enumerate(signs))
        talk.command(*own)
        ok = talk.reports(pwm=own)
        yield step_result(
            "gives each cell its own counts, of either sign", ok, f"no data with pwm={own}"
        )
    for more, order in enumerate(("owner={} pwm={} n={}", "n={2} pwm={1} owner={0}"), 1):
        wanted = (SMALL + more,) * cells
        counts = ",".join(map(str, wanted))
        line = "duty " + order.format(talk.owner, counts, talk.next_number())
        talk.say(encode_line(line).replace(b"\n", b"\r\n"))
        ok = talk.reports(pwm=wanted)
        yield step_result("takes keys in any order, and CRLF", ok, f"not obeyed: {line}")
    yield from _of_another(talk, low)
    yield from _beyond(talk, hello)
    yield from _old(talk, low)


def _of_another(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    for pwm in (low, (0,) * len(low)):
        number = talk.command(*pwm, owner=OTHER_HOST)
        ok = talk.refuses(number, "owner")
        yield step_result("refuses another commander", ok, f"{pwm}: no event with why=owner")
    talk.command(*low)
    number = talk.order("release", OTHER_HOST)
    ok = talk.refuses(number, "owner") and talk.reports(pwm=low, owner=talk.owner)
    yield step_result("refuses the release of another", ok, "no event with why=owner, or it is off")
    last = talk.command(*low)
    number = talk.order("reset", OTHER_HOST)
    talk.order("reset")
    ok = talk.refuses(number, "owner")
    ok = ok and talk.keeps(0.3, pwm=low, owner=talk.owner, number=last)
    yield step_result(
        "a reset without a trip changes nothing", ok, "it did, or no event with why=owner"
    )


def _beyond(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    cells, low, full = len(hello.cells), few(hello), hello.counts
    wrong = [(full + 1,) * cells, (-full - 1,) * cells, (*low[1:], full + 1), (*low[1:], -full - 1)]
    wrong += [(99_999,) * cells, (1,) * (cells + 1)] + ([(1,) * (cells - 1)] if cells > 1 else [])
    for cell in range(cells):
        if hello.lowest(cell) == 0:  # a heater that is asked to cool
            wrong.append((*low[:cell], -SMALL, *low[cell + 1 :]))
    for counts in wrong:
        talk.command(*low)
        number = talk.command(*counts)
        ok = talk.refuses(number, "range") and talk.reports(pwm=low)
        yield step_result(
            "refuses what it cannot apply", ok, f"did not refuse {counts} by why=range"
        )


def _old(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    for what, ago in (("a repeated", 0), ("an older", 1)):
        talk.command(*low)
        last = talk.command(*low)
        number = talk.command(*(SMALL + 5,) * len(low), number=last - ago)
        ok = talk.refuses(number, "old") and talk.reports(pwm=low, number=last)
        yield step_result(f"refuses {what} number", ok, f"no event with why=old n={number}")


def line_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests that lines with an error change nothing."""
    low = few(hello)
    for name in wrong_lines(talk, len(low)):
        talk.command(*low)
        talk.reports(pwm=low)
        talk.say(wrong_lines(talk, len(low))[name])
        ok = talk.keeps(0.5, pwm=low, owner=talk.owner)
        yield step_result(f"a line {name} changes nothing", ok, "it did, or no data came")


def wrong_lines(talk: Dialogue, cells: int) -> dict[str, bytes]:
    """Lines with an error; without it, most of them would be a new duty."""
    number = talk.next_number()
    good = f"duty n={number} owner={talk.owner} pwm={','.join(['3'] * cells)}"
    wrong = {
        "with a key twice": f"{good} n={number}",
        "with an unknown key": f"{good} more=1",
        "without an owner": good.replace(f"owner={talk.owner} ", ""),
        "without a number": good.replace(f"n={number} ", ""),
        "with numbers that are none": good.replace("pwm=3", "pwm=+3"),
        "with a fraction of a count": good.replace("pwm=3", "pwm=3.0"),
        "with a leading zero": good.replace("pwm=3", "pwm=03"),
        "with a zero before its number": good.replace("n=", "n=0", 1),
        "with a minus zero": good.replace("pwm=3", "pwm=-0"),
        "with an empty entry": f"{good},",
        "with two spaces": good.replace(" ", "  ", 1),
        "with an unknown word": good.replace("duty", "Duty"),
    }
    return {
        "that is damaged": encode_line(good).replace(b"pwm=3", b"pwm=4"),
        "without a checksum": good.encode() + b"\n",
        **{name: encode_line(line) for name, line in wrong.items()},
        "that is too long": b"x" * 2000 + b"\n",
        "of noise": b"\x00\x02\xff*\n",
    }


def trip_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests trips, beginning with a device that its watchdog has tripped."""
    low = few(hello)
    off = (0,) * len(low)
    number = talk.command(*low)
    yield step_result(
        "refuses every duty after a trip", talk.refuses(number, "tripped"), "does not"
    )
    yield from _second_stop(talk)
    number = talk.order("reset", OTHER_HOST)
    ok = talk.tells("reset", "", number) and talk.reports(pwm=off, owner="", trip="")
    yield step_result("a reset ends the trip, and is an event", ok, "it does not, or is none")
    ok = talk.keeps(0.5, pwm=off, owner="", trip="")
    yield step_result("the cells stay off after a reset", ok, "they do not")
    _heat(talk, low)
    talk.order("stop", OTHER_HOST)
    ok = talk.tells("trip", "stop")
    yield step_result("a trip is an event", ok, "no event with kind=trip why=stop")
    ok = talk.reports(pwm=off, trip="stop")
    yield step_result("anyone may stop", ok, "no data with trip=stop")
    ok = talk.keeps(0.3, pwm=off, owner="", number=None)
    yield step_result(
        "nobody commands while it has tripped", ok, "data with an owner, or with heat"
    )
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
    yield step_result(
        "keeps the first reason of a trip", ok, "data without trip=watchdog after a stop"
    )
    ok = not any(isinstance(message, Notice) and message.kind == "trip" for message in messages)
    yield step_result("a stop after a trip is no second trip", ok, "another event with kind=trip")


def _relay(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    low = few(hello)
    off = (0,) * len(low)
    ok = talk.reports(relay="on")
    yield step_result("a reset closes the relay", ok, "no data with relay=on")
    _heat(talk, low)
    number = talk.order("relay", OTHER_HOST, f"not {hello.relay}"[:32])
    ok = talk.refuses(number, "relay") and talk.reports(pwm=low, relay="on")
    yield step_result("refuses a relay of another name", ok, "no event with why=relay")
    talk.order("relay", OTHER_HOST, hello.relay)
    ok = talk.reports(pwm=off, relay="off", trip="relay")
    yield step_result("anyone may open the relay", ok, "no data with relay=off trip=relay")
    _reset(talk)
    _heat(talk, low)
    talk.order("stop")
    ok = talk.reports(pwm=off, relay="off", trip="stop")
    yield step_result("every trip opens the relay", ok, "no data with relay=off trip=stop")
    _reset(talk)


def _releases(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    _heat(talk, low)
    number = talk.order("release")
    ok = talk.reports(pwm=(0,) * len(low), owner="", trip="")
    yield step_result("a release switches off and is no trip", ok, "it does not")
    talk.command(*low, number=number - 1)
    ok = talk.keeps(0.3, pwm=(0,) * len(low), owner="")
    yield step_result("after a release an old duty is refused", ok, "it is applied")
    _heat(talk, low)
    talk.order("release")  # and at once, before the watchdog could release it
    number = talk.command(*low, owner=OTHER_HOST)
    ok = talk.reports(pwm=low, owner=OTHER_HOST, number=number)
    yield step_result("after a release another may command", ok, "he is refused")
    talk.order("release", OTHER_HOST)


def _heat(talk: Dialogue, low: tuple[int, ...]) -> None:
    talk.command(*low)
    talk.reports(pwm=low)


def _reset(talk: Dialogue) -> None:
    talk.order("reset")
    talk.reports(trip="")


# The time by which a watchdog may be late, s; it includes the device's next sample.
MARGIN_SECONDS = 1.5


def watchdog_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests when the watchdog switches off. The device has tripped afterwards."""
    watchdog, low = hello.watchdog or 0.0, few(hello)
    off = (0,) * len(low)
    talk.command(*off)
    talk.reports(pwm=off, owner=talk.owner)
    ok = talk.reports(watchdog + MARGIN_SECONDS, owner="", trip="")
    yield step_result(
        "silence with the cells off releases them, and is no trip", ok, "it does not, or is"
    )
    talk.order("reset")  # where it was one
    talk.reports(trip="")
    for what, lines in (
        ("a refused duty does not feed", _refused),
        ("no other line feeds", _others),
    ):
        fed = _trips(talk, hello, lambda lines=lines: lines(talk, low, hello))
        yield step_result(f"{what} the watchdog", fed is not None, "it has not tripped")
        talk.order("reset")
        talk.reports(trip="")
    took = _trips(talk, hello, lambda: None)
    late = f"no trip=watchdog within {watchdog + MARGIN_SECONDS:g} s"
    yield step_result("its watchdog trips", took is not None, late)
    ok = took is None or took >= 0.5 * watchdog
    yield step_result(
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


def conform(rig: Rig, transport: Transport, clock: Clock) -> Iterator[StepResult]:
    """Tests a device, step by step.

    **Arguments:**

    - `rig`: the rig to which the device should belong.
    - `transport`: an open connection to it.
    - `clock`: host time.

    **Returns:** an iterator over the finding of each step.
    """
    # Another name each time: a device refuses the old numbers of a host that it knows.
    talk = Dialogue(transport, clock, f"conform-{secrets.token_hex(4)}")
    hello = _greeting(talk, encode(Ask(VERSION)))
    refusal = Identity.of(rig).refusal(hello) if hello else f"no hello in {ANSWERS_WITHIN:g} s"
    yield StepResult("answers hello with a greeting that fits the rig", refusal or "")
    if hello is None or refusal is not None:
        return
    again = _greeting(talk, encode(Ask(VERSION)))
    yield step_result(
        "greets in the same way each time", again == hello, f"got {hello}, then {again}"
    )
    later = _greeting(talk, encode_line(f"hello version={VERSION + 1} colour=blue"))
    yield step_result(
        "answers the hello of another version", later == hello, "no hello with its own"
    )
    yield StepResult("counts up its messages and its time, and speaks once a second", _counts(talk))
    if hello.cells:
        yield from command_results(talk, hello)
        yield from line_results(talk, hello)
        yield from watchdog_results(talk, hello)
        yield from trip_results(talk, hello)
    wrong = "; ".join(dict.fromkeys(talk.nonsense[:5]))
    yield StepResult("all that it says is of the protocol", wrong)


def _greeting(talk: Dialogue, question: bytes) -> Hello | None:
    """The next greeting of the device, after all that it has sent by itself."""
    for _ in talk.listen(0.1):
        pass
    talk.say(question)
    return next(
        (message for message in talk.listen(ANSWERS_WITHIN) if isinstance(message, Hello)), None
    )


def _counts(talk: Dialogue) -> str:
    since = talk.clock.now()
    problems: list[str] = []
    before: dict[str, tuple[int, int]] = {}
    for message in talk.listen(2.5):
        if talk.clock.now() - since > 1.5e9:
            problems.append("was silent for more than a second")
        since = talk.clock.now()
        problems += _miscounts(message, before)
    if talk.clock.now() - since > 1.5e9:
        problems.append("was silent for more than a second")
    return "; ".join(dict.fromkeys(problems))


def _miscounts(message: Message, before: dict[str, tuple[int, int]]) -> Iterator[str]:
    """The errors in number and time of a message; `before` has the number that is due, and the last
    time, of each kind."""
    if isinstance(message, Hello | Beat):
        return
    kind = type(message).__name__
    seq, time = getattr(message, "seq", 0), getattr(message, "device_us", 0)
    expected, earlier = before.get(kind, (seq, time))
    if seq != expected:
        yield f"{kind}: number {seq} where {expected} was due"
    if time < earlier:
        yield f"{kind}: t={time} after {earlier}"
    before[kind] = (seq + 1) % 2**32, time
