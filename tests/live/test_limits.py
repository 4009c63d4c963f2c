"""Limits of lines, images and links: the last value that is allowed, and the next one."""

import pytest
from limits import Limit, check_limit

from jaxtwin import load_rig
from jaxtwin.live import TcpServer, encode_line, opener, parse
from jaxtwin.live.protocol._identity import read_integer, read_name, read_number, read_word, split
from jaxtwin.physics import Faults

TCLAB = load_rig("tclab")


def image(device_us: int = 2**62, width: int = 1, pixels: int = 1) -> object:
    header = b"\x01\x00" + (0).to_bytes(2, "little") + (7).to_bytes(4, "little")
    header += device_us.to_bytes(8, "little")
    return parse(header + width.to_bytes(2, "little") + b"\x01\x00" + b"\x00\x01" * pixels)


def listen(address: str) -> None:
    TcpServer(address).close()


LIMITS: list[Limit] = [
    (Faults.parse, {"text": "drop=0.999"}, {"text": "drop=1"}),
    (Faults.parse, {"text": "corrupt=0"}, {"text": "corrupt=-0.001"}),
    (Faults.parse, {"text": "jumps=0.001"}, {"text": "jumps=0"}),
    (Faults.parse, {"text": "disconnect=999999999"}, {"text": "disconnect=1000000000"}),
    (read_integer, {"text": "7", "least": 0, "most": 7}, {"text": "8", "least": 0, "most": 7}),
    (read_integer, {"text": "-2", "least": -2, "most": 7}, {"text": "-3", "least": -2, "most": 7}),
    (read_number, {"text": "-273.15"}, {"text": "-273.16"}),
    (read_number, {"text": "2000"}, {"text": "2000.1"}),
    (read_word, {"text": "x" * 32}, {"text": "x" * 33}),
    (read_name, {"text": "x" * 32}, {"text": "x" * 33}),
    (split, {"text": "," * 63}, {"text": "," * 64}),
    (image, {}, {"device_us": 2**62 + 1}),
    (image, {"width": 2, "pixels": 2}, {"width": 2, "pixels": 1}),
    (image, {"pixels": 1}, {"width": 0, "pixels": 0}),
    (listen, {"address": "127.0.0.1:0"}, {"address": "127.0.0.1:65536"}),
    (listen, {"address": ":0"}, {"address": ":-1"}),
    (
        opener,
        {"url": "socket://rig:7000", "rig": TCLAB},
        {"url": "socket://rig", "rig": TCLAB},
    ),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)


def test_a_line_has_1024_bytes_at_most():
    """docs/protocol.md: a star, eight digits and the end of the line among them."""
    assert len(encode_line("x" * 1014)) == 1024
    with pytest.raises(ValueError, match="1014 printable characters"):
        encode_line("x" * 1015)
