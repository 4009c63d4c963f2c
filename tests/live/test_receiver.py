"""The receiver: each message once, gaps as records, nothing before a fitting greeting."""

from dataclasses import replace

import numpy as np
import pytest
from hand_clock import START

from jaxtwin.live import (
    Ask,
    Data,
    Event,
    Gap,
    Greeting,
    Hello,
    Image,
    LinkChange,
    LinkState,
    Notice,
    Reading,
    Sample,
    encode,
)
from jaxtwin.live.protocol import _receiver
from jaxtwin.live.protocol._identity import Identity
from jaxtwin.live.protocol._link import Arrived
from jaxtwin.live.protocol._messages import Message
from jaxtwin.live.protocol._receiver import MAX_GARBAGE, Receiver
from jaxtwin.rig import Rig, load_rig

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)


def data(seq: int, **fields: object) -> Data:
    return replace(Data(seq, 1000 * seq, (0, 0)), **fields)  # pyright: ignore[reportArgumentType]


def image(seq: int, flags: int = 0, kelvin: float = 300.0) -> Image:
    return Image(seq, 1000 * seq, flags, np.full((60, 80), round(100 * kelvin), np.uint16))


@pytest.fixture
def receiver(rig: Rig) -> Receiver:
    made = Receiver("link", Identity.of(rig))
    made.changed(LinkChange("link", START, LinkState.CONNECTING, ""))
    return made


def heard(receiver: Receiver, *messages: Message | bytes, at: float = 0.0) -> list[object]:
    stream = b"".join(m if isinstance(m, bytes) else encode(m) for m in messages)
    return list(receiver.receive(Arrived("link", START + round(at * 1e9), stream)))


def of(records: list[object], kind: type) -> list:
    return [record for record in records if isinstance(record, kind)]


def test_a_sample_without_new_temperatures_is_no_reading() -> None:
    """A slow sensor need not repeat its last value, which would look frozen."""
    rig = load_rig("printer-bed")
    names = tuple(channel.name for channel in rig.channels)
    cells = rig.driven
    made = Receiver("link", Identity.of(rig))
    made.changed(LinkChange("link", START, LinkState.CONNECTING, ""))
    heard(made, Hello(2, rig.name, "b1", cells, names, watchdog=2.0, heaters=cells))
    off, warm = (0,) * len(cells), (20.0,) * len(names)
    records = heard(made, data(0, pwm=off, temperatures=warm), data(1, pwm=off))
    assert [record.seq for record in of(records, Sample)] == [0, 1]
    assert [record.seq for record in of(records, Reading)] == [0]
    wrong = heard(made, data(2, pwm=off, temperatures=(*warm, 1.0)))
    assert "nonsense" in [event.kind for event in of(wrong, Event)]


def test_nothing_counts_before_the_greeting(receiver: Receiver) -> None:
    assert heard(receiver, data(0), image(0)) == []
    assert receiver.state is LinkState.CONNECTING
    records = heard(receiver, HELLO, data(1))
    assert [type(record) for record in records] == [Greeting, LinkChange, Sample]
    assert receiver.state is LinkState.LIVE


def test_missing_numbers_become_one_gap_before_the_message_that_shows_it(
    receiver: Receiver,
) -> None:
    records = heard(receiver, HELLO, data(5), data(9), data(10))
    assert of(records, Gap) == [Gap("link", START, "data", 6, 3)]
    assert [record.seq for record in of(records, Sample)] == [5, 9, 10]


def test_streams_are_counted_separately(receiver: Receiver) -> None:
    records = heard(
        receiver, HELLO, data(5), image(90), Notice(2, 0, "watchdog"), data(6), image(91)
    )
    assert of(records, Gap) == []


def test_a_message_that_comes_twice_is_recorded_once_also_after_a_lost_connection(
    receiver: Receiver,
) -> None:
    heard(receiver, HELLO, data(1), data(2))
    receiver.changed(LinkChange("link", START, LinkState.DOWN, "gone"))
    receiver.changed(LinkChange("link", START, LinkState.CONNECTING, ""))
    records = heard(receiver, HELLO, data(1), data(2), data(3))
    assert [record.seq for record in of(records, Sample)] == [3]
    assert of(records, Event) == [Event("link", START, "duplicate", "2")]


def test_numbers_wrap_around_at_2_to_the_32(receiver: Receiver) -> None:
    # At 1000 lines a second that is after 49 days.
    last = 2**32 - 1
    records = heard(
        receiver, HELLO, data(last, device_us=1), data(0, device_us=2), data(2, device_us=3)
    )
    assert of(records, Gap) == [Gap("link", START, "data", 1, 1)]
    assert len(of(records, Sample)) == 3


