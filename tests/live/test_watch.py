"""The terminal view shows what was measured, what the twin says, and what was lost."""

import io

import numpy as np
from folded import feed
from hand_clock import START
from rich.console import Console

from jaxtwin.live import (
    Event,
    Gap,
    Greeting,
    Hello,
    LinkChange,
    LinkState,
    Reading,
    RigState,
    Sample,
)
from jaxtwin.live._screen import HEIGHT, WIDTH, Screen, _channel_map, _labels
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


def shown(screen: Screen) -> str:
    console = Console(file=io.StringIO(), width=80, force_terminal=False)
    with console.capture() as capture:
        console.print(screen.render())
    return capture.get()


def test_a_screen_shows_values_duty_links_and_losses_within_80_by_24(twin: Twin) -> None:
    screen = Screen(twin)
    assert "waiting for temperatures" in shown(screen)
    values = np.linspace(20.0, 48.0, 15)
    state = feed(
        screen,
        [
            LinkChange("link", START, LinkState.LIVE, ""),
            Greeting("link", START, Hello(2, "dual-cell", "b", cells=("P1", "P2"))),
            Sample("link", "b", START, 0, 0, (128, 255), 16.0),
            Reading("link", "b", START, 0, 0, values, False, None),
            Gap("link", START, "image", 1, 7),
            Event("link", START, "garbage", "12 bytes"),
            Event("link", START, "recalibration-start"),
        ],
        START,
        RigState(),
    )
    assert state.counts == {"lost": 7, "garbage": 1}
    text = shown(screen)
    for part in ("T11", "20.0", "48.0", "50 %, 100 %", "ambient 16.0", "link live", "7 lost"):
        assert part in text
    assert "1 garbage" in text
    assert "recalibration-start" in text
    assert max(map(len, text.splitlines())) <= 80
    assert len(text.splitlines()) <= 24


def test_duty_is_positive_where_it_heats() -> None:
    """Positive counts cool the mirror."""
    screen = Screen(Twin("dew-point-mirror"))
    counts = screen._rig.driver.counts
    feed(screen, [Sample("link", "b", START, 0, 0, (-counts // 2,), 20.0)], START, RigState())
    assert "duty 50 %" in shown(screen)
    feed(screen, [Sample("link", "b", START, 1, 0, (0,), 20.0)], START, RigState())
    assert "duty 0 %" in shown(screen)


def test_a_channel_that_has_failed_is_shown_as_failed(twin: Twin) -> None:
    screen = Screen(twin)
    values = np.full(15, 30.0)
    values[0] = np.nan
    feed(
        screen,
        [Reading("link", "b", START, 0, 0, values, False, None, {0: "open"})],
        START,
        RigState(),
    )
    text = shown(screen)
    assert "nan" in text
    assert "?" in text
    feed(
        screen,
        [Reading("link", "b", START, 0, 0, np.full(15, np.nan), False, None)],
        START,
        RigState(),
    )
    assert "all channels have failed" in shown(screen)


def test_the_twin_stands_beside_the_measurement(twin: Twin) -> None:
    screen = Screen(twin)
    feed(
        screen,
        [Reading("link", "b", START, 0, 0, np.full(15, 30.0), False, None)],
        START,
        RigState(),
    )
    row = next(line for line in shown(screen).splitlines() if "TBM" in line)
    words = row.split("TBM")[1].split()
    measured, predicted, difference = (float(word) for word in words)
    assert measured == 30.0
    assert difference == round(measured - predicted, 1)


def test_every_zone_of_the_map_belongs_to_its_channel(rig: Rig) -> None:
    found = _channel_map(rig.plate, rig.channels)
    assert found.shape == (HEIGHT, WIDTH)
    assert set(found.ravel()) == set(range(15))
    names = [channel.name for channel in rig.channels]
    assert names[found[0, 0]] == "T11"
    assert names[found[0, -1]] == "T16"
    assert names[found[-1, -1]] == "T26"
    # A tap lies upon the zones, in the middle of its third of the plate.
    assert names[found[HEIGHT // 2, WIDTH // 2]] == "TBM"


def test_the_name_of_a_channel_is_written_upon_its_own_place(rig: Rig) -> None:
    where = _channel_map(rig.plate, rig.channels)
    names = [channel.name for channel in rig.channels]
    written = dict.fromkeys(range(15), "")
    for place, letter in sorted(_labels(where, names).items()):
        written[where[place]] += letter
    # A tap is one or two characters wide.
    assert written == {n: name if written[n] else "" for n, name in enumerate(names)}
    assert [name for n, name in enumerate(names) if not written[n]] == ["TAM", "TBM", "TCM"]


def test_a_label_leaves_out_cells_of_another_channel() -> None:
    where = np.array([[0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])
    assert _labels(where, ["ab", "c"]) == {(0, 0): "a", (0, 1): "b", (1, 1): "c"}


def test_a_trip_the_owner_the_limits_and_the_age_of_temperatures_are_shown(twin: Twin) -> None:
    screen = Screen(twin)
    on = Sample("link", "b", START, 0, 0, (128, 255), 16.0, owner="lab", number=3)
    state = feed(
        screen,
        [on, Reading("link", "b", START, 0, 0, np.full(15, 20.0), False, None)],
        START,
        RigState(),
    )
    text = shown(screen)
    assert "commanded by lab" in text
    assert "off above 90 degC, inside a cell above 125, temperatures 0.0 s old" in text
    assert "TRIPPED" not in text
    later = START + 4 * 10**9
    off = Sample("link", "b", later, 4 * 10**6, 1, (0, 0), 16.0, trip="over-\x1b[2Jtemperature")
    closed = Reading(
        "link", "b", later, 4 * 10**6, 1, np.full(15, 20.0), True, None
    )  # is no reading
    feed(screen, [off, closed], later, state)
    text = shown(screen)
    assert "TRIPPED: over-�[2Jtemperature" in text
    assert "commanded by nobody" in text
    assert "temperatures 4.0 s old" in text
    assert len(text.splitlines()) <= 24
