"""A device's clock: one wrong stamp makes nobody deaf, and a step is another start."""

from dataclasses import replace

import numpy as np
import pytest
from hand_clock import START

from jaxtwin.errors import LinkError
from jaxtwin.live import (
    Data,
    Event,
    Gap,
    Greeting,
    Hello,
    Image,
    LinkChange,
    LinkState,
    Reading,
    Sample,
    encode,
)
from jaxtwin.live.protocol._identity import Identity
from jaxtwin.live.protocol._link import Arrived
from jaxtwin.live.protocol._message_counts import AGREE, DeviceTime
from jaxtwin.live.protocol._receiver import Receiver
from jaxtwin.rig import Rig

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)


@pytest.fixture
def receiver(rig: Rig) -> Receiver:
    made = Receiver("link", Identity.of(rig))
    made.changed(LinkChange("link", START, LinkState.CONNECTING, ""))
    return made


def heard(receiver: Receiver, stamps: list[int], first: int = 0) -> list:
    """Samples ten times a second with these stamps, µs."""
    records: list = list(receiver.receive(Arrived("link", START, encode(HELLO))))
    for number, stamp in enumerate(stamps, first):
        data = encode(Data(number, stamp, (0, 0)))
        records += receiver.receive(Arrived("link", START + number * 10**8, data))
    return records


def of(records: list, kind: type) -> list:
    return [record for record in records if isinstance(record, kind)]


@pytest.mark.parametrize("far", [2**62, 3_600_000_000, 61_000_000])
def test_a_stamp_more_than_a_minute_ahead_is_the_only_message_that_is_lost(
    receiver: Receiver, far: int
) -> None:
    records = heard(receiver, [0, 100_000, far, 300_000, 400_000])
    assert [sample.seq for sample in of(records, Sample)] == [0, 1, 3, 4]
    assert [(gap.first, gap.count) for gap in of(records, Gap)] == [(2, 1)]
    (nonsense,) = [event for event in of(records, Event) if event.kind == "nonsense"]
    assert f"device time {far}" in nonsense.detail


def test_a_clock_that_has_stepped_is_another_start_of_the_device(receiver: Receiver) -> None:
    later = [3_600_000_000 + number * 100_000 for number in range(30)]
    records = heard(receiver, [0, 100_000, *later])
    greetings = of(records, Greeting)
    assert [greeting.hello.boot for greeting in greetings] == ["b1", "b1.1"]
    samples = of(records, Sample)
    assert [(s.boot, s.seq) for s in samples[:3]] == [("b1", 0), ("b1", 1), ("b1.1", AGREE + 1)]
    assert len(samples) == 2 + 30 - (AGREE - 1)
    assert [(gap.first, gap.count) for gap in of(records, Gap)] == [(2, AGREE - 1)]
    # It greets again, and is the same.
    assert receiver.receive(Arrived("link", START + 4 * 10**9, encode(HELLO))) == []


@pytest.mark.parametrize("ahead", [1_000_000, 50_000_000])
def test_a_stamp_less_than_a_minute_ahead_loses_at_most_nine_messages(
    receiver: Receiver, ahead: int
) -> None:
    """Believable by itself; what follows has gone back, and agrees that it is right."""
    stamps = [0, 100_000, ahead, *[number * 100_000 for number in range(3, 30)]]
    records = heard(receiver, stamps)
    seqs = [sample.seq for sample in of(records, Sample)]
    lost = min(AGREE - 1, ahead // 100_000 - 3)
    assert seqs == [0, 1, 2, *range(3 + lost, 30)]
    assert [(gap.first, gap.count) for gap in of(records, Gap)] == [(3, lost)]


def test_messages_of_another_stream_do_not_count_as_agreement_on_a_clock(
    receiver: Receiver,
) -> None:
    image = Image(0, 0, 0, np.full((60, 80), 30_000, np.uint16))
    records = heard(receiver, [0, 50_000_000])
    for number in range(2, 20):
        arrival = START + number * 10**8
        for message in (
            Data(number, number * 100_000, (0, 0)),
            replace(image, seq=number, device_us=number * 100_000),
        ):
            records += receiver.receive(Arrived("link", arrival, encode(message)))
    assert [sample.seq for sample in of(records, Sample)] == [0, 1, *range(1 + AGREE, 20)]
    assert [reading.seq for reading in of(records, Reading)] == list(range(2, 20))


def test_device_time_may_be_a_minute_ahead_of_the_host_and_a_hundredth_faster() -> None:
    time = DeviceTime(1.0)
    assert not time.check("data", 0, START, 0)
    assert not time.check("data", 59_000_000, START + 10**6, 0)
    assert not time.check("data", 1000_500_000, START + 1000 * 10**9, 0)
    with pytest.raises(LinkError, match="of which the host saw 1000 s"):
        time.check("data", 1100_000_000, START + 1000 * 10**9, 0)


def test_a_virtual_rig_runs_as_fast_as_it_says() -> None:
    time = DeviceTime(20.0)
    for second in range(100):
        assert not time.check("data", second * 20_000_000, START + second * 10**9, 0)


def test_why_a_line_was_nonsense_is_recorded_and_logged_once(
    receiver: Receiver, caplog: pytest.LogCaptureFixture
) -> None:
    heard(receiver, [])
    wrong = replace(Data(0, 0, (300, 0)))
    records = []
    for number in range(5):
        data = encode(replace(wrong, seq=number, device_us=number))
        records += receiver.receive(Arrived("link", START, data))
    details = {event.detail for event in of(records, Event) if event.kind == "nonsense"}
    assert details == {"1: expected counts from -255 to 255 of P1, got (300, 0)"}
    assert caplog.messages == ["link: expected counts from -255 to 255 of P1, got (300, 0)"]
