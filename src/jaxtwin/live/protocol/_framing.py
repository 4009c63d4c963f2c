r"""Divides the bytes of a link into frames: text lines and binary packets, each with a CRC-32.

A line is printable ASCII with its checksum, `text*1A2B3C4D\n`: easy to write from firmware and to
read in a terminal. A packet is for images: its bytes and their CRC-32 (little-endian) are encoded
with COBS (Cheshire and Baker, 1999) so that they hold no zero, and stand between two zeros.
Both may share a link. The second byte of every packet is 0 and its first is not, so a packet always
begins with the two bytes 00 02, which no text line holds. A reader that lost its place finds it
again at the next newline or zero.

Lines have a CRC-32 too (that of zlib, Ethernet and PNG): with 16 bits, one of 65 000 damaged lines
would pass.
"""

import re
import zlib
from typing import NamedTuple

from cobs import cobs

# The longest valid line, including checksum and newline.
LINE_BYTES = 1024

# The longest valid packet, encoded; 160 x 120 pixels of 16 bits take 38.6 kB.
PACKET_BYTES = 65_536

_CHECKSUM = 4  # bytes of a CRC-32
_NO_TEXT = re.compile(rb"[^\x20-\x7e\r]")
_ZERO, _NEWLINE = b"\x00", b"\n"


class Deframed(NamedTuple):
    """The frames that were found in bytes of a link.

    - `frames`: the frames in their order, without their checksums: a line as `str`, a packet as
        `bytes`.
    - `remainder`: the bytes of a frame that has not ended yet, at most `PACKET_BYTES` + 2.
    - `discarded`: the number of bytes that belonged to no valid frame.
    """

    frames: list[str | bytes]
    remainder: bytes
    discarded: int


def deframe(remainder: bytes, data: bytes) -> Deframed:
    """Finds the frames in a stream of bytes. They are the same however the stream is divided.

    **Arguments:**

    - `remainder`: the remainder that the previous call returned; `b""` at the start of a
      connection.
    - `data`: the bytes that have arrived since.

    **Returns:**

    The frames that are complete now, and the remainder for the next call.
    """
    buffer = remainder + data
    frames: list[str | bytes] = []
    discarded = start = 0
    while start < len(buffer):
        result = _packet(buffer, start) if buffer[start] == 0 else _line(buffer, start)
        if result is None:
            break
        frame, end, lost = result
        if frame is not None:
            frames.append(frame)
        discarded += lost
        start = end
    return Deframed(frames, buffer[start:], discarded)


def delines(remainder: bytes, data: bytes) -> tuple[list[str], bytes]:
    """Divides the bytes of a link that carries only lines, such as those of a host. Unlike
    `deframe` it does not wait for the end of a packet.

    **Returns:** the lines, and the remainder for the next call, at most `LINE_BYTES`.
    """
    *lines, remainder = (remainder + data).split(_NEWLINE)
    # A line begins only after the last byte that is not allowed in a line.
    ends = [_NO_TEXT.split(line)[-1][-LINE_BYTES:] for line in lines]
    result = [_line(end + _NEWLINE, 0) for end in ends]
    texts = [item[0] for item in result if item is not None]
    return [text for text in texts if isinstance(text, str)], remainder[-LINE_BYTES:]


def encode_line(text: str) -> bytes:
    """Encodes a line for sending.

    **Raises:** `ValueError` if the text is not printable ASCII or too long.
    """
    content = text.encode("ascii")
    if not _is_text(content) or len(content) + 10 > LINE_BYTES:
        raise ValueError(
            f"no line of at most {LINE_BYTES - 10} printable characters: {text[:40]!r}"
        )
    return b"%s*%08X\n" % (content, zlib.crc32(content))


def encode_packet(payload: bytes) -> bytes:
    """Encodes a packet for sending.

    **Raises:** `ValueError` if the first byte of the payload is 0, if its second byte is not 0, or
    if it is too long.
    """
    if len(payload) < 2 or payload[0] == 0 or payload[1] != 0:
        raise ValueError("a payload begins with a byte that is not 0 and a 0")
    encoded = cobs.encode(payload + zlib.crc32(payload).to_bytes(_CHECKSUM, "little"))
    if len(encoded) > PACKET_BYTES:
        raise ValueError(f"{len(encoded)} bytes; a packet has at most {PACKET_BYTES}")
    return _ZERO + encoded + _ZERO


# (Frame or None, the position at which the next frame starts, the number of bytes discarded); None
# if more bytes are needed.
#
# The result depends only on the bytes of the frame and not on the number of bytes that have arrived
# after it; otherwise the frames would depend on how the stream is divided.
_Found = tuple[str | bytes | None, int, int] | None


def _packet(buffer: bytes, start: int) -> _Found:
    """Reads from a zero: a packet if 02 follows, otherwise a delimiter that is skipped."""
    if start + 1 == len(buffer):
        return None
    if buffer[start + 1] != 2:
        return None, start + 1, 0
    first = start + 1
    end = buffer.find(_ZERO, first, first + PACKET_BYTES + 1)
    if end < 0:
        if len(buffer) <= first + PACKET_BYTES:
            return None
        # Only the two bytes that looked like a beginning are dropped: on a link of lines they were
        # noise, and the lines behind them are good.
        return None, start + 2, 2
    payload = _decoded(buffer[first:end])
    # The closing zero remains in the buffer, because it may open the next packet.
    return payload, end, 0 if payload is not None else end - start


def _decoded(encoded: bytes) -> bytes | None:
    try:
        content = cobs.decode(encoded)
    except cobs.DecodeError:
        return None
    payload, checksum = content[:-_CHECKSUM], content[-_CHECKSUM:]
    if len(payload) < 2 or zlib.crc32(payload) != int.from_bytes(checksum, "little"):
        return None
    return payload


def _line(buffer: bytes, start: int) -> _Found:
    """Reads from any other byte: text up to a newline, or garbage up to a zero."""
    limit = start + LINE_BYTES
    newline = buffer.find(_NEWLINE, start, limit)
    zero = buffer.find(_ZERO, start, limit if newline < 0 else newline)
    if zero >= 0:
        return None, zero, zero - start
    if newline < 0:
        return None if len(buffer) < limit else (None, limit, LINE_BYTES)
    content = buffer[start:newline].removesuffix(b"\r")
    if not content:
        return None, newline + 1, 0
    text, checksum = content[:-9], content[-9:]
    if not _is_text(text) or checksum != b"*%08X" % zlib.crc32(text):
        return None, newline + 1, newline + 1 - start
    return text.decode("ascii"), newline + 1, 0


def _is_text(content: bytes) -> bool:
    return content.isascii() and content.decode("ascii").isprintable() and bool(content)
