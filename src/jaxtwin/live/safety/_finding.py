"""What a check has found on a rig: the reason of a trip or of an alarm."""

from dataclasses import dataclass
from typing import Literal, final

Severity = Literal["notice", "warning", "critical"]


@final
@dataclass(frozen=True)
class Finding:
    """What a check has found on a rig.

    **Arguments:**

    - `kind`: the reason in a single word, for programs.
    - `detail`: the reason as a sentence, for people.
    - `channel`: the channel, the cell or the link that it concerns; `""` for the rig as a whole.
    - `since`: from when on it is there, None if nobody says: on a live rig host time, ns since
      1970; in a recording its time, s.
    - `severity`: `critical` if the rig is too hot, or if nobody can know; somebody must come then.
      A `notice` is no alarm.
    - `size`, `unit`: how large it is, and in which unit; None if it has no size. `""`: a factor or
      a relative change.
    - `probability`: the probability that it is there, 0 to 1; None if nobody says.
    - `found`, `until`: when it was found, and when it was there last, as `since`; `until` is None
      while it is there.
    """

    kind: str
    detail: str
    channel: str = ""
    since: int | float | None = None
    severity: Severity = "warning"
    size: float | None = None
    unit: str = ""
    probability: float | None = None
    found: int | float | None = None
    until: int | float | None = None

    @property
    def is_alarm(self) -> bool:
        """Whether somebody should look, other than at a notice."""
        return self.severity != "notice"

    def __str__(self) -> str:
        return self.detail
