"""The example sketch, compiled for this machine: what it sends is accepted, and its pins obey.

What the pins do is what heats; what the sketch reports is only its word.
"""

import runpy
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from jaxtwin.live import Ask, Data, Duty, Hello, Notice, Order, deframe, encode, encode_line, parse

HERE = Path(__file__).parent
SKETCH = HERE.parents[1] / "docs" / "firmware" / "controller" / "controller.ino"
PWM, HEAT, COOL, RELAY = (9, 10), (7, 5), (8, 6), 4

pytestmark = pytest.mark.compiler


class Ran(NamedTuple):
    """A run: its messages, and every change of a pin as (millisecond, pin, value)."""

    messages: list
    changes: list[tuple[int, int, int]]

    def counts(self, at: int) -> tuple[int, ...]:
        """What the pins gave the cells at a millisecond: negative cools."""
        pins = {pin: value for time, pin, value in self.changes if time <= at}
        return tuple(
            pins[pwm] * (pins[heat] - pins[cool])
            for pwm, heat, cool in zip(PWM, HEAT, COOL, strict=True)
        )

    def notices(self) -> list[tuple[str, str]]:
        return [(m.kind, m.why) for m in self.messages if isinstance(m, Notice)]


def compiled(folder: Path, *options: str) -> Path:
    program = folder / "controller"
    command = [shutil.which("c++") or "c++", "-x", "c++", "-Wall", "-Werror", f"-I{HERE}/arduino"]
    command += [f'-DSKETCH="{SKETCH}"', *options, str(HERE / "arduino" / "main.cpp")]
    subprocess.run([*command, "-o", str(program)], check=True)
    return program


@pytest.fixture(scope="module")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("sketch"))


def run(
    sketch: Path, milliseconds: int, *sent: bytes | int, hot: int = -1, broken: int = -1
) -> Ran:
    """A run that finds `sent` waiting; a number says until when the line is silent before the
    next of it. From `hot` on the thermistors are hot, from `broken` on they are not there."""
    waiting = sketch.with_name("sent")
    waiting.write_bytes(b"".join(b"@%d\n" % s if isinstance(s, int) else s for s in sent))
    with waiting.open("rb") as line:
        command = [str(sketch), *map(str, (milliseconds, hot, broken))]
        ran = subprocess.run(command, stdin=line, capture_output=True, check=True)
    found = deframe(b"", ran.stdout)
    assert (found.discarded, found.remainder) == (0, b"")
    assert b"floating" not in ran.stderr, "a pin was an output before it was off"
    changes = [tuple(map(int, change.split())) for change in ran.stderr.splitlines()]
    return Ran([parse(frame) for frame in found.frames], changes)  # pyright: ignore


def fed(pwm: tuple[int, ...], until: int, owner: str = "me") -> list[bytes | int]:
    """A command that is repeated every quarter of a second."""
    parts: list[bytes | int] = []
    for time in range(0, until, 250):
        parts += [time, encode(Duty(time, pwm, owner))]
    return parts


def test_it_greets_and_sends_ten_samples_a_second(sketch: Path) -> None:
    hello, *samples = run(sketch, 1000).messages
    assert hello == Hello(2, "dual-cell", "7", cells=("P1", "P2"), watchdog=2.0)
    assert samples == [Data(n, (n + 1) * 100_000, (0, 0)) for n in range(10)]


def test_it_answers_a_host_that_asks_and_no_device(sketch: Path) -> None:
    ran = run(sketch, 50, encode(Ask(2)), encode(Hello(2, "dual-cell", "b")))
    assert [type(message) for message in ran.messages] == [Hello, Hello]


def test_pins_obey_until_the_watchdog_trips_and_the_trip_stays(sketch: Path) -> None:
    again = encode(Duty(2, (128, 128), "me"))
    ran = run(sketch, 4000, encode(Duty(1, (128, -255), "me")), 3000, again)
    assert ran.counts(at=2000) == (128, -255)
    assert {ran.counts(at=time) for time in range(2002, 4000)} == {(0, 0)}
    assert ran.notices() == [("trip", "watchdog"), ("refused", "tripped")]
    samples = [message for message in ran.messages if isinstance(message, Data)]
    assert {(s.pwm, s.owner, s.number, s.trip) for s in samples if s.device_us <= 2_000_000} == {
        ((128, -255), "me", 1, "")
    }
    assert {(s.pwm, s.owner, s.number, s.trip) for s in samples if s.device_us > 2_002_000} == {
        ((0, 0), "", None, "watchdog")
    }


