"""Framing: the same frames whatever the chunking, nothing damaged accepted, nothing unbounded."""

import zlib
from itertools import pairwise

import hypothesis.strategies as st
import pytest
from hypothesis import given

from jaxtwin.live import deframe, encode_line, encode_packet
from jaxtwin.live.protocol._framing import LINE_BYTES, PACKET_BYTES, delines

LINES = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=60)
PACKETS = st.binary(max_size=600).map(lambda tail: b"\x01\x00" + tail)
FRAMES = st.lists(LINES | PACKETS, max_size=12)


def encoded(frame: str | bytes) -> bytes:
    return encode_line(frame) if isinstance(frame, str) else encode_packet(frame)


def deframed(stream: bytes, cuts: list[int]) -> tuple[list[str | bytes], int, bytes]:
    """All frames of a stream that comes in pieces."""
    places = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    frames: list[str | bytes] = []
    discarded, rest = 0, b""
    for begin, end in pairwise(places):
        found = deframe(rest, stream[begin:end])
        frames += found.frames
        discarded += found.discarded
        rest = found.remainder
    return frames, discarded, rest


def test_a_line_carries_the_crc_that_standards_give_for_its_text() -> None:
    # CRC-32/ISO-HDLC check value: https://reveng.sourceforge.io/crc-catalogue/all.htm
    assert encode_line("123456789") == b"123456789*CBF43926\n"
    assert zlib.crc32(b"123456789") == 0xCBF43926


def test_a_packet_begins_with_00_02_and_holds_no_other_zero() -> None:
    stream = encode_packet(b"\x01\x00" + bytes(500))
    assert stream[:2] == b"\x00\x02"
    assert stream[1:-1].count(0) == 0
    assert stream[-1] == 0


@given(FRAMES, st.lists(st.integers(0, 5000), max_size=20))
def test_what_was_sent_comes_out_however_the_stream_is_cut(
    frames: list[str | bytes], cuts: list[int]
) -> None:
    stream = b"".join(map(encoded, frames))
    found, discarded, _ = deframed(stream, cuts)
    assert found == frames
    assert discarded == 0


@given(
    st.binary(max_size=400)
    | st.lists(st.sampled_from(list(b"\x00\x02\n*A")), max_size=400).map(bytes),
    FRAMES,
    st.lists(st.integers(0, 5000), max_size=30),
)
def test_garbage_too_gives_the_same_frames_however_it_is_cut(
    garbage: bytes, frames: list[str | bytes], cuts: list[int]
) -> None:
    stream = garbage + b"".join(map(encoded, frames))
    assert deframed(stream, cuts) == deframed(stream, [])


@given(st.binary(max_size=300).filter(lambda data: b"\x00\x02" not in data), LINES, PACKETS)
def test_after_garbage_the_second_line_and_the_second_packet_are_found(
    garbage: bytes, line: str, packet: bytes
) -> None:
    stream = garbage + encode_line(line) * 2 + encode_packet(packet) * 2
    found = deframe(b"", stream).frames
    assert found[-3:] == [line, packet, packet]


@given(LINES | PACKETS, st.data())
def test_a_frame_with_changed_bytes_is_not_accepted(
    frame: str | bytes, data: st.DataObject
) -> None:
    stream = bytearray(encoded(frame))
    for _ in range(data.draw(st.integers(1, 4))):
        stream[data.draw(st.integers(0, len(stream) - 1))] ^= data.draw(st.integers(1, 255))
    # A changed delimiter may leave the content whole; never another content.
    assert set(deframe(b"", bytes(stream) + b"\n\x00").frames) <= {frame}


@given(st.lists(st.binary(max_size=9000), max_size=20))
def test_the_remainder_is_at_most_a_packet_long(chunks: list[bytes]) -> None:
    rest = b""
    for chunk in [b"\x00\x02", *chunks]:
        rest = deframe(rest, chunk.replace(b"\x00", b"\x01") * 8).remainder
        assert len(rest) <= PACKET_BYTES + 2


def test_a_line_without_end_is_discarded_and_the_next_one_found() -> None:
    found = deframe(b"", b"x" * 5 * LINE_BYTES + b"\n" + encode_line("beat t=1"))
    assert found.frames == ["beat t=1"]
    assert found.discarded == 5 * LINE_BYTES


@pytest.mark.parametrize(("ending", "most"), [(b"\n", 1014), (b"\r\n", 1013)])
def test_the_1024_bytes_of_a_line_include_checksum_and_ending(ending: bytes, most: int) -> None:
    for length, found in ((most, 1), (most + 1, 0)):
        content = b"x" * length
        line = b"%s*%08X%s" % (content, zlib.crc32(content), ending)
        assert len(deframe(b"", line).frames) == found
        assert len(delines(b"", line)[0]) == found


def test_lines_behind_a_false_beginning_of_a_packet_are_not_lost() -> None:
    line = encode_line("beat t=1")
    many = PACKET_BYTES // len(line) + 10
    assert len(deframe(b"", b"\x00\x02" + line * many).frames) >= many - 1


@pytest.mark.parametrize("text", ["", "a\nb", "tab\t", "é", "x" * LINE_BYTES])
def test_text_that_is_no_line_is_refused_on_sending(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 (an encoding error is one)
        encode_line(text)


@pytest.mark.parametrize(
    "payload", [b"", b"\x01", b"\x00\x00x", b"\x01\x01x", b"\x01\x00" * 40_000]
)
def test_a_payload_that_would_not_be_found_again_is_refused_on_sending(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"payload|packet"):
        encode_packet(payload)
