"""A thread that answers the newest request."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar, final

Request = TypeVar("Request")


@final
class NewestRequest(Generic[Request]):
    """Answers requests in a thread of its own. Of those that come while it is at work only the
    newest is answered: a slider that moves asks more often than anybody can compute.

    **Arguments:**

    - `answer`: called with a request.
    """

    def __init__(self, answer: Callable[[Request], None]):
        self._answer = answer
        self._waiting: list[Request] = []
        self._changed = threading.Condition()
        self._is_open = True
        # A thread that ends with the process.
        self._thread = threading.Thread(target=self._work, name="jaxtwin sliders", daemon=True)
        self._thread.start()

    def ask(self, request: Request) -> None:
        """Leaves a request, in the place of one that waits."""
        with self._changed:
            self._waiting = [request]
            self._changed.notify()

    def close(self) -> None:
        """Ends the thread after the request at which it works."""
        with self._changed:
            self._is_open = False
            self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._is_open)
                if not self._is_open:
                    return
                request = self._waiting.pop()
            self._answer(request)
