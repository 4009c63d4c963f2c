"""The messages of the protocol, version 1: frames -> messages and back (docs/protocol.md).

Every number from the wire is bounded here; what does not fit exactly is no message.
"""

import re
import struct
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import UInt16

from .._errors import LinkError
from ._framing import encode_line, encode_packet

VERSION = 1
"""Of the protocol."""

RECALIBRATING = 1
"""Flag of a frame taken while the camera recalibrates itself (shutter closed, image frozen)."""

MOST_NAMES = 64  # cells or channels in a greeting
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.-]")
_INTEGER = re.compile(r"-?[0-9]{1,19}")
_NUMBER = re.compile(r"-?[0-9]{1,6}(\.[0-9]{1,6})?")
_HEADER = struct.Struct("<BBBxIQHH")  # kind, 0, flags, sequence, device time, width, height
_IMAGE = 1  # kind of packet


@final
@dataclass(frozen=True)
class Hello:
    """A device's greeting: who it is and what it will send.

    **Arguments:**

    - `version`: of the protocol.
    - `rig`: name of the rig.
    - `boot`: new at every start of the device, since its counters begin anew then.
    - `cells`, `channels`: names; cells where it drives any, channels where it measures them itself.
    - `camera`: width and height of its frames, pixels, or `None`.
    - `counts`: PWM counts of full duty.
    - `watchdog`: without a duty command for this long it switches the cells off, s.
    - `rate`: seconds of device time in a second; 1 but for a virtual or replayed rig.
    """

    version: int
    rig: str
    boot: str
    cells: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    camera: tuple[int, int] | None = None
    counts: int = 255
    watchdog: float = 2.0
    rate: float = 1.0


@final
@dataclass(frozen=True)
class Data:
    """A controller's sample.

    **Arguments:**

    - `seq`: counts up by 1, modulo 2^32.
    - `device_us`: when, on the device's clock, microseconds since its start.
    - `pwm`: counts that are applied to the cells now.
    - `ambient`: degC, or `None` without a sensor for it.
    - `temperatures`: of the greeting's channels, degC; empty where a camera measures them.
    """

    seq: int
    device_us: int
    pwm: tuple[int, ...] = ()
    ambient: float | None = None
    temperatures: tuple[float, ...] = ()


@final
@dataclass(frozen=True, eq=False)
class Image:
    """A camera frame: pixels `(height, width)` in units of 0.01 K; the rest as in `Data`."""

    seq: int
    device_us: int
    flags: int
    pixels: UInt16[np.ndarray, "height width"]


@final
@dataclass(frozen=True)
class Notice:
    """Something that happened on the device, such as its watchdog's stop."""

    seq: int
    device_us: int
    kind: str


@final
@dataclass(frozen=True)
class Beat:
    """Sign of life of a device that has nothing to say."""

    device_us: int


@final
@dataclass(frozen=True)
class Ask:
    """A host's greeting; the device answers with its own."""

    version: int


@final
@dataclass(frozen=True)
class Duty:
    """A host's command: PWM counts of the cells, held until the next or until the watchdog."""

    number: int
    pwm: tuple[int, ...]


Message = Hello | Data | Image | Notice | Beat | Ask | Duty


def wire_name(name: str) -> str:
    """A rig's or channel's name as it stands in messages: other characters become `-`."""
    return _NOT_IN_NAMES.sub("-", name)[:32]


def parse(frame: str | bytes) -> Message:
    """The message in a frame.

    **Raises:** `LinkError` that quotes what is no message of this version.
    """
    try:
        return _parse_line(frame) if isinstance(frame, str) else _parse_packet(frame)
    except (KeyError, ValueError) as error:
        shown = frame if isinstance(frame, str) else frame[:20].hex(" ")
        raise LinkError(f"no message: {shown[:80]!r}: {error}") from None


def encode(message: Message) -> bytes:
    """A message as it is sent.

    **Raises:** `ValueError` where it is too long for a frame.
    """
    if isinstance(message, Image):
        height, width = message.pixels.shape
        head = _HEADER.pack(_IMAGE, 0, message.flags, message.seq, message.device_us, width, height)
        return encode_packet(head + message.pixels.astype("<u2").tobytes())
    return encode_line(_text(message))


def _text(message: Hello | Data | Notice | Beat | Ask | Duty) -> str:
    match message:
        case Hello():
            words = [f"hello version={message.version}", f"rig={message.rig}"]
            words += [f"boot={message.boot}", f"counts={message.counts}"]
            words += [f"watchdog={message.watchdog:g}", f"rate={message.rate:g}"]
            words += [f"cells={','.join(message.cells)}"] if message.cells else []
            words += [f"channels={','.join(message.channels)}"] if message.channels else []
            words += ["camera={}x{}".format(*message.camera)] if message.camera else []
        case Data():
            words = [f"data seq={message.seq} t={message.device_us}"]
            words += [f"pwm={','.join(map(str, message.pwm))}"] if message.pwm else []
            words += [f"ambient={message.ambient:.2f}"] if message.ambient is not None else []
            if message.temperatures:
                words.append("temp=" + ",".join(f"{value:.3f}" for value in message.temperatures))
        case Notice():
            words = [f"event seq={message.seq} t={message.device_us} kind={message.kind}"]
        case Beat():
            words = [f"beat t={message.device_us}"]
        case Ask():
            words = [f"hello version={message.version}"]
        case Duty():
            words = [f"duty n={message.number} pwm={','.join(map(str, message.pwm))}"]
    return " ".join(words)


