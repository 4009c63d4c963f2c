"""A virtual rig in this process, behind a port of its own."""

import threading
from types import TracebackType
from typing import final

from ..live import SystemClock, TcpServer, VirtualRig
from ..live import serve as serve_device


@final
class VirtualLink:
    """Runs a virtual rig in a thread while the block runs.

    **Arguments:**

    - `device`: the virtual rig.
    """

    def __init__(self, device: VirtualRig):
        self._server = TcpServer("127.0.0.1:0")
        self.url = self._server.url
        """The address of its link."""
        self._stop = threading.Event()
        arguments = (device, self._server, SystemClock(), self._stop)
        self._thread = threading.Thread(
            target=serve_device, args=arguments, name="virtual rig", daemon=True
        )

    def __enter__(self) -> "VirtualLink":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._server.close()
