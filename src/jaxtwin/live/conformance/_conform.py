"""Tests whether a device follows the protocol, by a script of greetings, commands and faults.

It commands the cells for short times with a low duty. Set a low current limit on the supply, or
disconnect the cells, before running it.
"""

import secrets
from collections.abc import Iterator

from ...rig import Rig
from ..protocol._clock import Clock
from ..protocol._codec import encode
from ..protocol._framing import encode_line
from ..protocol._identity import Identity
from ..protocol._messages import VERSION, Ask, Beat, Hello, Message
from ..protocol._transport import Transport
from ._commands import command_results, line_results
from ._dialogue import ANSWERS_WITHIN, Dialogue
from ._step_result import StepResult, found
from ._trips import trip_results
from ._watchdog import watchdog_results


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
    yield found("greets in the same way each time", again == hello, f"got {hello}, then {again}")
    later = _greeting(talk, encode_line(f"hello version={VERSION + 1} colour=blue"))
    yield found("answers the hello of another version", later == hello, "no hello with its own")
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
