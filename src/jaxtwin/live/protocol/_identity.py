"""The names and sizes that the devices of a rig must state in their greetings, and the channels in
camera frames."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final
from urllib.parse import quote, unquote_to_bytes

import numpy as np
from jaxtyping import Float, UInt16

from ..._celsius import ZERO_CELSIUS
from ...errors import LinkError
from ...physics import pixel_weights
from ...rig import Rig
from ._messages import MAX_NAMES, VERSION, Hello

# The largest number of characters of a name, before it is encoded.
MAX_NAME = 32

_WORD = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_QUOTED = re.compile(r"(?:[A-Za-z0-9_.-]|%[0-9A-F]{2})+")
# Without leading zeros, because some readers take `010` for eight. C prints `-0.00` just below 0.
_INTEGER = re.compile(r"0|-?[1-9][0-9]{0,18}")
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,5})(\.[0-9]{1,6})?")


def read_integer(text: str, least: int, most: int) -> int:
    """A whole number. **Raises:** `ValueError` if it is none or out of its bounds."""
    # `int` by itself would accept blanks, underscores and any length.
    if not _INTEGER.fullmatch(text) or not least <= int(text) <= most:
        raise ValueError(f"expected a whole number from {least} to {most}, got {text[:24]!r}")
    return int(text)


def read_number(text: str, least: float = -ZERO_CELSIUS, most: float = 2000.0) -> float:
    """A number in plain digits. **Raises:** `ValueError` if it is none or out of its bounds."""
    if not _NUMBER.fullmatch(text) or not least <= float(text) <= most:
        raise ValueError(f"expected a number from {least:g} to {most:g}, got {text[:24]!r}")
    return float(text)


def read_word(text: str) -> str:
    """Reads a word that a device chooses, such as a kind, a boot or an owner.

    **Raises:** `ValueError` if it is none.
    """
    if not _WORD.fullmatch(text):
        raise ValueError(f"expected 1 to 32 of A-Z a-z 0-9 _ . -, got {text[:40]!r}")
    return text


def write_name(name: str) -> str:
    """A name of a rig, cell or channel, percent-encoded as in URLs for a line."""
    return quote(name, safe="").replace("~", "%7E")


def read_name(text: str) -> str:
    """Reads a name that `write_name` has written.

    **Raises:** `ValueError` if it is none, or written in another way than `write_name` does.
    """
    problem = f"name: expected 1 to {MAX_NAME} characters, quoted by %, got {text[:40]!r}"
    if not _QUOTED.fullmatch(text):
        raise ValueError(problem)
    try:
        name = unquote_to_bytes(text).decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError(problem) from None
    if len(name) > MAX_NAME or not name.isprintable() or write_name(name) != text:
        raise ValueError(problem)
    return name


def read_names(text: str) -> tuple[str, ...]:
    """Reads names that are separated by commas. No name may occur twice."""
    names = tuple(read_name(part) for part in split(text))
    if len(set(names)) < len(names):
        raise ValueError(f"expected at most {MAX_NAMES} names, each once, got {len(names)}")
    return names


def split(text: str) -> Sequence[str]:
    """Returns the parts between commas; an empty text has no parts."""
    parts = text.split(",") if text else []
    if len(parts) > MAX_NAMES:
        raise ValueError(f"expected at most {MAX_NAMES} entries, got {len(parts)}")
    return parts


CENTIKELVIN = 0.01
# The shortest and the longest time of a device's watchdog, s.
WATCHDOG_SECONDS = 0.1, 5.0

# The lowest and the highest ratio of device time to host time.
RATES = 0.1, 1000.0


@final
@dataclass(frozen=True, eq=False)
class Identity:
    """The properties of a rig that the protocol uses.

    **Arguments:**

    - `rig`, `cells`, `channels`: the names of the rig, its cells and heaters, and its channels.
    - `camera`: width and height of its frames, pixels; `None` if sensors read the channels.
    - `counts`: the PWM counts of full duty.
    - `relay`: the name of the relay in the supply; `""` if there is none.
    - `heaters`: the names of those of the cells that only heat.
    - `weights`: share of each pixel in each channel, `(channels, pixels)`; rows sum to 1. Without
      a camera there are no pixels.
    """

    rig: str
    cells: tuple[str, ...]
    channels: tuple[str, ...]
    camera: tuple[int, int] | None
    counts: int
    relay: str
    heaters: tuple[str, ...]
    weights: Float[np.ndarray, "channels pixels"]

    @classmethod
    def of(cls, rig: Rig) -> "Identity":
        """The identity of a rig.

        **Raises:** `LinkError` if a name is too long for a greeting.
        """
        camera, channels = rig.camera, len(rig.channels)
        return cls(
            rig=_checked(rig.name),
            cells=tuple(_checked(name) for name in rig.driven),
            heaters=tuple(_checked(heater.name) for heater in rig.heaters),
            channels=tuple(_checked(channel.name) for channel in rig.channels),
            camera=camera and (camera.width, camera.height),
            counts=rig.driver.counts,
            relay="" if rig.limits is None else rig.limits.relay or "",
            weights=np.zeros((channels, 0))
            if camera is None
            else pixel_weights(rig).reshape(channels, -1),
        )

    def refusal(self, hello: Hello) -> str | None:
        """The reason why a device does not belong to this rig; `None` if it does."""
        if hello.version != VERSION:
            return f"expected version {VERSION} of the protocol, got {hello.version}"
        pairs = (
            ("rig", hello.rig, self.rig),
            ("cells", hello.cells or self.cells, self.cells),
            ("heaters", hello.heaters if hello.cells else self.heaters, self.heaters),
            ("channels", hello.channels or self.channels, self.channels),
            ("camera", hello.camera or self.camera, self.camera),
            ("counts", hello.counts if hello.cells else self.counts, self.counts),
            ("limits.relay", hello.relay or self.relay, self.relay),
        )
        for field, got, expected in pairs:
            if got != expected:
                return f"{field}: expected {expected} as in the rig file, got {got}"
        if not RATES[0] <= hello.rate <= RATES[1]:
            return (
                f"rate: expected {RATES[0]:g} to {RATES[1]:g} s of the device's time in a second, "
                f"got {hello.rate:g}"
            )
        if hello.cells:
            return _watchdog_refusal(hello.watchdog)
        return None

    def temperatures(
        self, pixels: UInt16[np.ndarray, "height width"]
    ) -> Float[np.ndarray, " channels"]:
        """Computes the temperatures of the channels, degC, from a frame in 0.01 K: the means by
        area over the pixels of each channel."""
        return self.weights @ pixels.ravel() * CENTIKELVIN - ZERO_CELSIUS


def _watchdog_refusal(watchdog: float | None) -> str | None:
    shortest, longest = WATCHDOG_SECONDS
    if watchdog is not None and shortest <= watchdog <= longest:
        return None
    got = "none" if watchdog is None else f"{watchdog:g} s"
    return f"watchdog: expected {shortest:g} to {longest:g} s of a device that drives, got {got}"


def _checked(name: str) -> str:
    try:
        return read_name(write_name(name))
    except ValueError:
        raise LinkError(
            f"name: expected 1 to {MAX_NAME} printable characters, got {name!r}"
        ) from None