def test_after_a_reset_it_obeys_again(sketch: Path) -> None:
    commands = [Order("stop", 1, "x"), Duty(2, (9, 9), "me"), Order("reset", 3, "me")]
    ran = run(sketch, 100, *map(encode, [*commands, Duty(4, (5, 6), "me")]))
    assert ran.counts(at=100) == (5, 6)
    assert ran.notices() == [("trip", "stop"), ("refused", "tripped"), ("reset", "")]


def test_its_own_thermistors_switch_it_off(sketch: Path) -> None:
    for fault, why in (("hot", "over-temperature"), ("broken", "thermistor")):
        ran = run(sketch, 3000, *fed((255, 255), 3000), **{fault: 1000})
        assert ran.counts(at=999) == (255, 255)
        assert {ran.counts(at=time) for time in range(1005, 3000)} == {(0, 0)}
        assert ran.notices()[0] == ("trip", why)


def test_its_relay_opens_with_every_trip_and_closes_with_a_reset(tmp_path: Path) -> None:
    """By its pin; the command has the name of the relay, and any host may send it."""
    relayed = compiled(tmp_path, '-DRELAY="power%20off"')
    on = [encode(Duty(1, (10, 10), "me"))]
    wrong = encode(Order("relay", 1, "other", "another"))
    for trip in (Order("relay", 2, "other", "power off"), Order("stop", 2, "other")):
        reset = encode(Order("reset", 3, "me"))
        ran = run(relayed, 500, *on, 100, wrong, 210, encode(trip), 310, reset)
        relay = [(time, value) for time, pin, value in ran.changes if pin == RELAY]
        assert [value for _, value in relay if value >= 0][-3:] == [1, 0, 1]
        assert [210 <= time < 310 for time, _ in relay][-3:] == [False, True, False]
        assert ran.counts(at=190) == (10, 10)
        assert ran.counts(at=320) == (0, 0)
        assert ran.notices() == [("refused", "relay"), ("trip", trip.kind), ("reset", "")]
        assert ran.messages[0].relay == "power off"
        states = [m.relay for m in ran.messages if isinstance(m, Data)]
        assert (states[0], states[2], states[-1]) == ("on", "off", "on")


def test_one_commander_at_a_time(sketch: Path) -> None:
    ran = run(sketch, 500, encode(Duty(1, (10, 10), "first")), encode(Duty(1, (99, 99), "second")))
    assert ran.counts(at=500) == (10, 10)
    assert ran.notices() == [("refused", "owner")]
    freed = run(
        sketch,
        500,
        *map(encode, [Duty(1, (10, 10), "first"), Order("release", 2, "first")]),
        encode(Duty(1, (99, 99), "second")),
    )
    assert freed.counts(at=500) == (99, 99)


@pytest.mark.parametrize("pwm", [(99999, 0), (256, 0), (0, -256), (1, 1, 1), (1,)])
def test_a_duty_out_of_range_is_refused_and_not_clipped(sketch: Path, pwm: tuple[int, ...]) -> None:
    ran = run(sketch, 500, encode(Duty(1, pwm, "me")))
    assert ran.counts(at=500) == (0, 0)
    assert ran.notices() == [("refused", "range")]


@pytest.mark.parametrize(
    "line",
    [
        "duty n=1 owner=me pwm=128,-20",
        "duty pwm=128,-20 owner=me n=1",
        "duty owner=me pwm=128,-20 n=1",
    ],
)
def test_keys_come_in_any_order_and_lines_end_with_lf_or_crlf(sketch: Path, line: str) -> None:
    plain = encode_line(line)
    for command in (plain, plain.replace(b"\n", b"\r\n")):
        assert run(sketch, 100, command).counts(at=100) == (128, -20)


