"""What an interlock is: a check of a driven rig, without side effects."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from ..protocol._records import Record
from ..protocol._rig_state import RigState
from ._finding import Finding


class AbstractInterlock(ABC):
    """A check for one kind of danger. What it finds switches the cells off.

    A `Guard` asks all its interlocks about every record of the rig. The records contain the host's
    own commands (`Command`), and the documents at the start and the end of a run (`Document`).
    """

    @property
    def settings(self) -> Mapping[str, Any]:
        """What it is set to, for the recording of a run: name with its unit -> number."""
        return {}

    @abstractmethod
    def on_record(self, record: Record, state: RigState) -> Finding | None:
        """Checks a record. Returns the reason to stop, if there is one.

        **Arguments:**

        - `record`: the next record, from before the first command on.
        - `state`: what is known of the rig after it.
        """

    def on_time(self, state: RigState, now: int) -> Finding | None:
        """Checks at host time `now`, ns, what no record shows, such as silence, from the first
        command on. Returns the reason to stop, if there is one."""
        return None

    def before_start(self, state: RigState) -> Finding | None:
        """Checks before the first command. Returns the reason not to start, if there is one."""
        return None
