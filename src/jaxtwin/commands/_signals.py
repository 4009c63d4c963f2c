"""Ctrl-C and SIGTERM, for commands that run until they are stopped and for all others."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from ..live import StopRequest


@contextlib.contextmanager
def stop_signals() -> Iterator[StopRequest]:
    """An event that Ctrl-C, SIGTERM and SIGHUP set while the block runs, in place of interrupting
    it. Ctrl-C is a user's own stop; the event names the other signals.

    Enter it before the command prints or writes anything, because its output tells a supervisor
    that it can be stopped.
    """
    stop = StopRequest()

    def press(number: int, _: FrameType | None) -> None:
        if number != signal.SIGINT:
            stop.signal = signal.Signals(number).name
        stop.set()

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, press) for number in signals}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def lasting_interrupt() -> Iterator[None]:
    """Makes sure that a Ctrl-C is not lost while the block runs.

    Python drops exceptions that are raised in a callback of its garbage collector, and JAX has such
    a callback; the work would go on. In this case the interrupt is raised again a moment later.
    """

    def press(number: int, frame: FrameType | None) -> None:
        if frame is not None and frame.f_code.co_name == "_xla_gc_callback":
            again = threading.Timer(0.05, _press_in_main_thread, [number])
            again.daemon = True
            again.start()
            return
        raise KeyboardInterrupt

    # In other threads a handler cannot be set; another handler, such as that of `stop_signals`, is
    # kept.
    own = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if own:
        signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        if own:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _press_in_main_thread(number: int) -> None:
    """Also wakes a waiting main thread, which a signal to another thread does not."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        signal.raise_signal(number)
