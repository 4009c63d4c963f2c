"""Results by the name of their recording."""

from typing import TypeVar

import numpy as np

from ._name_suggestions import did_you_mean
from .errors import RecordingError

T = TypeVar("T")


class ByRecording(dict[str, T]):
    """Recording -> result; an unknown name is a `RecordingError` that lists the known ones."""

    def __missing__(self, name: object) -> T:
        known = ", ".join(self) or "none"
        hint = did_you_mean([str(name)], self)
        raise RecordingError(f"recording: expected one of {known}; got {name!r}{hint}")

    def __repr__(self) -> str:
        parts = (
            f"an array of shape {value.shape}" if isinstance(value, np.ndarray) else repr(value)
            for value in self.values()
        )
        return f"{{{', '.join(f'{n!r}: {part}' for n, part in zip(self, parts, strict=True))}}}"
