"""Conformance: the duty that a device applies, and the lines that change nothing."""

from collections.abc import Iterator

from ..protocol._framing import encode_line
from ..protocol._messages import Hello
from ._dialogue import Dialogue
from ._step_result import StepResult, found

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
    yield found("is off at first", talk.reports(pwm=(0,) * cells, owner="", trip=""), "is not")
    number = talk.command(*low)
    yield found(
        "applies a duty, and says whose and which",
        talk.reports(pwm=low, owner=talk.owner, number=number),
        f"no data with pwm={SMALL},... owner={talk.owner} n={number}",
    )
    for sign in (1, -1):
        signs = [1 if hello.lowest(cell) == 0 else sign * (-1) ** cell for cell in range(cells)]
        own = tuple(sign * (SMALL + cell) for cell, sign in enumerate(signs))
        talk.command(*own)
        ok = talk.reports(pwm=own)
        yield found("gives each cell its own counts, of either sign", ok, f"no data with pwm={own}")
    for more, order in enumerate(("owner={} pwm={} n={}", "n={2} pwm={1} owner={0}"), 1):
        wanted = (SMALL + more,) * cells
        counts = ",".join(map(str, wanted))
        line = "duty " + order.format(talk.owner, counts, talk.next_number())
        talk.say(encode_line(line).replace(b"\n", b"\r\n"))
        ok = talk.reports(pwm=wanted)
        yield found("takes keys in any order, and CRLF", ok, f"not obeyed: {line}")
    yield from _of_another(talk, low)
    yield from _beyond(talk, hello)
    yield from _old(talk, low)


def _of_another(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    for pwm in (low, (0,) * len(low)):
        number = talk.command(*pwm, owner=OTHER_HOST)
        ok = talk.refuses(number, "owner")
        yield found("refuses another commander", ok, f"{pwm}: no event with why=owner")
    talk.command(*low)
    number = talk.order("release", OTHER_HOST)
    ok = talk.refuses(number, "owner") and talk.reports(pwm=low, owner=talk.owner)
    yield found("refuses the release of another", ok, "no event with why=owner, or it is off")
    last = talk.command(*low)
    number = talk.order("reset", OTHER_HOST)
    talk.order("reset")
    ok = talk.refuses(number, "owner")
    ok = ok and talk.keeps(0.3, pwm=low, owner=talk.owner, number=last)
    yield found("a reset without a trip changes nothing", ok, "it did, or no event with why=owner")


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
        yield found("refuses what it cannot apply", ok, f"did not refuse {counts} by why=range")


def _old(talk: Dialogue, low: tuple[int, ...]) -> Iterator[StepResult]:
    for what, ago in (("a repeated", 0), ("an older", 1)):
        talk.command(*low)
        last = talk.command(*low)
        number = talk.command(*(SMALL + 5,) * len(low), number=last - ago)
        ok = talk.refuses(number, "old") and talk.reports(pwm=low, number=last)
        yield found(f"refuses {what} number", ok, f"no event with why=old n={number}")


def line_results(talk: Dialogue, hello: Hello) -> Iterator[StepResult]:
    """Tests that lines with an error change nothing."""
    low = few(hello)
    for name in wrong_lines(talk, len(low)):
        talk.command(*low)
        talk.reports(pwm=low)
        talk.say(wrong_lines(talk, len(low))[name])
        ok = talk.keeps(0.5, pwm=low, owner=talk.owner)
        yield found(f"a line {name} changes nothing", ok, "it did, or no data came")


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
