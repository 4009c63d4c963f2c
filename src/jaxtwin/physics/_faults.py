"""The faults of a simulated rig and of its link, with their times."""

import re
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from ..errors import JaxtwinError
from ._fault_models import FAULT_MODELS, SIGNED_MODELS, Fault
from ._twin import Twin

_EXAMPLES = (
    "drop=0.01, corrupt=0.001, jumps=164, stall=30/5, disconnect=60, loosen=P1@300/10, "
    f"fail=P2@600, and likewise {', '.join(sorted(FAULT_MODELS.keys() - {'loosen', 'fail'}))}"
)


class TimedFault(NamedTuple):
    """A fault of the rig that begins at a time.

    - `model`: its name in `FAULT_MODELS`. `part`: the cell, the channel or what else is faulty.
    - `time`: the time from which on it is there, s of the rig. `size`: its size.
    """

    model: str
    part: str
    time: float
    size: float

    def of(self, twin: Twin) -> Fault:
        """The fault as a change of the equations of a twin.

        **Raises:** `SimulationError` if its rig does not have the faulty part.
        """
        return FAULT_MODELS[self.model](twin, self.part, np.float64(self.size))


@final
@dataclass(frozen=True)
class Faults:
    """Faults and their times, in s of the rig.

    **Arguments:**

    - `drop`, `corrupt`: the probabilities that a message is lost, and that bytes of it are changed.
    - `jumps`: the interval of the camera's recalibrations; each changes its offset by the
      `[camera.common_error]` of the rig file. 0: never.
    - `stall`: (interval, duration) of silences.
    - `disconnect`: the interval after which the connection is cut. 0: never.
    - `rig`: the faults of the rig itself.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    jumps: float = 0.0
    stall: tuple[float, float] | None = None
    disconnect: float = 0.0
    rig: tuple[TimedFault, ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Faults":
        """Parses text such as `"drop=0.01,stall=30/5,loosen=P1@300/10"`.

        **Raises:** `JaxtwinError` that quotes the wrong word.
        """
        fields: dict[str, object] = {}
        rig: list[TimedFault] = []
        for word in filter(None, (part.strip() for part in text.split(","))):
            key, _, value = word.partition("=")
            try:
                if key in FAULT_MODELS:
                    rig.append(_timed(key, value))
                else:
                    fields[key] = _value(key, value)
            except (KeyError, ValueError):
                raise JaxtwinError(
                    f"fault: expected words like {_EXAMPLES}, got {word!r}"
                ) from None
        return cls(**fields, rig=tuple(rig))  # pyright: ignore[reportArgumentType]


def _value(key: str, text: str) -> object:
    match key:
        case "drop" | "corrupt":
            if not 0 <= float(text) < 1:
                raise ValueError
            return float(text)
        case "jumps" | "disconnect":
            return _seconds(text)
        case "stall":
            every, _, length = text.partition("/")
            return _seconds(every), _seconds(length)
    raise KeyError(key)


def _timed(model: str, text: str) -> TimedFault:
    """A fault of the rig, PART@TIME/SIZE; without a size it is 1."""
    result = re.fullmatch(r"([^@]+)@([^/]+)(?:/(.+))?", text)
    if result is None:
        raise ValueError
    part, time, size = result.groups()
    number = 1.0 if size is None else float(size)
    if not (-1e9 if model in SIGNED_MODELS else 0) < number < 1e9:
        raise ValueError
    return TimedFault(model, part, _seconds(time), number)


def _seconds(text: str) -> float:
    number = float(text)
    if not 0 < number < 1e9:
        raise ValueError
    return number
