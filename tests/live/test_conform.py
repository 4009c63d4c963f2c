"""The conformance kit: it finds nothing wrong with what is right, and each fault that is put in."""

import contextlib
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hand_clock import HandClock
from mutant_devices import RIGS, STAGES, Stage
from mutant_devices import Rig as HonestRig

from jaxtwin.cli import run
from jaxtwin.live import Ask, Duty, InProcess, VirtualRig, conform, encode
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

DEVICE = Path(__file__).parents[2] / "docs" / "firmware" / "device.py"


class Passing:
    """A transport on which time passes: 20 ms with each read."""

    def __init__(self, inner: InProcess, clock: HandClock):
        self._inner, self._clock = inner, clock
        self.write, self.close = inner.write, inner.close

    def read(self) -> bytes:
        self._clock.turn(0.02)
        return self._inner.read()


def wrong(rig: Rig, device: VirtualRig, clock: HandClock) -> list[str]:
    """The steps that failed."""
    findings = list(conform(rig, Passing(InProcess(device, clock), clock), clock))
    return [finding.step for finding in findings if finding.wrong]


def test_the_virtual_rig_conforms(rig: Rig, twin: Twin, clock: HandClock) -> None:
    assert wrong(rig, VirtualRig(twin, camera_rate=1), clock) == []


def names(step: str, rig: Rig, device: VirtualRig, clock: HandClock) -> bool:
    """Whether the conformance test finds a defect in a step."""
    findings = conform(rig, Passing(InProcess(device, clock), clock), clock)
    return any(finding.wrong and finding.step == step for finding in findings)


@pytest.mark.slow
@pytest.mark.parametrize(("mutant", "step"), STAGES, ids=[kind.__name__ for kind, _ in STAGES])
def test_each_defect_of_an_output_stage_is_named(
    rig: Rig, twin: Twin, clock: HandClock, mutant: type[Stage], step: str
) -> None:
    device = VirtualRig(twin, camera_rate=1)
    device.stage = mutant(2, 255, 2.0)
    assert names(step, rig, device, clock)


@pytest.mark.slow
@pytest.mark.parametrize(("mutant", "step"), RIGS, ids=[kind.__name__ for kind, _ in RIGS])
def test_each_defect_in_the_reading_of_lines_is_named(
    rig: Rig, twin: Twin, clock: HandClock, mutant: type[VirtualRig], step: str
) -> None:
    device = mutant(twin, camera_rate=1)
    device.stage = Stage(2, 255, 2.0)
    assert names(step, rig, device, clock)


def test_the_device_of_the_mutants_conforms_without_a_defect(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device = HonestRig(twin, camera_rate=1)
    device.stage = Stage(2, 255, 2.0)
    assert wrong(rig, device, clock) == []


def test_a_greeting_that_does_not_fit_ends_it(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    device.hello = replace(device.hello, watchdog=60.0)
    assert wrong(rig, device, clock) == ["answers hello with a greeting that fits the rig"]


@pytest.fixture
def python_device() -> Iterator[str]:
    """The example in Python, in a process of its own: its address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-u", str(DEVICE), str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == f"listening on port {port}\n"
        yield f"socket://127.0.0.1:{port}"
        process.kill()


@pytest.mark.slow
def test_the_python_device_conforms(python_device: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = run(["conform", "dual-cell", "--link", python_device])
    printed = capsys.readouterr().out
    assert "WRONG" not in printed
    assert (code, printed.count("ok ")) == (0, 56)


NARROW = """
import runpy, socket, sys
plain = socket.socket
def narrow(*how, **more):
    made = plain(*how, **more)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2048)
    return made
socket.socket = narrow
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_the_watchdog_trips_while_a_host_reads_nothing() -> None:
    """As a host that is frozen: its buffers fill, and the cells must go off nevertheless."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-u", "-c", NARROW, str(DEVICE), str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with socket.socket() as frozen:
            frozen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            frozen.connect(("127.0.0.1", port))
            frozen.settimeout(1)
            frozen.sendall(encode(Duty(0, (9, 9), "frozen")))
            with contextlib.suppress(OSError):  # it is cut off
                while True:  # the answers are more than all buffers hold
                    frozen.sendall(encode(Ask(2)) * 50)
            with socket.create_connection(("127.0.0.1", port), timeout=10) as other:
                heard = b""
                while b"trip=watchdog" not in heard:
                    heard += other.recv(10_000)
        process.kill()


def test_the_exit_code_says_that_something_is_wrong(
    python_device: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["conform", "single-cell", "--link", python_device]) == 1
    assert "got dual-cell" in capsys.readouterr().out


@pytest.mark.compiler
def test_the_sketch_conforms(tmp_path: Path, rig: Rig, clock: HandClock) -> None:
    here = Path(__file__).parent
    sketch = DEVICE.parent / "controller" / "controller.ino"
    program = tmp_path / "controller"
    command = [shutil.which("c++") or "c++", "-x", "c++", f"-I{here}/arduino"]
    command += [f'-DSKETCH="{sketch}"', str(here / "arduino" / "main.cpp"), "-o", str(program)]
    subprocess.run(command, check=True)
    with subprocess.Popen(
        [str(program), "100000000", "-1", "-1", "20"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        findings = list(conform(rig, Stepped(process, clock), clock))
        process.kill()
    assert [finding for finding in findings if finding.wrong] == []
    assert len(findings) == 56


class Stepped:
    """The sketch, which waits after each 20 ms of its time for the host to take what it said."""

    def __init__(self, process: subprocess.Popen, clock: HandClock):
        self._process, self._clock = process, clock
        self._waiting = b""

    def write(self, data: bytes) -> None:
        self._waiting += data

    def read(self) -> bytes:
        """Hands over what was written, lets 20 ms pass, and takes what the sketch said."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        sent, self._waiting = self._waiting, b""
        self._process.stdin.write(len(sent).to_bytes(4, "little") + sent)
        self._process.stdin.flush()
        self._clock.turn(0.02)
        length = int.from_bytes(self._process.stdout.read(4), "little")
        return self._process.stdout.read(length)

    def close(self) -> None:
        pass
