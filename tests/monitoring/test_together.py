"""What begins in most channels at once is one finding, and the rest stays as it is."""

from jaxtwin.live.safety._interlock import Finding
from jaxtwin.monitoring._finding_log import events, together

CHANNELS = [f"T{number}" for number in range(1, 16)]


def sudden(channel: str, since: float, size: float = 1.0, until: float | None = None) -> Finding:
    text = f"{channel} is {size:.2g} K above what is expected"
    return Finding("sudden", text, channel, since, size=size, found=since + 2, until=until)


def test_a_jump_of_all_channels_is_one_finding():
    several = [sudden(name, 450.0 + n / 5, 1 + n / 10) for n, name in enumerate(CHANNELS)]
    (one,) = together(several, CHANNELS)
    assert one.detail == "T15 and 14 others: T15 is 2.4 K above what is expected"
    assert (one.since, one.found, one.until) == (450.0, 452.0, None)
    over = [sudden(name, 450.0, until=500.0 + n) for n, name in enumerate(CHANNELS)]
    assert together(over, CHANNELS)[0].until == 514.0


def test_one_channel_a_few_or_one_after_the_other_stay_as_they_are():
    for several in (
        [sudden("T1", 450.0)],
        [sudden(name, 450.0) for name in CHANNELS[:7]],
        [sudden(name, 450.0 + 11 * n) for n, name in enumerate(CHANNELS)],
        [sudden("T1", 450.0), sudden("T2", 450.0)],
    ):
        names = CHANNELS[:2] if len(several) == 2 else CHANNELS
        assert together(several, names) == several


def test_another_kind_at_the_same_time_is_another_finding():
    room = Finding("implausible", "the room is 2 K off", "room", 450.0, size=2.0, found=451.0)
    found = together([*(sudden(name, 450.0) for name in CHANNELS), room], CHANNELS)
    assert [one.kind for one in found] == ["sudden", "implausible"]
    assert found[1] is room


def test_findings_that_overlap_are_one_event_told_by_the_most_telling():
    loose = [
        Finding("sudden", "T2", "T2", 480, size=-7.9, unit="K", until=873),
        Finding("sudden", "all", "", 480, size=9.0, unit="K", until=600),
        Finding("implausible", "H2", "H2", 485, size=20.0, unit="W", until=700),
    ]
    later = Finding("frozen", "T1", "T1", 1000, until=None)
    grouped = events([*loose, later])
    assert [[one.detail for one in group] for group in grouped] == [["T2", "H2", "all"], ["T1"]]


def test_an_event_without_an_end_holds_all_that_follow():
    first, second = sudden("T1", 10.0, until=None), sudden("T2", 500.0, until=600.0)
    assert [len(group) for group in events([first, second])] == [2]
    assert events([]) == []
