"""The example sketch, compiled for this machine: what it sends is accepted, and it obeys."""

import shutil
import subprocess
from pathlib import Path

import pytest

from jaxtwin.live import Ask, Data, Duty, Hello, Notice, deframe, encode, parse

HERE = Path(__file__).parent
SKETCH = HERE.parents[1] / "docs" / "firmware" / "controller" / "controller.ino"

pytestmark = pytest.mark.compiler


@pytest.fixture(scope="module")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("sketch") / "controller"
    command = [shutil.which("c++") or "c++", "-x", "c++", "-Wall", "-Werror", f"-I{HERE}/arduino"]
    command += [f'-DSKETCH="{SKETCH}"', str(HERE / "arduino" / "main.cpp"), "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def run(sketch: Path, milliseconds: int, sent: bytes) -> list:
    """The messages of a run that finds `sent` waiting; after that the line is silent."""
    waiting = sketch.with_name("sent")
    waiting.write_bytes(sent)
    with waiting.open("rb") as line:
        command = [str(sketch), str(milliseconds)]
        output = subprocess.run(command, stdin=line, capture_output=True, check=True).stdout
    found = deframe(b"", output)
    assert (found.discarded, found.rest) == (0, b"")
    return [parse(frame) for frame in found.frames]


def test_it_greets_and_sends_ten_samples_a_second(sketch: Path) -> None:
    hello, *samples = run(sketch, 1000, b"")
    assert hello == Hello(1, "dual-cell", "7", cells=("P1", "P2"))
    assert samples == [Data(n, (n + 1) * 100_000, (0, 0)) for n in range(10)]


def test_it_answers_a_host_that_asks(sketch: Path) -> None:
    messages = run(sketch, 50, encode(Ask(1)))
    assert [type(message) for message in messages] == [Hello, Hello]


def test_it_applies_a_command_until_its_watchdog_ends_it(sketch: Path) -> None:
    messages = run(sketch, 3000, encode(Duty(1, (128, -999))))
    samples = [message for message in messages if isinstance(message, Data)]
    assert {s.pwm for s in samples if s.device_us <= 2_000_000} == {(128, -255)}
    assert {s.pwm for s in samples if s.device_us > 2_000_000} == {(0, 0)}
    assert [m for m in messages if isinstance(m, Notice)] == [Notice(0, 2_002_000, "watchdog")]


@pytest.mark.parametrize(
    "command",
    [
        encode(Duty(1, (128, 128))).replace(b"128", b"129", 1),
        encode(Duty(1, (128, 128, 128))),
        encode(Duty(1, (128,))),
        b"duty n=1 pwm=128,128\n",
        b"x" * 300 + encode(Duty(1, (128, 128))),
    ],
)
def test_a_damaged_command_changes_nothing(sketch: Path, command: bytes) -> None:
    messages = run(sketch, 500, command)
    assert {message.pwm for message in messages if isinstance(message, Data)} == {(0, 0)}


def test_after_garbage_and_a_newline_it_obeys_again(sketch: Path) -> None:
    messages = run(sketch, 500, b"\x00\xff" * 200 + b"\n" + encode(Duty(1, (1, 2))))
    assert messages[-1].pwm == (1, 2)
