"""What is printed never blocks: a pipe that nobody reads does not keep a program from being
stopped."""

import os
import signal
import subprocess
import sys
import time

SCRIPT = """
import signal, sys, threading
from jaxtwin.cli import _fail
from jaxtwin.commands._signals import stop_signals
from jaxtwin.commands._unblocked_output import unblocked_output
with stop_signals() as stop, unblocked_output():
    print("ready", flush=True)
    while not stop.wait(0.001):
        print("x" * 4096, file=sys.stderr)
sys.exit(_fail("stopped", 3))
"""


def test_a_signal_ends_a_program_whose_messages_nobody_reads() -> None:
    read, write = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, stderr=write
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"ready\n"
        time.sleep(0.5)  # longer than 64 kB take
        program.send_signal(signal.SIGTERM)
        assert program.wait(30) == 3
    os.close(read)
    os.close(write)


def test_what_is_printed_arrives_in_its_order() -> None:
    script = SCRIPT.replace("while not stop.wait(0.001):", "for number in range(500):").replace(
        'print("x" * 4096, file=sys.stderr)', 'print(number, "°", file=sys.stderr)'
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONUTF8": "1"},
        check=False,
    )
    lines = done.stderr.splitlines()
    assert lines[:500] == [f"{number} °" for number in range(500)]
    assert lines[500:] == ["jaxtwin: stopped"]
