"""The stream of a client: Server-Sent Events from a ring, at the client's own pace."""

import json
from collections.abc import AsyncIterator, Awaitable, Callable

from ._frame_ring import FrameRing

# The time between two looks of a client at the ring, s: all frames between are sent together.
POLL_SECONDS = 0.05

# The time after which a line without meaning is sent, s, so that proxies keep the connection.
KEEPALIVE_SECONDS = 5.0


async def stream(
    ring: FrameRing,
    last_id: str,
    wait: Callable[[float], Awaitable[object]],
    is_closing: Callable[[], bool],
) -> AsyncIterator[bytes]:
    """Yields the frames of a ring.

    A client that begins, or whose next frame has been overwritten, gets `hello` with the number of
    lost frames, and the newest frame of each kind. One that comes back with the id of its last
    frame goes on behind it.

    **Arguments:**

    - `ring`: the ring.
    - `last_id`: the id of the last frame that the client has; `""` if it has none.
    - `wait`: waits so many seconds.
    - `is_closing`: whether the server ends.
    """
    yield b"retry: 1000\n\n"
    cursor = ring.cursor_of(last_id)
    lost, quiet = 0, 0.0
    while not is_closing():
        if cursor is None:
            batch = ring.newest()
            yield _hello(ring, batch.cursor, lost) + b"".join(batch.frames)
        else:
            batch = ring.after(cursor)
            if batch.lost:
                lost, cursor = batch.lost, None
                continue
            if batch.frames:
                yield b"".join(batch.frames)
            elif quiet >= KEEPALIVE_SECONDS:
                yield b":\n\n"
        quiet = 0.0 if batch.frames or quiet >= KEEPALIVE_SECONDS else quiet + POLL_SECONDS
        cursor = batch.cursor
        await wait(POLL_SECONDS)


def _hello(ring: FrameRing, cursor: int, lost: int) -> bytes:
    content = json.dumps({"server": ring.name, "lost": lost})
    return f"id: {ring.name}-{cursor}\nevent: hello\ndata: {content}\n\n".encode()
