"""The user's own command at an alarm: a mail, a siren, a message."""

import contextlib
import logging
import os
import subprocess
from types import TracebackType
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from ..live import Finding

# The time that commands have to finish after the end of the recording, s.
END_SECONDS = 10.0

log = logging.getLogger("jaxtwin.live")


@final
class AlarmCommand:
    """A context manager that runs a command for each alarm, without delaying the recording.

    **Arguments:**

    - `command`: a shell command, with `JAXTWIN_ALARM` (one word), `JAXTWIN_ALARM_DETAIL` and
      `JAXTWIN_ALARM_SEVERITY` in its environment; None: alarms are only logged.
    """

    def __init__(self, command: str | None):
        self.rung = False
        """Whether there was an alarm."""
        self._command = command
        self._running: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> "AlarmCommand":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_SECONDS)

    def ring(self, alarm: "Finding", rig: str = "") -> None:
        """Logs an alarm and runs the command; of one of several rigs with `JAXTWIN_ALARM_RIG`."""
        self.rung = True
        log.warning("%s alarm: %s%s", alarm.severity, f"{rig}: " * bool(rig), alarm.detail)
        self._running = [process for process in self._running if process.poll() is None]
        if self._command is None:
            return
        words = {
            "JAXTWIN_ALARM": alarm.kind,
            "JAXTWIN_ALARM_DETAIL": alarm.detail,
            "JAXTWIN_ALARM_SEVERITY": alarm.severity,
            "JAXTWIN_ALARM_RIG": rig,
        }
        self._running.append(
            subprocess.Popen(
                self._command, shell=True, env={**os.environ, **words}, stdin=subprocess.DEVNULL
            )
        )
