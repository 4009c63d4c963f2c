"""Results by the name of their recording."""

import difflib
from typing import TypeVar

from ._errors import RecordingError

T = TypeVar("T")


class ByRecording(dict[str, T]):
    """Recording -> result; an unknown name is a `RecordingError` that lists the known ones."""

    def __missing__(self, name: object) -> T:
        known = ", ".join(self) or "none"
        near = difflib.get_close_matches(str(name), self, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise RecordingError(f"recording: expected one of {known}; got {name!r}{hint}")