@pytest.mark.parametrize(
    "command",
    [
        encode(Duty(1, (128, 128), "me")).replace(b"128", b"129", 1),
        b"duty n=1 owner=me pwm=128,128\n",
        b"x" * 300 + encode(Duty(1, (128, 128), "me")),
        *map(
            encode_line,
            [
                "duty n=1 pwm=128,128",
                "duty owner=me pwm=128,128",
                "duty n=1 owner=me pwm=128,128 more=1",
                "duty n=1 owner=me pwm=128,128 pwm=128,128",
                "duty n=-1 owner=me pwm=128,128",
                "duty n=1 owner=m/e pwm=128,128",
                "duty n=1 owner=me pwm=+128,128",
                "duty n=1 owner=me pwm=128,128,",
                "duty n=1 owner=me pwm=128;128",
                "duty n=99999999999 owner=me pwm=128,128",
                "Duty n=1 owner=me pwm=128,128",
            ],
        ),
    ],
)
def test_a_damaged_or_unknown_command_changes_nothing(sketch: Path, command: bytes) -> None:
    ran = run(sketch, 500, command)
    assert {ran.counts(at=time) for time in range(1, 500)} == {(0, 0)}
    assert ran.notices() == []


def test_after_garbage_and_a_newline_it_obeys_again(sketch: Path) -> None:
    ran = run(sketch, 500, b"\x00\xff" * 200 + b"\n" + encode(Duty(1, (1, 2), "me")))
    assert ran.counts(at=500) == (1, 2)


def test_trips_are_in_time_under_a_flood_of_noise(sketch: Path) -> None:
    """Noise comes faster than it is read, for ever: the line is never empty."""
    ran = run(sketch, 4000, encode(Duty(1, (128, -255), "me")), b"~", hot=1000)
    assert ran.counts(at=999) == (128, -255)
    assert {ran.counts(at=time) for time in range(1005, 4000)} == {(0, 0)}
    silent = run(sketch, 4000, encode(Duty(1, (128, -255), "me")), b"~")
    assert {silent.counts(at=time) for time in range(2003, 4000)} == {(0, 0)}


def test_no_direction_changes_under_current(sketch: Path) -> None:
    ran = run(sketch, 100, encode(Duty(1, (200, 200), "me")), encode(Duty(2, (-200, 200), "me")))
    pins = dict.fromkeys((*PWM, *HEAT, *COOL), 0)
    for _, pin, value in ran.changes:
        if pin in (HEAT[0], COOL[0]):
            assert pins[PWM[0]] == 0
        pins[pin] = value
    assert ran.counts(at=100) == (-200, 200)


def spoken(*sent: bytes | int, until: int) -> tuple[list, list[bool]]:
    """What `device.py` says to lines that come at milliseconds, and the states of its relay."""
    module = runpy.run_path(str(SKETCH.parents[1] / "device.py"))
    pins: list[bool] = []
    module["Device"].__init__.__globals__.update(RELAY="power%20off", set_relay=pins.append)
    device, waiting, due = module["Device"](), list(sent), 0
    for now in range(until):
        while waiting and now >= due:
            line = waiting.pop(0)
            if isinstance(line, int):
                due = line
            else:
                device.obey(line.rstrip(b"\n"), now / 1000)
        device.check(now / 1000)
        if now % 100 == 99:
            device.sample(now / 1000)
    return [parse(frame) for frame in deframe(b"", device.out).frames], pins


def test_device_py_with_a_relay_does_what_the_sketch_does(tmp_path: Path) -> None:
    sent: list[bytes | int] = [
        encode(Duty(1, (10, -10), "me")),
        150,
        encode(Order("relay", 1, "other", "another")),
        250,
        encode(Order("relay", 2, "other", "power off")),
        350,
        encode(Order("stop", 3, "other")),
        encode(Duty(2, (10, 10), "me")),
        450,
        encode(Order("reset", 4, "other")),
        550,
        encode(Duty(1, (10, 10), "me")),
        encode(Duty(3, (20, 20), "me")),
    ]
    sketch = run(compiled(tmp_path, '-DRELAY="power%20off"'), 3000, *sent)
    said, pins = spoken(*sent, until=3000)

    def events(messages: list) -> list[tuple[str, str]]:
        return [(m.kind, m.why) for m in messages if isinstance(m, Notice)]

    def states(messages: list) -> list[tuple[object, ...]]:
        samples = [m for m in messages if isinstance(m, Data)]
        return [(m.pwm, m.owner, m.number, m.trip, m.relay) for m in samples]

    assert events(said) == events(sketch.messages)
    assert events(said)[:3] == [("refused", "relay"), ("trip", "relay"), ("refused", "tripped")]
    assert states(said) == states(sketch.messages)
    assert pins == [True, False, False, True, False]
