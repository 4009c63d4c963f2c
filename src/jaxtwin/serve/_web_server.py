"""The web server, in a thread of its own beside the loop around the rig, and its slow clients."""

import asyncio
import contextlib
import os
import socket
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Any, final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from ..errors import LinkError

if TYPE_CHECKING:
    from starlette.applications import Starlette


# The longest time for which open connections delay the end, s.
CLOSE_SECONDS = 3


def listening(host: str, port: int) -> socket.socket:
    """Opens the port of a server.

    **Raises:** `LinkError` if it is taken, or the address is not one of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None)
        why = os.strerror(number).lower() if number else str(error)
        raise LinkError(
            f"--port {port}: expected a free port of {host}, got {why}; is another server running?"
        ) from None


@final
class WebServer:
    """Serves an application while the block runs.

    **Arguments:**

    - `app`: the application, as `web_app` makes it.
    - `opened`: the open port.
    """

    def __init__(self, app: "Starlette", opened: socket.socket):
        import uvicorn

        self._app, self._socket = app, opened
        config = uvicorn.Config(
            app,
            http=RequestTimeoutProtocol,
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=CLOSE_SECONDS,
            limit_concurrency=500,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="web server", daemon=True)

    def __enter__(self) -> "WebServer":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self._app.state.close()
        self._server.should_exit = True
        self._thread.join(CLOSE_SECONDS + 2)
        with contextlib.suppress(OSError):
            self._socket.close()

    def _run(self) -> None:
        self._server.run(sockets=[self._socket])


# A connection of HTTP that must say what it asks for within some seconds.

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
