"""Encodes messages as frames, and parses frames.

Every number from the wire is checked against its bounds here. A frame that does not follow the
protocol exactly is refused.
"""

import math
import struct

import numpy as np

from ...errors import LinkError
from ._framing import encode_line, encode_packet
from ._identity import (
    read_integer,
    read_name,
    read_names,
    read_number,
    read_word,
    split,
    write_name,
)
from ._messages import (
    VERSION,
    Ask,
    Beat,
    Data,
    Duty,
    Hello,
    Image,
    Message,
    Notice,
    Order,
)

_HEADER = struct.Struct("<BBBxIQHH")  # kind, 0, flags, sequence, device time, width, height
_IMAGE = 1  # kind of packet
_COUNTS = 2**31
_NUMBERS = 2**32 - 1
_LATEST = 2**62  # microseconds


def parse(frame: str | bytes) -> Message:
    """Parses the message in a frame.

    **Raises:** `LinkError`, which quotes the frame, if it is not a message of this version.
    """
    try:
        return _parse_line(frame) if isinstance(frame, str) else _parse_packet(frame)
    except (KeyError, ValueError) as error:
        shown = frame if isinstance(frame, str) else frame[:20].hex(" ")
        why = f"{error} is missing" if isinstance(error, KeyError) else error
        raise LinkError(f"no message: {shown[:80]!r}: {why}") from None


def encode(message: Message) -> bytes:
    """Encodes a message for sending.

    **Raises:** `ValueError` if it is too long for a frame.
    """
    if isinstance(message, Image):
        height, width = message.pixels.shape
        head = _HEADER.pack(_IMAGE, 0, message.flags, message.seq, message.device_us, width, height)
        return encode_packet(head + message.pixels.astype("<u2").tobytes())
    return encode_line(_text(message))


def _text(message: Hello | Data | Notice | Beat | Ask | Duty | Order) -> str:
    match message:
        case Hello():
            words = [f"hello version={message.version}", f"rig={write_name(message.rig)}"]
            words += [f"boot={message.boot}", f"counts={message.counts}"]
            words += [f"watchdog={message.watchdog:g}"] if message.watchdog is not None else []
            words += [f"rate={message.rate:g}"]
            words += [f"cells={_joined(message.cells)}"] if message.cells else []
            words += [f"channels={_joined(message.channels)}"] if message.channels else []
            words += ["camera={}x{}".format(*message.camera)] if message.camera else []
            words += [f"relay={write_name(message.relay)}"] if message.relay else []
            words += [f"heaters={_joined(message.heaters)}"] if message.heaters else []
        case Data():
            words = [f"data seq={message.seq} t={message.device_us}"]
            words += [f"pwm={','.join(map(str, message.pwm))}"] if message.pwm else []
            words += [f"ambient={message.ambient:.2f}"] if message.ambient is not None else []
            words += [f"temp={_temperatures(message)}"] if message.temperatures else []
            words += _about(message.owner, message.number)
            words += [f"trip={message.trip}"] if message.trip else []
            words += [f"relay={message.relay}"] if message.relay else []
        case Notice():
            words = [f"event seq={message.seq} t={message.device_us} kind={message.kind}"]
            words += _about(message.owner, message.number)
            words += [f"why={message.why}"] if message.why else []
        case Beat():
            words = [f"beat t={message.device_us}"]
        case Ask():
            words = [f"hello version={message.version}"]
        case Duty():
            words = [f"duty n={message.number} owner={message.owner}"]
            words += [f"pwm={','.join(map(str, message.pwm))}"]
        case Order():
            words = [f"{message.kind} n={message.number} owner={message.owner}"]
            words += [f"name={write_name(message.name)}"] if message.name else []
    return " ".join(words)


def _joined(names: tuple[str, ...]) -> str:
    return ",".join(map(write_name, names))


def _temperatures(message: Data) -> str:
    return ",".join(
        f"!{message.faults.get(place, 'nan')}" if math.isnan(value) else f"{value:.3f}"
        for place, value in enumerate(message.temperatures)
    )


def _about(owner: str, number: int | None) -> list[str]:
    return ([f"owner={owner}"] if owner else []) + ([f"n={number}"] if number is not None else [])


def _parse_line(line: str) -> Message:
    kind, *words = line.split(" ")
    fields: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key in fields:
            raise ValueError(f"expected key=value, each key once, got {word!r}")
        fields[key] = value
    message = _message(kind, fields)
    if fields:
        raise ValueError(f"unknown key {next(iter(fields))!r}")
    return message


