"""The output of `jaxtwin record`: a single file, or a file for each day."""

import datetime
import hashlib
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from ..live import Recorder, RigConnection
    from ..rig import Rig


@final
class RecordedDays:
    """The recorder of the present day, as a context manager.

    **Arguments:**

    - `out`: the file; with `daily` the day (UTC) is added to its name.
    - `rig`, `append`, `keep_frames`: as for `Recorder`. A file of the present day is continued.
    - `daily`: begin a new file at midnight, and write the checksum of the file before.
    """

    def __init__(self, out: Path, rig: "Rig", *, daily: bool, append: bool, keep_frames: bool):
        self._out, self._rig, self._daily = out, rig, daily
        self._append, self._keep_frames = append, keep_frames
        self._day = self._today()
        self.file = self._named(self._day)
        self.recorder: Recorder = self._opened()

    def __enter__(self) -> "RecordedDays":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self.recorder.__exit__(kind, error, where)

    def turn(self, connection: "RigConnection") -> None:
        """Begins the next day's file after midnight."""
        today = self._today()
        if not self._daily or today == self._day:
            return
        ended, before = self.file, self.recorder
        self._day, self.file = today, self._named(today)
        self.recorder = self._opened()
        connection.record_into(self.recorder)
        before.close("the day is over")
        with ended.open("rb") as stream:
            checksum = hashlib.file_digest(stream, "sha256").hexdigest()
        beside = ended.with_name(ended.name + ".sha256")
        beside.write_text(f"{checksum}  {ended.name}\n", encoding="utf-8")

    def _opened(self) -> "Recorder":
        from ..live import Recorder

        append = self._append or (self._daily and self.file.exists())
        return Recorder(self.file, self._rig, append=append, keep_frames=self._keep_frames)

    def _today(self) -> str:
        return datetime.datetime.now(datetime.UTC).date().isoformat()

    def _named(self, day: str) -> Path:
        if not self._daily:
            return self._out
        return self._out.with_name(f"{self._out.stem}-{day}{self._out.suffix}")
