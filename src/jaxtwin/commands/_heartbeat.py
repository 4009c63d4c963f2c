"""Heartbeats for the supervisor of a command: systemd's watchdog, and a health file."""

import contextlib
import json
import os
import socket
import time
from pathlib import Path
from typing import Any, final

from .._whole_file import write_whole_file
from ..errors import JaxtwinError

# Time between two heartbeats, s.
INTERVAL_SECONDS = 1.0


@final
class Heartbeat:
    """Reports to systemd (`NOTIFY_SOCKET`, `Type=notify`) and in a health file that the command is
    alive.

    **Arguments:**

    - `file`: a JSON file with the time and the state, replaced as a whole once a second; or None.
    """

    def __init__(self, file: Path | None):
        self._file = file
        self._last = 0.0
        self._address = os.environ.get("NOTIFY_SOCKET", "")

    def ready(self) -> None:
        """Reports that the command has started its work."""
        self._notify("READY=1")

    def beat(self, content: dict[str, Any]) -> None:
        """Called in every turn of the loop; reports once a second."""
        if time.monotonic() - self._last < INTERVAL_SECONDS:
            return
        self._last = time.monotonic()
        self._notify("WATCHDOG=1")
        if self._file is not None:
            text = json.dumps({"time": time.time(), **content})
            # The recorder reports a full disk.
            with contextlib.suppress(JaxtwinError):
                write_whole_file(self._file, text.encode(), JaxtwinError)

    def _notify(self, text: str) -> None:
        if not self._address:
            return
        address = self._address.replace("@", "\0", 1)  # an abstract socket
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor,
        ):
            supervisor.sendto(text.encode(), address)
