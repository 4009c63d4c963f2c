"""The reason why the cells must go off, or why somebody must come."""

from typing import Literal, NamedTuple

_CRITICAL = frozenset({"over-temperature", "stale-temperature", "still-on", "unconfirmed"})


class Trip(NamedTuple):
    """The reason why an interlock stops a rig, or of an alarm.

    - `kind`: the reason in a single word, for programs.
    - `detail`: the reason as a sentence, for people.
    """

    kind: str
    detail: str

    @property
    def severity(self) -> Literal["critical", "warning"]:
        """The severity as an alarm: critical if the rig is too hot, or if nobody can know."""
        return "critical" if self.kind in _CRITICAL else "warning"

    def __str__(self) -> str:
        return self.detail
