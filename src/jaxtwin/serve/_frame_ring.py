"""One ring of encoded frames, in which each client is a cursor.

A frame is encoded once, however many clients there are. There is no queue for a client: one that is
too slow finds that its next frame has been overwritten, and goes on with the newest. The memory is
the same at all times.
"""

import json
import re
import secrets
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, final

# The number of frames that a ring holds: two minutes of a page that gets ten in a second.
RING_FRAMES = 1200


class Batch(NamedTuple):
    """Frames for a client.

    - `frames`: the frames, as Server-Sent Events, the oldest first.
    - `cursor`: the number of the last frame up to which the client now knows all.
    - `lost`: the number of frames that were overwritten before the client got them.
    """

    frames: tuple[bytes, ...]
    cursor: int
    lost: int


@final
class FrameRing:
    """The newest frames of a page, and the newest of each kind. Several threads may use it.

    **Arguments:**

    - `size`: the number of frames that it holds.
    - `name`: the name of this ring in the ids of its frames, which distinguishes it from that of an
      earlier server; None: a new name.
    - `on_frame`: called with the kind and the content, as JSON, of each frame.
    """

    def __init__(
        self,
        size: int = RING_FRAMES,
        name: str | None = None,
        on_frame: Callable[[str, str], object] = lambda kind, text: None,
    ):
        self.name = secrets.token_hex(4) if name is None else name
        self._frames: list[bytes] = [b""] * size
        self._newest: dict[str, tuple[int, bytes, str]] = {}
        self._count = 0
        self._lock = threading.Lock()
        self._on_frame = on_frame

    @property
    def count(self) -> int:
        """The number of the newest frame; they are counted from 1."""
        return self._count

    def append(self, kind: str, content: Any) -> int:
        """Adds a frame, whose content JSON must be able to hold.

        **Returns:** its number.
        """
        text = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
        with self._lock:
            number = self._count + 1
            frame = f"id: {self.name}-{number}\nevent: {kind}\ndata: {text}\n\n".encode()
            self._frames[number % len(self._frames)] = frame
            self._newest[kind] = (number, frame, text)
            self._count = number
        self._on_frame(kind, text)
        return number

    def after(self, cursor: int) -> Batch:
        """Returns the frames behind a cursor.

        **Arguments:**

        - `cursor`: the number of the last frame that the client has, 0 to `count`.
        """
        with self._lock:
            first = max(cursor + 1, self._count - len(self._frames) + 1)
            numbers = range(first, self._count + 1)
            frames = tuple(self._frames[number % len(self._frames)] for number in numbers)
            return Batch(frames, self._count, first - cursor - 1)

    def newest(self) -> Batch:
        """Returns the newest frame of each kind, in the order of their numbers: what a client needs
        that begins, or that has fallen behind."""
        with self._lock:
            frames = tuple(frame for _, frame, _ in sorted(self._newest.values()))
            return Batch(frames, self._count, 0)

    def newest_contents(self) -> list[tuple[str, str]]:
        """Returns kind and content, as JSON, of the newest frame of each kind, by their numbers."""
        with self._lock:
            result = sorted(
                (number, kind, text) for kind, (number, _, text) in self._newest.items()
            )
        return [(kind, text) for _, kind, text in result]

    def newest_of(self, kind: str) -> Any:
        """Returns the content of the newest frame of a kind; None if there is none."""
        result = self._newest.get(kind)
        return None if result is None else json.loads(result[2])

    def cursor_of(self, event_id: str) -> int | None:
        """Returns the cursor of a client that comes back with the id of its last frame; None if
        frames behind it are gone, or it is an id of another server."""
        result = re.fullmatch(r"([0-9a-z]{1,32})-([0-9]{1,15})", event_id)
        if result is None or result[1] != self.name:
            return None
        cursor = int(result[2])
        return cursor if self._count - len(self._frames) <= cursor <= self._count else None
