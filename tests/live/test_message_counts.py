"""Numbers of messages over many starts of a device."""

from jaxtwin.live.protocol._message_counts import BOOTS, Counted, Counters, MessageCounts


def test_a_device_start_that_greets_again_goes_on_counting():
    """The oldest of all starts in a recording is the one that its appending begins with."""
    earlier: Counters = {f"b{k}": {"data": Counted(20, 2_000_000)} for k in range(BOOTS + 1)}
    counts = MessageCounts(earlier)
    assert counts.begin("b0", 1.0) == "b0"
    place = counts.place("b0", "data", 60, 6_000_000, 10**18)
    assert place is not None
    assert (place.first, place.missing) == (20, 40)


def test_the_starts_that_greeted_last_are_kept():
    counts = MessageCounts()
    for boot in (*(f"b{k}" for k in range(BOOTS)), "b0", "new"):
        counts.begin(boot, 1.0)
    assert counts.place("b0", "data", 0, 1, 10**18) is not None
