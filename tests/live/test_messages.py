"""Messages: what is sent is what is read, and nothing else is a message."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis.extra import numpy as hnp

from jaxtwin import JaxtwinError
from jaxtwin.live import Ask, Beat, Data, Duty, Hello, Image, Notice, Order, deframe, encode, parse
from jaxtwin.live.protocol._identity import read_name, write_name

SEQ = st.integers(0, 2**32 - 1)
TIME = st.integers(0, 2**62)
COUNTS = st.lists(st.integers(-255, 255), max_size=8).map(tuple)
HUNDREDTHS = st.integers(-27315, 200000).map(lambda number: number / 100)
WORDS = st.text("ABCXYZabcxyz0189_.-", min_size=1, max_size=32)
NAMES = st.text("AZaz09_.- ,%*=~üµ°", min_size=1, max_size=12)
NUMBER = st.none() | SEQ
# Kinds of message and what they are made of. They are made in the test itself: checking their
# types draws random numbers, which hypothesis wants to be the only one to do while it draws.
MESSAGES = st.one_of(
    st.tuples(
        st.just(Data),
        st.tuples(
            SEQ,
            TIME,
            COUNTS,
            st.none() | HUNDREDTHS,
            st.lists(HUNDREDTHS, max_size=20).map(tuple),
            st.just({}),
            st.just("") | WORDS,
            NUMBER,
            st.just("") | WORDS,
        ),
    ),
    st.tuples(st.just(Notice), st.tuples(SEQ, TIME, WORDS, WORDS, NUMBER, WORDS)),
    st.tuples(st.just(Order), st.tuples(st.sampled_from(["stop", "reset"]), SEQ, WORDS)),
    st.tuples(st.just(Beat), st.tuples(TIME)),
    st.tuples(st.just(Duty), st.tuples(SEQ, COUNTS, WORDS)),
    st.just((Ask, (2,))),
    st.tuples(
        st.just(Hello),
        st.tuples(
            st.just(2),
            NAMES,
            WORDS,
            st.lists(NAMES, max_size=4, unique=True).map(tuple),
            st.lists(NAMES, max_size=8, unique=True).map(tuple),
            st.none() | st.just((80, 60)),
            st.integers(1, 2**31),
            st.sampled_from([None, 0.5, 2.0, 60.0]),
            st.sampled_from([0.001, 1.0, 60.0, 10_000.0]),
        ),
    ),
)


@given(MESSAGES)
def test_a_message_is_read_as_it_was_sent(made_of: tuple) -> None:
    kind, fields = made_of
    message = kind(*fields)
    (frame,) = deframe(b"", encode(message)).frames
    assert parse(frame) == message


@given(SEQ, TIME, st.integers(0, 255), hnp.arrays(np.uint16, (6, 8)))
def test_an_image_is_read_pixel_for_pixel(
    seq: int, device_us: int, flags: int, pixels: np.ndarray
) -> None:
    (frame,) = deframe(b"", encode(Image(seq, device_us, flags, pixels))).frames
    image = parse(frame)
    assert isinstance(image, Image)
    assert (image.seq, image.device_us, image.flags) == (seq, device_us, flags)
    np.testing.assert_array_equal(image.pixels, pixels)


def refusal(frame: str | bytes) -> str:
    """What is said against a frame; a message is a message, and then nothing."""
    try:
        parse(frame)
    except JaxtwinError as error:
        return str(error)
    return "no message: "


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=200))
@example("data seq=1 t=1 pwm=" + ",".join("1" * 100))
def test_any_line_is_a_message_or_a_clear_refusal(line: str) -> None:
    assert refusal(line).startswith("no message: ")


@given(st.binary(max_size=200))
def test_any_packet_is_a_message_or_a_clear_refusal(payload: bytes) -> None:
    assert refusal(payload).startswith("no message: ")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("data seq=1", "'t' is missing"),
        ("duty n=1 pwm=1,2", "'owner' is missing"),
        ("data seq=1 t=1_0", "a whole number"),  # int() would take it
        ("data seq=+1 t=1", "a whole number"),
        ("data seq=4294967296 t=1", "a whole number from 0 to 4294967295"),
        ("data seq=007 t=1", "a whole number"),  # eight to a reader that takes it for octal
        ("duty n=1 owner=a pwm=-0", "a whole number"),
        ("data seq=1 t=1 ambient=07.5", "expected a number"),
        ("data seq=1 t=1 temp=-nan", "expected a number"),
        ("data seq=1 t=1 temp=inf", "expected a number"),
        ("hello version=2 colour=blue", "unknown key 'colour'"),
        ("hello version=2 rig=a boot=b colour=blue", "unknown key 'colour'"),
        ("data seq=1 t=1 t=2", "each key once"),
        ("data seq=1 t=1 colour=red", "unknown key 'colour'"),
        ("data seq=1 t=1 temp=!", "expected 1 to 32"),
        ("data seq=1 t=1 temp=1e3", "expected a number"),
        ("data seq=1 t=1 temp=-300.0", "-273.15 to 2000"),
        ("data seq=1 t=1 pwm=" + ",".join(["1"] * 65), "at most 64 entries, got 65"),
        ("hello version=2 rig=a boot=b cells=P1,P1", "each once"),
        ("hello version=2 rig=a/b boot=b", "1 to 32 characters"),
        ("hello version=2 rig=%5A boot=b", "1 to 32 characters"),  # Z is not quoted
        ("hello version=2 rig=a boot=b camera=0x60", "1 to 4096"),
        ("reboot now=1", "unknown message 'reboot'"),
        ("beat  t=1", "expected key=value"),
    ],
)
def test_a_wrong_line_is_refused_with_what_is_wrong(line: str, reason: str) -> None:
    with pytest.raises(JaxtwinError, match=reason):
        parse(line)


def test_nan_and_minus_zero_are_read_as_c_prints_them() -> None:
    data = parse("data seq=1 t=1 ambient=-0.00 temp=nan,-0.0,0.5")
    assert isinstance(data, Data)
    assert data.faults == {0: "nan"}
    assert (data.ambient, *data.temperatures[1:]) == (0.0, 0.0, 0.5)


def test_a_greeting_of_a_later_version_is_read_as_far_as_its_version() -> None:
    hello = parse("hello version=3 rig=dual-cell something=new")
    assert hello == Hello(3, "dual-cell", "")


def test_a_channel_that_has_failed_does_not_take_the_line_with_it() -> None:
    data = parse("data seq=1 t=1 temp=20.5,!open,nan")
    assert isinstance(data, Data)
    assert data.temperatures[0] == 20.5
    assert np.isnan(data.temperatures[1:]).all()
    assert data.faults == {1: "open", 2: "nan"}
    assert encode(data).startswith(b"data seq=1 t=1 temp=20.500,!open,!nan*")


@given(NAMES)
@example("Zone 1")
@example("Tü")
@example("a,b=c*%41~")
def test_any_name_is_read_as_it_was_written(name: str) -> None:
    assert read_name(write_name(name)) == name
