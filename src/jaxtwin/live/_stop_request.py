"""The request to end a run early, by a user or by the system."""

import threading
from typing import final


@final
class StopRequest(threading.Event):
    """An event that ends a run and says who asked for it.

    A user who ends a run knows that it ends: the cells are switched off and released. A signal of
    the system, such as SIGTERM, may come while nobody looks: the device then trips as well.
    """

    def __init__(self) -> None:
        super().__init__()
        self.signal = ""
        """The name of the signal that ended the run; `""` for a user's own stop."""