def test_a_restarted_device_counts_from_anew(receiver: Receiver) -> None:
    heard(receiver, HELLO, data(100))
    records = heard(receiver, replace(HELLO, boot="b2"), data(0), data(1))
    assert [type(record) for record in records] == [Greeting, Sample, Sample]


def test_device_time_that_runs_backwards_is_nonsense(receiver: Receiver) -> None:
    records = heard(receiver, HELLO, data(1, device_us=5000), data(2, device_us=4000))
    assert [record.seq for record in of(records, Sample)] == [1]
    assert "nonsense" in {event.kind for event in of(records, Event)}


@pytest.mark.parametrize(
    ("hello", "reason"),
    [
        (replace(HELLO, version=3), "got 3"),
        (
            replace(HELLO, rig="single-cell"),
            "rig: expected dual-cell as in the rig file, got single-cell",
        ),
        (replace(HELLO, cells=("P1",)), "cells"),
        (replace(HELLO, camera=(160, 120)), "camera"),
        (replace(HELLO, channels=("T11",)), "channels"),
        (replace(HELLO, counts=1023), "counts: expected 255 as in the rig file, got 1023"),
        (replace(HELLO, watchdog=60.0), "expected 0.1 to 5 s of a device that drives, got 60 s"),
        (replace(HELLO, watchdog=None), "expected 0.1 to 5 s of a device that drives, got none"),
        (replace(HELLO, watchdog=0.0), "got 0 s"),
        (replace(HELLO, rate=0.001), "expected 0.1 to 1000 s of the device's time in a second"),
        (replace(HELLO, rate=10_000.0), "got 10000"),
    ],
)
def test_another_rig_is_refused(receiver: Receiver, hello: Hello, reason: str) -> None:
    records = heard(receiver, hello, data(1))
    assert of(records, Sample) == []
    assert receiver.verdict is not None
    assert reason in receiver.verdict


@pytest.mark.parametrize(
    "message",
    [
        data(1, pwm=(1,)),
        data(1, pwm=(256, 0)),
        data(1, temperatures=(20.0,)),
        Image(1, 1, 0, np.zeros((60, 81), np.uint16)),
        Ask(2),
    ],
)
def test_a_message_that_does_not_fit_the_greeting_is_not_accepted(
    receiver: Receiver, message: Message
) -> None:
    # A device does not ask either: an echo of ours is no sign of life.
    records = heard(receiver, HELLO, message)
    assert of(records, Sample) == of(records, Reading) == []
    assert "nonsense" in {event.kind for event in of(records, Event)}


def test_a_uniform_image_reads_its_temperature_in_every_channel(receiver: Receiver) -> None:
    (reading,) = of(heard(receiver, HELLO, image(0, kelvin=300.0)), Reading)
    np.testing.assert_allclose(reading.temperatures, 26.85, atol=1e-9)


def test_recalibrations_are_marked_at_their_begin_and_end(receiver: Receiver) -> None:
    records = heard(receiver, HELLO, image(0), image(1, 1), image(2, 1), image(3))
    kinds = [(event.kind, event.device_us) for event in of(records, Event)]
    assert kinds == [("recalibration-start", 1000), ("recalibration-end", 3000)]
    assert [reading.recalibrating for reading in of(records, Reading)] == [False, True, True, False]


def test_silence_makes_a_link_stale_and_then_not_worth_waiting_for(receiver: Receiver) -> None:
    heard(receiver, HELLO, data(1))
    assert receiver.on_time(START + round(1.9e9)) == []
    (change,) = receiver.on_time(START + round(2.1e9))
    assert isinstance(change, LinkChange)
    assert change.state is LinkState.STALE
    assert receiver.verdict is None
    receiver.on_time(START + round(6.1e9))
    assert receiver.verdict == "silent for 6.1 s"


def test_a_peer_that_speaks_nonsense_is_given_up(receiver: Receiver) -> None:
    for _ in range(4):
        assert receiver.verdict is None
        heard(receiver, b"G" * (MAX_GARBAGE // 3))
    assert receiver.verdict is not None
    assert "without a valid message" in receiver.verdict


def test_a_peer_that_floods_is_given_up(
    receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _receiver.MAX_MESSAGES == 20_000
    monkeypatch.setattr(_receiver, "MAX_MESSAGES", 50)
    heard(receiver, HELLO, *[data(seq) for seq in range(49)], at=0.9)
    heard(receiver, *[data(seq) for seq in range(49, 98)], at=1.1)
    assert receiver.verdict is None
    heard(receiver, data(98), data(99), at=1.2)
    assert receiver.verdict == "more than 50 messages in a second"
