"""Pytest in forks of a process that has imported the libraries once."""

import contextlib
import importlib
import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import final

import pytest

LIBRARIES = (
    "jax",
    "diffrax",
    "optimistix",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "xarray",
    "matplotlib.pyplot",
    "pydantic",
    "pint",
    "beartype",
    "typer",
    "rich",
)
"""What nearly all tests import, and what imports nothing of the package."""

START = "the start of pytest"

PATIENCE = {False: 300.0, True: 600.0}
"""Seconds after which a test counts as one without an end; the latter of the slow ones."""


def import_libraries() -> None:
    """Imports what every fork will have. The figures are drawn in memory."""
    os.environ["MPLBACKEND"] = "Agg"
    for library in LIBRARIES:
        importlib.import_module(library)


def first_failure(copy: Path, tests: list[str], slow: bool, limit: float) -> str:
    """The first test that fails, or what else ended pytest; empty if all pass.

    **Arguments:**

    - `copy`: of the checkout, whose tests run on its package.
    - `tests`: files or functions, in the order in which they run.
    - `slow`: whether the slow ones of them run, or the others.
    - `limit`: seconds of CPU time of the tests' process, after which no further test begins.
    """
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    marks = "slow" if slow else "not slow"
    child = context.Process(target=_run, args=(copy, ["-xqm", marks, *tests], sender))
    child.start()
    sender.close()
    current, failure = START, None
    while failure is None:
        if not receiver.poll(PATIENCE[slow]):
            if current == START:
                _end(child)
                sys.exit(f"expected tests that begin within {PATIENCE[slow]:.0f} s, got none")
            failure = f"no end within {PATIENCE[slow]:.0f} s of {current}"
            break
        try:
            kind, name, seconds = receiver.recv()
        except EOFError:
            failure = f"the process ended in {current}"
            break
        if kind == "start":
            current = name
            if seconds > limit:
                failure = ""
        elif kind == "failure":
            failure = name
        else:
            # 5: no test has these marks.
            failure = "" if name in ("0", "5") else f"pytest ended with {name}"
    _end(child)
    return failure


def _end(child: BaseProcess) -> None:
    """Ends the fork with the processes that its tests have started."""
    child.join(1)
    if child.pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
    child.join()


def _run(copy: Path, command: list[str], sender: Connection) -> None:
    """Runs pytest; in the fork."""
    os.setsid()
    os.chdir(copy)
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)
    checkout = str(Path(__file__).parent.parent)
    sys.path[:] = [str(copy / "src"), *(str(copy) if p == checkout else p for p in sys.path)]
    os.environ["PYTHONPATH"] = str(copy / "src")
    # Kept bytecode is found by a file's length and second, which a mutation may share.
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    # Pytest would warn that its plugins among the libraries cannot be rewritten any more.
    imported = "ignore::pytest.PytestAssertRewriteWarning"
    command = ["-p", "no:cacheprovider", "-W", imported, *command]
    status = pytest.main(command, plugins=[_Reporter(sender)])
    sender.send(("end", str(int(status)), time.process_time()))
    os._exit(0)  # threads of a test that failed may never end


@final
class _Reporter:
    """A plugin of pytest that says which test runs and which has failed."""

    def __init__(self, sender: Connection) -> None:
        self.sender = sender

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.sender.send(("start", nodeid, time.process_time()))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.sender.send(("failure", report.nodeid, time.process_time()))

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.sender.send(("failure", report.nodeid, time.process_time()))
