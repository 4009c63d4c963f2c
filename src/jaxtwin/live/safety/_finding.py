"""What a check has found on a rig: the reason of a trip or of an alarm."""

from dataclasses import dataclass
from typing import Literal, final

Severity = Literal["warning", "critical"]


@final
@dataclass(frozen=True)
class Finding:
    """What a check has found on a rig.

    **Arguments:**

    - `kind`: the reason in a single word, for programs.
    - `detail`: the reason as a sentence, for people.
    - `channel`: the channel, the cell or the link that it concerns; `""` for the rig as a whole.
    - `since`: host time from which on it is there, ns since 1970; None if nobody says.
    - `severity`: `critical` if the rig is too hot, or if nobody can know; somebody must come then.
    """

    kind: str
    detail: str
    channel: str = ""
    since: int | None = None
    severity: Severity = "warning"

    def __str__(self) -> str:
        return self.detail
