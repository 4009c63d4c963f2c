"""What every process beside the server does: it ends with the server, however that ends."""

import multiprocessing
import os
import signal
import threading


def end_with_parent() -> None:
    """Makes this process end when its parent has ended, also by a kill, and not by Ctrl-C, which
    reaches all processes of a terminal: the server first switches its cells off."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_wait_for_end, name="parent", daemon=True).start()


def _wait_for_end() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)
