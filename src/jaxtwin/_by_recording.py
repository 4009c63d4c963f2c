"""Results by the name of their recording."""

from typing import TypeVar

from ._name_suggestions import did_you_mean
from .errors import RecordingError

T = TypeVar("T")


class ByRecording(dict[str, T]):
    """Recording -> result; an unknown name is a `RecordingError` that lists the known ones."""

    def __missing__(self, name: object) -> T:
        known = ", ".join(self) or "none"
        hint = did_you_mean([str(name)], self)
        raise RecordingError(f"recording: expected one of {known}; got {name!r}{hint}")