def _parse_line(line: str) -> Message:
    kind, *words = line.split(" ")
    fields: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key in fields:
            raise ValueError(f"found {word!r}, allowed is key=value, each key once")
        fields[key] = value
    message = _message(kind, fields)
    if fields:
        raise ValueError(f"unknown key {next(iter(fields))!r}")
    return message


def _message(kind: str, fields: dict[str, str]) -> Message:
    """Takes what it knows out of `fields`."""
    match kind:
        case "data":
            return Data(
                seq=_integer(fields.pop("seq"), 0, 2**32 - 1),
                device_us=_integer(fields.pop("t"), 0, 2**62),
                pwm=_integers(fields.pop("pwm", "")),
                ambient=_number(fields.pop("ambient")) if "ambient" in fields else None,
                temperatures=_numbers(fields.pop("temp", "")),
            )
        case "event":
            return Notice(
                seq=_integer(fields.pop("seq"), 0, 2**32 - 1),
                device_us=_integer(fields.pop("t"), 0, 2**62),
                kind=_name(fields.pop("kind")),
            )
        case "beat":
            return Beat(_integer(fields.pop("t"), 0, 2**62))
        case "duty":
            return Duty(_integer(fields.pop("n"), 0, 2**32 - 1), _integers(fields.pop("pwm")))
        case "hello" if "rig" in fields:
            return _hello(fields)
        case "hello":
            # What a later version adds to its greeting must not hide which version it is.
            version = _integer(fields.pop("version"), 0, 999)
            if version != VERSION:
                fields.clear()
            return Ask(version)
    raise ValueError(f"unknown message {kind!r}")


def _hello(fields: dict[str, str]) -> Hello:
    version = _integer(fields.pop("version"), 0, 999)
    rig = _name(fields.pop("rig"))
    if version != VERSION:
        fields.clear()
        return Hello(version, rig, boot="")
    camera = None
    if "camera" in fields:
        width, _, height = fields.pop("camera").partition("x")
        camera = _integer(width, 1, 2**12), _integer(height, 1, 2**12)
    return Hello(
        version,
        rig,
        boot=_name(fields.pop("boot")),
        cells=_names(fields.pop("cells", "")),
        channels=_names(fields.pop("channels", "")),
        camera=camera,
        counts=_integer(fields.pop("counts", "255"), 1, 2**31),
        watchdog=_number(fields.pop("watchdog", "2"), 0.05, 60.0),
        rate=_number(fields.pop("rate", "1"), 1e-3, 1e4),
    )


def _parse_packet(payload: bytes) -> Image:
    if len(payload) < _HEADER.size:
        raise ValueError(f"{len(payload)} bytes are no packet")
    kind, _, flags, seq, device_us, width, height = _HEADER.unpack_from(payload)
    if kind != _IMAGE:
        raise ValueError(f"unknown packet {kind}")
    if len(payload) != _HEADER.size + 2 * width * height or width * height == 0:
        raise ValueError(f"{len(payload)} bytes are no image of {width} x {height} pixels")
    if device_us > 2**62:
        raise ValueError(f"device time {device_us} is above 2^62")
    pixels = np.frombuffer(payload, "<u2", offset=_HEADER.size).reshape(height, width)
    return Image(seq, device_us, flags, pixels)


def _integer(text: str, least: int, most: int) -> int:
    # `int` alone also takes blanks, underscores and any length.
    if not _INTEGER.fullmatch(text) or not least <= int(text) <= most:
        raise ValueError(f"found {text[:24]!r}, allowed are whole numbers {least} to {most}")
    return int(text)


def _number(text: str, least: float = -273.15, most: float = 2000.0) -> float:
    if not _NUMBER.fullmatch(text) or not least <= float(text) <= most:
        raise ValueError(f"found {text[:24]!r}, allowed are numbers {least:g} to {most:g}")
    return float(text)


def _name(text: str) -> str:
    if not _NAME.fullmatch(text):
        raise ValueError(f"found name {text[:40]!r}, allowed are 1 to 32 of A-Z a-z 0-9 _ . -")
    return text


def _names(text: str) -> tuple[str, ...]:
    names = tuple(_name(part) for part in text.split(",")) if text else ()
    if len(names) > MOST_NAMES or len(set(names)) < len(names):
        raise ValueError(f"{len(names)} names; allowed are {MOST_NAMES}, each once")
    return names


def _integers(text: str) -> tuple[int, ...]:
    parts = text.split(",") if text else []
    if len(parts) > MOST_NAMES:
        raise ValueError(f"{len(parts)} numbers; allowed are {MOST_NAMES}")
    return tuple(_integer(part, -(2**31), 2**31) for part in parts)


def _numbers(text: str) -> tuple[float, ...]:
    parts = text.split(",") if text else []
    if len(parts) > MOST_NAMES:
        raise ValueError(f"{len(parts)} numbers; allowed are {MOST_NAMES}")
    return tuple(_number(part) for part in parts)
