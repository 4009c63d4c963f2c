"""Clients are cursors in one ring: each frame comes once, in order, or is known to be lost."""

import json
import re

from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.serve import FrameRing


def numbers(frames: tuple[bytes, ...]) -> list[int]:
    return [int(re.match(rb"id: ring-(\d+)\n", frame)[1]) for frame in frames]  # pyright: ignore


@given(
    size=st.integers(1, 8),
    steps=st.lists(st.tuples(st.booleans(), st.integers(1, 12)), max_size=30),
)
def test_a_client_gets_every_frame_once_or_hears_how_many_it_has_lost(
    size: int, steps: list[tuple[bool, int]]
) -> None:
    """Whatever the pace of the rig and of the client, the frames and the lost ones add up."""
    ring, cursor, made, got = FrameRing(size, "ring"), 0, 0, 0
    for is_reading, count in steps:
        if not is_reading:
            for _ in range(count):
                made += 1
                assert ring.append("sample", made) == made
            continue
        batch = ring.after(cursor)
        found = numbers(batch.frames)
        assert found == list(range(cursor + batch.lost + 1, made + 1))
        assert len(found) <= size
        assert batch.cursor == made
        got += len(found) + batch.lost
        cursor = batch.cursor
        assert got == made


@given(
    size=st.integers(1, 8),
    kinds=st.lists(st.sampled_from("abc"), max_size=20),
    before=st.integers(-3, 25),
)
def test_the_id_of_a_frame_is_a_cursor_as_long_as_what_follows_it_is_there(
    size: int, kinds: list[str], before: int
) -> None:
    ring = FrameRing(size, "ring")
    for place, kind in enumerate(kinds):
        ring.append(kind, place)
    cursor = ring.cursor_of(f"ring-{before}")
    if cursor is None:
        assert before < max(len(kinds) - size, 0) or before > len(kinds)
    else:
        assert cursor == before
        assert ring.after(cursor).lost == 0


@given(text=st.text(max_size=40))
def test_what_is_no_id_of_this_server_is_no_cursor(text: str) -> None:
    ring = FrameRing(4, "ring")
    ring.append("sample", 1)
    if not re.fullmatch(r"ring-[01]", text):
        assert ring.cursor_of(text) is None
    assert ring.cursor_of("earlier-1") is None


def test_the_newest_of_each_kind_is_kept_when_the_ring_has_forgotten_it() -> None:
    ring = FrameRing(3, "ring")
    ring.append("layout", {"rig": "tclab"})
    for number in range(10):
        ring.append("sample", number)
    newest = ring.newest()
    assert numbers(newest.frames) == [1, 11]
    assert newest.cursor == 11
    assert ring.newest_of("layout") == {"rig": "tclab"}
    assert ring.newest_of("findings") is None


def test_a_frame_is_an_event_of_the_html_standard() -> None:
    """https://html.spec.whatwg.org/multipage/server-sent-events.html: fields, one a line, and an
    empty line; a line break within the data would end it."""
    ring = FrameRing(3, "ring")
    ring.append("log", {"text": "two\nlines \u2028 µ"})
    (frame,) = ring.after(0).frames
    event_id, event, data, *rest = frame.decode().split("\n")
    assert (event_id, event, rest) == ("id: ring-1", "event: log", ["", ""])
    assert json.loads(data.removeprefix("data: ")) == {"text": "two\nlines \u2028 µ"}
