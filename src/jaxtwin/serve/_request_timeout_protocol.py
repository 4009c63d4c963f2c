"""A connection of HTTP that must say what it asks for within some seconds."""

import asyncio
from typing import Any, final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

# The longest time from the open connection, or from the first byte of a later request, to the end
# of the headers, s.
HEAD_SECONDS = 10.0


@final
class RequestTimeoutProtocol(H11Protocol):
    """The protocol of uvicorn, which closes a connection that does not complete the head of its
    request: uvicorn alone waits for ever for the rest of one that has begun. A stream is the answer
    to a complete request, and lasts."""

    def __init__(self, *arguments: Any, **more: Any):
        super().__init__(*arguments, **more)
        self._head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Waits for a request."""
        super().connection_made(transport)
        self._look()

    def data_received(self, data: bytes) -> None:
        """Waits for the rest of a request that has begun."""
        super().data_received(data)
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """Waits no longer."""
        super().connection_lost(exc)
        if self._head is not None:
            self._head.cancel()

    def _look(self) -> None:
        if self.conn.their_state is not h11.IDLE:  # the head is complete
            if self._head is not None:
                self._head.cancel()
            self._head = None
        elif self._head is None:
            self._head = self.loop.call_later(HEAD_SECONDS, self.transport.close)