def _message(kind: str, fields: dict[str, str]) -> Message:
    """Makes a message from `fields`, and removes from them the fields that it uses."""
    match kind:
        case "data":
            return _data(fields)
        case "event":
            return Notice(
                seq=read_integer(fields.pop("seq"), 0, _NUMBERS),
                device_us=read_integer(fields.pop("t"), 0, _LATEST),
                kind=read_word(fields.pop("kind")),
                owner=_owner(fields),
                number=_number_of(fields),
                why=read_word(fields.pop("why")) if "why" in fields else "",
            )
        case "beat":
            return Beat(read_integer(fields.pop("t"), 0, _LATEST))
        case "duty":
            return Duty(
                read_integer(fields.pop("n"), 0, _NUMBERS),
                _counts(fields.pop("pwm")),
                read_word(fields.pop("owner")),
            )
        case "stop" | "reset" | "release":
            number = read_integer(fields.pop("n"), 0, _NUMBERS)
            return Order(kind, number, read_word(fields.pop("owner")))
        case "relay":
            number = read_integer(fields.pop("n"), 0, _NUMBERS)
            owner, name = read_word(fields.pop("owner")), read_name(fields.pop("name"))
            return Order(kind, number, owner, name)
        case "hello" if "rig" in fields:
            return _hello(fields)
        case "hello":
            # Unknown keys of a later version must not prevent that its version is read.
            version = read_integer(fields.pop("version"), 0, 999)
            if version != VERSION:
                fields.clear()
            return Ask(version)
    raise ValueError(f"unknown message {kind!r}")


def _hello(fields: dict[str, str]) -> Hello:
    version = read_integer(fields.pop("version"), 0, 999)
    rig = read_name(fields.pop("rig"))
    if version != VERSION:
        fields.clear()
        return Hello(version, rig, boot="")
    camera = None
    if "camera" in fields:
        width, _, height = fields.pop("camera").partition("x")
        camera = read_integer(width, 1, 2**12), read_integer(height, 1, 2**12)
    watchdog = fields.pop("watchdog", None)
    return Hello(
        version,
        rig,
        boot=read_word(fields.pop("boot")),
        cells=read_names(fields.pop("cells", "")),
        channels=read_names(fields.pop("channels", "")),
        camera=camera,
        counts=read_integer(fields.pop("counts", "255"), 1, _COUNTS),
        # Whether they are acceptable is not a question of form: see `Identity.refusal`.
        watchdog=None if watchdog is None else read_number(watchdog, 0.0, 1e6),
        rate=read_number(fields.pop("rate", "1"), 0.0, 1e6),
        relay=read_name(fields.pop("relay")) if "relay" in fields else "",
        heaters=read_names(fields.pop("heaters", "")),
    )


def _data(fields: dict[str, str]) -> Data:
    words = split(fields.pop("temp", ""))
    faults = {
        place: read_word(word.removeprefix("!"))
        for place, word in enumerate(words)
        if word.startswith("!") or word == "nan"  # as C prints what is no number
    }
    return Data(
        seq=read_integer(fields.pop("seq"), 0, _NUMBERS),
        device_us=read_integer(fields.pop("t"), 0, _LATEST),
        pwm=_counts(fields.pop("pwm", "")),
        ambient=read_number(fields.pop("ambient")) if "ambient" in fields else None,
        temperatures=tuple(
            math.nan if place in faults else read_number(word) for place, word in enumerate(words)
        ),
        faults=faults,
        owner=_owner(fields),
        number=_number_of(fields),
        trip=read_word(fields.pop("trip")) if "trip" in fields else "",
        relay=_relay(fields),
    )


def _relay(fields: dict[str, str]) -> str:
    state = fields.pop("relay", "")
    if state not in ("", "on", "off"):
        raise ValueError(f"expected relay=on or relay=off, got {state[:24]!r}")
    return state


def _owner(fields: dict[str, str]) -> str:
    return read_word(fields.pop("owner")) if "owner" in fields else ""


def _number_of(fields: dict[str, str]) -> int | None:
    return read_integer(fields.pop("n"), 0, _NUMBERS) if "n" in fields else None


def _counts(text: str) -> tuple[int, ...]:
    return tuple(read_integer(part, -_COUNTS, _COUNTS) for part in split(text))


def _parse_packet(payload: bytes) -> Image:
    if len(payload) < _HEADER.size:
        raise ValueError(f"{len(payload)} bytes are no packet")
    kind, _, flags, seq, device_us, width, height = _HEADER.unpack_from(payload)
    if kind != _IMAGE:
        raise ValueError(f"unknown packet {kind}")
    if len(payload) != _HEADER.size + 2 * width * height or width * height == 0:
        raise ValueError(f"{len(payload)} bytes are no image of {width} x {height} pixels")
    if device_us > _LATEST:
        raise ValueError(f"device time {device_us} is above 2^62")
    pixels = np.frombuffer(payload, "<u2", offset=_HEADER.size).reshape(height, width)
    return Image(seq, device_us, flags, pixels)
