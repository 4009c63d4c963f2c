"""The web server, in a thread of its own beside the loop around the rig."""

import contextlib
import os
import socket
import threading
from types import TracebackType
from typing import TYPE_CHECKING, final

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

        from ._request_timeout_protocol import RequestTimeoutProtocol

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
