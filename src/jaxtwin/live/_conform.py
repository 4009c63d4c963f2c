"""Tests whether a device follows the protocol, by a script of greetings, commands and faults.

It commands the cells for short times with a low duty. Set a low current limit on the supply, or
disconnect the cells, before running it.
"""

from collections.abc import Iterator
from typing import NamedTuple

from ..rig import Rig
from ._codec import encode
from ._dialogue import PATIENCE, Dialogue
from ._framing import encode_line
from ._identity import Identity
from ._messages import VERSION, Ask, Beat, Data, Hello, Message
from ._time import Clock
from ._transport import Transport

SMALL = 10
"""The counts that the script commands."""

OWNER, OTHER = "conform-1", "conform-2"


class Finding(NamedTuple):
    """The test of one step of the script, and the error that it found (`""` for none)."""

    step: str
    wrong: str


def conform(rig: Rig, transport: Transport, clock: Clock) -> Iterator[Finding]:
    """Tests a device, step by step.

    **Arguments:**

    - `rig`: the rig to which the device should belong.
    - `transport`: an open connection to it.
    - `clock`: host time.

    **Returns:** an iterator over the finding of each step.
    """
    talk = Dialogue(transport, clock, OWNER)
    talk.say(encode(Ask(VERSION)))
    greeting: list[Hello] = []

    def greets(message: Message) -> bool:
        greeting.extend([message] if isinstance(message, Hello) else [])
        return bool(greeting)

    heard = talk.hears(greets)
    refusal = Identity.of(rig).refusal(greeting[0]) if heard else f"no hello in {PATIENCE:g} s"
    yield Finding("answers hello with a greeting that fits the rig", refusal or "")
    if refusal is not None:
        return
    yield Finding("counts up its messages and its time, and speaks once a second", _counts(talk))
    if greeting[0].cells:
        yield from _commands(talk, greeting[0])
        yield from _nonsense(talk, greeting[0])
        yield from _trips(talk, greeting[0])
    wrong = "; ".join(dict.fromkeys(talk.nonsense[:5]))
    yield Finding("all that it says is of the protocol", wrong)


def _counts(talk: Dialogue) -> str:
    since = talk.clock.now()
    problems: list[str] = []
    before: dict[str, tuple[int, int]] = {}
    for message in talk.listen(2.5):
        if talk.clock.now() - since > 1.5e9:
            problems.append("was silent for more than a second")
        since = talk.clock.now()
        if isinstance(message, Hello | Beat):
            continue
        kind = type(message).__name__
        seq, time = getattr(message, "seq", 0), getattr(message, "device_us", 0)
        expected, earlier = before.get(kind, (seq, time))
        if seq != expected:
            problems.append(f"{kind}: number {seq} where {expected} was due")
        if time < earlier:
            problems.append(f"{kind}: t={time} after {earlier}")
        before[kind] = (seq + 1) % 2**32, time
    if talk.clock.now() - since > 1.5e9:
        problems.append("was silent for more than a second")
    return "; ".join(dict.fromkeys(problems))


def _commands(talk: Dialogue, hello: Hello) -> Iterator[Finding]:
    cells = len(hello.cells)
    few = (SMALL,) * cells
    talk.order("reset")
    yield _found("is off at first", talk.reports(pwm=(0,) * cells, owner="", trip=""), "is not")
    number = talk.command(*few)
    yield _found(
        "applies a duty, and says whose and which",
        talk.reports(pwm=few, owner=OWNER, number=number),
        f"no data with pwm={SMALL},... owner={OWNER} n={number}",
    )
    for more, order in enumerate(("owner={} pwm={} n=77", "n=78 pwm={1} owner={0}"), 1):
        wanted = (SMALL + more,) * cells
        line = "duty " + order.format(OWNER, ",".join(map(str, wanted)))
        talk.say(encode_line(line).replace(b"\n", b"\r\n"))
        ok = talk.reports(pwm=wanted)
        yield _found("takes keys in any order, and CRLF", ok, f"not obeyed: {line}")
    number = talk.command(*few, owner=OTHER)
    ok = talk.refuses(number, "owner")
    yield _found("refuses another commander", ok, "no event with why=owner")
    for counts in ((hello.counts + 1,) * cells, (99_999,) * cells, (1,) * (cells + 1)):
        talk.command(*few)
        number = talk.command(*counts)
        ok = talk.refuses(number, "range") and talk.reports(pwm=few)
        yield _found("refuses what it cannot apply", ok, f"did not refuse {counts} by why=range")


