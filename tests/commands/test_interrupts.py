"""Ctrl-C ends what is under way, says so, and leaves nothing half done."""

import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, cli, reduce_batch
from jaxtwin.commands import _rigs
from jaxtwin.commands._signals import lasting_interrupt, stop_signals


@pytest.fixture(autouse=True)
def _interrupts_are_heard() -> Iterator[None]:
    """A shell starts what it puts into the background with interrupts ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupted_command_says_so_and_exits_with_130(monkeypatch, capsys):
    """128 + 2, the number of the signal, as shells have it; not 0, which says that it is done."""

    def press(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(_rigs, "aligned", press)
    assert cli.run(["rigs"]) == 130
    assert capsys.readouterr().err == "jaxtwin: stopped\n"


@pytest.mark.slow
def test_an_interrupt_in_a_callback_of_the_garbage_collector_is_not_lost():
    """What is raised there Python prints and drops; the handler knows it by its name."""

    def callback() -> None:
        signal.raise_signal(signal.SIGINT)

    def interrupted() -> None:
        with lasting_interrupt():
            callback()
            threading.Event().wait(30)

    callback.__code__ = callback.__code__.replace(co_name="_xla_gc_callback")
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.slow
def test_a_batch_that_is_interrupted_while_it_hands_out_its_chunks_drops_the_rest(monkeypatch):
    def interrupted(pool: ThreadPoolExecutor, work, numbers) -> None:
        for number in numbers:
            pool.submit(work, number)
        raise KeyboardInterrupt

    monkeypatch.setattr(ThreadPoolExecutor, "map", interrupted)
    drive = Experiment.schedule("0:0.5", duration=20)
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        reduce_batch(
            Twin("single-cell"),
            drive,
            {"C_load": np.linspace(20, 30, 4000)},
            ["final"],
            chunk_size=2,
            workers=1,
            on_progress=done.append,
        )
    assert sum(done) < 4000


def test_the_signals_of_a_command_are_named() -> None:
    for number, name in ((signal.SIGINT, ""), (signal.SIGTERM, "SIGTERM")):
        with stop_signals() as stop:
            signal.raise_signal(number)
        assert isinstance(stop, threading.Event)
        assert (stop.is_set(), stop.signal) == (True, name)