def _nonsense(talk: Dialogue, hello: Hello) -> Iterator[Finding]:
    cells = len(hello.cells)
    few = (SMALL,) * cells
    good = f"duty n=99 owner={OWNER} pwm={','.join(['3'] * cells)}"
    for name, content in (
        ("that is damaged", encode_line(good).replace(b"pwm=3", b"pwm=4")),
        ("without a checksum", good.encode() + b"\n"),
        ("with a key twice", encode_line(good + " n=99")),
        ("with an unknown key", encode_line(good + " more=1")),
        ("without an owner", encode_line(good.replace(f"owner={OWNER} ", ""))),
        ("with numbers that are none", encode_line(good.replace("=3", "=+3"))),
        ("that is too long", b"x" * 2000 + b"\n"),
        ("of noise", b"\x00\x02\xff*\n"),
    ):
        talk.command(*few)
        talk.reports(pwm=few)
        talk.say(content)
        samples = [message for message in talk.listen(0.5) if isinstance(message, Data)]
        ok = bool(samples) and all(sample.pwm == few for sample in samples)
        yield _found(f"a line {name} changes nothing", ok, "it did, or no data came")


def _trips(talk: Dialogue, hello: Hello) -> Iterator[Finding]:
    off = (0,) * len(hello.cells)
    few = (SMALL,) * len(hello.cells)
    watchdog = hello.watchdog or 0.0
    talk.command(*few)
    begin = talk.clock.now()
    ok = talk.reports(watchdog + 1.5, pwm=off, trip="watchdog")
    took = (talk.clock.now() - begin) * 1e-9
    yield _found("its watchdog trips", ok, f"no trip=watchdog within {watchdog + 1.5:g} s")
    ok = not ok or took >= 0.5 * watchdog
    yield _found("its watchdog trips no earlier than it says", ok, f"after {took:.2f} s already")
    number = talk.command(*few)
    yield _found("refuses every duty after a trip", talk.refuses(number, "tripped"), "does not")
    talk.order("reset", OTHER)
    yield _found("a reset ends the trip", talk.reports(pwm=off, trip=""), "it does not")
    talk.command(*few)
    talk.reports(pwm=few)
    talk.order("stop", OTHER)
    yield _found("anyone may stop", talk.reports(pwm=off, trip="stop"), "no data with trip=stop")
    talk.order("reset")
    talk.reports(trip="")
    if hello.relay:
        ok = talk.reports(relay="on")
        yield _found("a reset closes the relay", ok, "no data with relay=on")
        talk.command(*few)
        talk.reports(pwm=few)
        talk.open_relay(hello.relay, OTHER)
        ok = talk.reports(pwm=off, relay="off", trip="relay")
        yield _found("anyone may open the relay", ok, "no data with relay=off trip=relay")
        talk.order("reset")
        talk.reports(trip="")
    talk.command(*few)
    talk.reports(pwm=few)
    talk.order("release")
    ok = talk.reports(pwm=off, owner="", trip="")
    yield _found("a release switches off and is no trip", ok, "it does not")
    number = talk.command(*few, owner=OTHER)
    ok = talk.reports(pwm=few, owner=OTHER, number=number)
    yield _found("after a release another may command", ok, "he is refused")
    talk.order("release", OTHER)


def _found(step: str, ok: bool, wrong: str) -> Finding:
    return Finding(step, "" if ok else wrong)
