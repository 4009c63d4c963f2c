"""Interlocks: records, commands and time in, the reason to stop out."""

import re
from collections.abc import Callable, Sequence
from dataclasses import astuple, replace
from typing import final

import jax
import numpy as np
import pytest
from folded import Watched, feed
from hand_clock import START

from jaxtwin.errors import JaxtwinError
from jaxtwin.live import (
    AbstractInterlock,
    Command,
    Event,
    Finding,
    Greeting,
    Guard,
    Hello,
    LinkChange,
    LinkState,
    OperatingLimits,
    Plant,
    Reading,
    Record,
    RigState,
    Sample,
    interlocks_of,
)
from jaxtwin.live.safety._duty_response import MEMORY_SECONDS
from jaxtwin.live.safety._obedience import Obedience
from jaxtwin.live.safety._plausibility import Plausibility
from jaxtwin.live.safety._presence import Presence
from jaxtwin.live.safety._twin_watch import TwinWatch
from jaxtwin.physics import FAULT_MODELS, Twin
from jaxtwin.rig import Rig, load_rig

LIMITS = OperatingLimits(
    hottest=90.0,
    lowest=-50.0,
    cell=125.0,
    rate=2.0,
    jump=4.6,
    frozen=10.0,
    deviation=10.0,
    command_delay=1.0,
    room=16.0,
)
ON = (128, 128)


def at(seconds: float) -> int:
    return START + round(seconds * 1e9)


def reading(seconds: float, *values: float, recalibrating: bool = False) -> Reading:
    us = round(seconds * 1e6)
    return Reading("l", "b", at(seconds), us, 0, np.array(values), recalibrating, None)


def sample(seconds: float, pwm: tuple[int, int] = ON, **state: object) -> Sample:
    known = {"owner": "me", "number": 1, **state}
    us = round(seconds * 1e6)
    return Sample("l", "b", at(seconds), us, 0, pwm, None, **known)  # pyright: ignore


def plausible(*records: Record) -> Finding | None:
    """The first trip that these records cause."""
    lock = Watched(Plausibility(("T11", "T12"), LIMITS, load_rig("dual-cell").driver))
    return next(filter(None, map(lock.on_record, records)), None)


@pytest.mark.parametrize(
    ("values", "kind", "words"),
    [
        ((20.0, 89.9), None, ""),
        ((20.0, 90.1), "over-temperature", "T12 is at 90.1 degC; the rig's limit is 90"),
        ((-273.15, 20.0), "implausible", "T11 reads -273.1 degC; nothing here can be below -50"),
        ((20.0, float("nan")), "channel-fault", "T12 has failed: no number"),
    ],
)
def test_a_reading_that_is_too_hot_impossible_or_no_number_trips(
    values: tuple[float, float], kind: str | None, words: str
) -> None:
    trip = plausible(reading(1, *values))
    assert (trip and trip.kind, trip.detail if trip else "") == (kind, words)


@pytest.mark.parametrize(
    ("ambient", "kind"),
    [(None, None), (-13.0, None), (45.0, None), (-273.15, "implausible"), (85.0, "implausible")],
)
def test_an_impossible_ambient_temperature_trips(ambient: float | None, kind: str | None) -> None:
    trip = plausible(replace(sample(1), ambient=ambient))
    assert (trip and trip.kind) == kind


def test_a_channel_that_says_why_it_has_failed_is_quoted() -> None:
    failed = replace(reading(1, 20.0, float("nan")), faults={1: "open"})
    trip = plausible(failed)
    assert trip is not None
    assert trip.detail == "T12 has failed: open"


@pytest.mark.parametrize(
    ("per_second", "kind"), [(1.5, None), (-1.5, None), (10.0, "rate"), (-10.0, "rate")]
)
def test_a_reading_that_changes_faster_than_the_rig_can_trips(
    per_second: float, kind: str | None
) -> None:
    trip = plausible(*(reading(n / 9, 20.0, 20.0 + per_second * n / 9) for n in range(40)))
    assert (trip and trip.kind) == kind


def test_a_jump_of_2_kelvin_by_a_recalibration_does_not_trip() -> None:
    jumped = [reading(n / 9, *(20.0 + 2.0 * (n > 20),) * 2) for n in range(40)]
    assert plausible(*jumped) is None


def stood_still(pwm: Callable[[int], tuple[int, int]]) -> int | None:
    """The time at which a reading that never changes trips, s; `pwm` are the counts at a time."""
    lock = Watched(Plausibility(("T11", "T12"), LIMITS, load_rig("dual-cell").driver))
    for n in range(100):
        trip = lock.on_record(sample(n, pwm(n))) or lock.on_record(reading(n, 20.0 + n / 100, 25.0))
        if trip is not None:
            assert trip.kind == "frozen"
            return n
    return None


@pytest.mark.parametrize(
    ("pwm", "after"),
    [
        (lambda n: (0, 0), None),
        (lambda n: (255, 0), 11),
        (lambda n: (0, -128), 20),
        (lambda n: (255 * (n % 2), 0), 22),  # on every other second
    ],
)
def test_a_reading_is_frozen_after_the_heat_of_ten_seconds_at_full_duty(
    pwm: Callable[[int], tuple[int, int]], after: int | None
) -> None:
    assert stood_still(pwm) == after


def command(seconds: float, number: int = 1, pwm: tuple[int, int] = ON) -> Command:
    return Command("l", at(seconds), number, pwm, "me")


def commanded() -> Watched:
    """The interlock of a rig that has been heard of and commanded at 0 s."""
    greeting = Greeting("l", at(0), Hello(2, "r", "b"))
    return Watched(Presence(3.0), greeting, sample(0), reading(0, 20.0), command(0))


def test_frames_of_a_recalibration_count_as_silence() -> None:
    lock = commanded()
    for second in range(1, 5):
        assert lock.on_record(sample(second)) is None
        assert lock.on_record(reading(second, 20.0, 20.0, recalibrating=True)) is None
        trip = lock.on_time(at(second))
        assert (trip and trip.detail) == (
            None if second <= 3 else "no temperature for 4.0 s: the camera recalibrates itself"
        )


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (LinkChange("l", at(1), LinkState.DOWN, "gone"), "link-down"),
        (LinkChange("l", at(1), LinkState.STALE, "silent"), None),
        (Greeting("l", at(1), Hello(2, "r", "b2")), "restart"),
        (Greeting("l", at(1), Hello(2, "r", "b")), None),
    ],
)
def test_a_lost_link_and_a_restart_trip(record: Record, kind: str | None) -> None:
    lock = commanded()
    trip = lock.on_record(record)
    assert (trip and trip.kind) == kind


def test_silence_of_either_kind_trips() -> None:
    for heard, missing in ((sample(3), "temperature"), (reading(3, 20.0), "controller sample")):
        lock = commanded()
        lock.on_record(heard)
        trip = lock.on_time(at(3.5))
        assert trip == Finding("silence", f"no {missing} for 3.5 s")


def test_samples_of_a_device_without_cells_do_not_hide_a_silent_controller() -> None:
    watch = commanded()
    for second in range(1, 5):
        watch.on_record(reading(second, 20.0))
        watch.on_record(sample(second, ()))  # pyright: ignore[reportArgumentType]
    assert watch.on_time(at(3)) is None
    assert watch.on_time(at(4)) == Finding("silence", "no controller sample for 4.0 s")


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (sample(5.0), None),
        (sample(5.0, (127, 129)), None),
        (sample(5.0, (255, 128)), "disobedience"),
        (sample(5.0, (0, 0)), "disobedience"),
        (sample(5.0, number=None), "unacknowledged"),
        (sample(5.0, owner="somebody"), "commander"),
        (sample(5.0, (0, 0), trip="watchdog"), "device-trip"),
        # Within a second of the command the driver may still be on its way.
        (sample(0.5, (0, 0), number=None, owner=""), None),
        (sample(0.5, (60, 60)), None),
        (sample(0.5, (200, 60)), "disobedience"),
    ],
)
def test_what_a_device_reports_is_what_was_commanded(record: Sample, kind: str | None) -> None:
    lock = Watched(Obedience(("P1", "P2"), 1.0), command(0.1))
    trip = lock.on_record(record)
    assert (trip and trip.kind) == kind


@pytest.mark.parametrize("last", [7, 2**31 + 7, 2**32 - 1, 0])
def test_a_number_that_was_never_sent_acknowledges_nothing(last: int) -> None:
    """Numbers count modulo 2^32: half of all lie ahead of the last command, half behind it."""
    before = command(0, (last - 1) % 2**32)
    lock = Watched(Obedience(("P1", "P2"), 1.0), before, command(0.25, last))
    for behind in (0, 1):
        assert lock.on_record(sample(1.1, number=(last - behind) % 2**32)) is None
    for ahead in (1, 2, 1000, 2**31 - 1):
        trip = lock.on_record(sample(1.1, number=(last + ahead) % 2**32))
        assert trip is not None
        assert trip.kind == "disobedience"
        assert f"the last one sent was {last}" in trip.detail


def test_a_change_of_duty_is_obeyed_within_the_delay_of_one_second() -> None:
    lock = Watched(Obedience(("P1", "P2"), 1.0))
    for number in range(24):  # a quarter of a second each; off from 5 s on
        lock.on_record(command(number / 4, number, ON if number < 20 else (0, 0)))
        lock.on_time(at(number / 4))
    assert lock.on_record(sample(5.9, (60, 0), number=19)) is None
    trip = lock.on_record(sample(6.1, (60, 0), number=22))
    assert trip == Finding("disobedience", "P1 gets 60 counts; 0 were commanded", "P1")


def heated(twin: Twin, seconds: int, measured: float | None, limits: OperatingLimits) -> Finding:
    """The first trip of a rig that gets full duty, its readings those of the twin or as given."""
    lock, live = Watched(TwinWatch(twin, limits)), Plant(twin)
    live.start(0.0, live.ambient)
    off = np.zeros(2)
    for second in range(seconds):
        values = live.temperatures if measured is None else np.full(15, measured)
        trip = lock.on_record(reading(second, *values)) or lock.on_record(
            Sample("l", "b", at(second), second * 10**6, 0, (255, 255), live.ambient)
        )
        if trip is not None:
            return trip
        live.drive(off + 1)
        live.advance(second + 1.0)
    return Finding("", "")


@pytest.mark.slow
def test_the_twin_guards_the_cells_that_no_sensor_sees(twin: Twin) -> None:
    # The plate stays below 73 degC; the cells reach 106.
    limits = replace(LIMITS, cell=80.0)
    trip = heated(twin, 600, None, limits)
    assert trip.kind == "cell-temperature"
    assert "is at 80 degC inside, says the twin; its limit is 80" in trip.detail


@final
class Plate:
    """A rig in a room, with full duty on both cells; its readings may be those of a bench.

    - `room`, `start`: temperatures of the room and of the plate at the start, degC. Cells and sinks
      start at the temperature of the room.
    - `detached`: the channels whose sensors lie on the bench.
    """

    def __init__(self, twin: Twin, room: float, start: float, detached: Sequence[int] = ()):
        self._live, self._room, self._detached = Plant(twin), room, list(detached)
        nodes = np.full(len(self._live.nodes), room)
        nodes[: twin.wiring.elements] = start
        self._live.start(0.0, nodes, room)
        self._random = np.random.default_rng(1)

    def trip(
        self, watch: TwinWatch, seconds: int, *, measured: bool
    ) -> tuple[Finding | None, float, float]:
        """The trip, and how far the duty has then warmed the plate under the detached sensors, says
        the twin, K; and the hottest zone of the plate, degC."""
        ambient, lock = self._room if measured else None, Watched(watch)
        for second in range(seconds):
            values = self._live.temperatures.copy()
            values[self._detached] = self._room
            values += self._random.normal(0, 0.1, len(values))
            counts = (255, 255) if second else (0, 0)
            trip = lock.on_record(Sample("l", "b", at(second), second * 10**6, 0, counts, ambient))
            trip = trip or lock.on_record(reading(second, *values))
            if trip is None and second == 0:
                trip = lock.before_start()
            if trip is not None:
                warmed = watch._response.by_duty[self._detached] if second else np.zeros(1)
                return trip, float(warmed.max(initial=0.0)), float(self._live.temperatures.max())
            self._live.drive(np.ones(2))
            self._live.advance(second + 1.0)
        return None, 0.0, 0.0


@pytest.mark.slow
@pytest.mark.parametrize("room", [5.0, 16.0, 25.0, 40.0])
@pytest.mark.parametrize("warm", [0.0, 20.0])
@pytest.mark.parametrize("detached", [range(15), [3]])
def test_a_detached_sensor_hides_20_kelvin_in_a_measured_room(
    twin: Twin, room: float, warm: float, detached: Sequence[int]
) -> None:
    """Six standard deviations of what is not known (`DEVIATIONS`), in every room and warm or not;
    the sensors lie on the bench."""
    plate = Plate(twin, room, room + warm, detached)
    trip, warmed, _ = plate.trip(TwinWatch(twin, LIMITS), 120, measured=True)
    assert trip is not None
    assert trip.kind in ("unresponsive", "deviation")
    assert warmed < 20


@pytest.mark.slow
@pytest.mark.parametrize("room", [5.0, 7.0, 16.0, 25.0, 40.0])
@pytest.mark.parametrize("detached", [range(15), [3]])
def test_a_detached_sensor_hides_28_kelvin_in_a_room_that_nobody_measures(
    twin: Twin, room: float, detached: Sequence[int]
) -> None:
    """The rig file says 16 degC. From more than 10 K away it asks for the ambient temperature."""
    plate = Plate(twin, room, room, detached)
    trip, warmed, hottest = plate.trip(TwinWatch(twin, LIMITS), 120, measured=False)
    assert trip is not None
    stranger = abs(room - 16) > 10
    assert trip.kind in (("ambient-unknown",) if stranger else ("unresponsive", "deviation"))
    assert warmed < 28
    assert hottest < 55
    given = Plate(twin, room, room, detached)
    trip, warmed, _ = given.trip(TwinWatch(twin, LIMITS, room), 120, measured=False)
    assert trip is not None
    assert trip.kind in ("unresponsive", "deviation")
    assert warmed < 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("room", "start", "measured"),
    [
        *((room, room + warm, True) for room in (5.0, 16.0, 35.0) for warm in (-10.0, 0.0, 25.0)),
        # In a room of 11 degC or more, where the file says 16.
        *((room, start, False) for room, start in ((11.0, 20.0), (16.0, 25.0), (25.0, 25.0))),
    ],
)
def test_a_healthy_rig_runs_in_every_room_and_from_every_start(
    twin: Twin, room: float, start: float, measured: bool
) -> None:
    # In four minutes this duty heats the plate to above the limit of the rig file.
    limits = replace(LIMITS, hottest=120.0)
    trip, _, _ = Plate(twin, room, start).trip(TwinWatch(twin, limits), 240, measured=measured)
    assert trip is None


def test_a_reading_that_does_not_follow_the_duty_is_named(twin: Twin) -> None:
    plate = Plate(twin, 16.0, 16.0, [3])
    trip, _, _ = plate.trip(TwinWatch(twin, LIMITS), 60, measured=True)
    assert trip is not None
    assert re.fullmatch(
        rf"{twin.channels[3]} does not follow the duty: it has changed by [+-]0.\d K where the "
        r"duty alone makes \+1\d K, says the twin; is the sensor on the plate\?",
        trip.detail,
    )


def test_a_start_far_from_the_file_s_room_asks_for_the_ambient_temperature(twin: Twin) -> None:
    lock = Watched(TwinWatch(twin, LIMITS))
    assert lock.on_record(reading(0, *[30.0] * 15)) is None
    trip = lock.before_start()
    assert trip == Finding(
        "ambient-unknown",
        "the first readings are 14 K from the room of the rig file, 16 degC, and the device does "
        "not measure the ambient temperature; give it (--ambient)",
    )
    given = Guard.of(twin, ambient=20)
    given.before_start(feed(given, [reading(0, *[30.0] * 15)], at(0), RigState()), at(0))
    assert given.finding is None
    with pytest.raises(JaxtwinError, match=r"ambient: expected a temperature within 30 K of"):
        interlocks_of(twin, ambient=47)


@pytest.mark.slow
def test_a_cell_that_fails_while_it_is_driven_is_noticed() -> None:
    """The single cell's load follows the duty, and then falls to the room, as recorded once. Its
    rig file, which was not matched, allows a deviation of 40 K."""
    rig = load_rig("single-cell")
    twin = Twin(rig)
    limits = replace(LIMITS, hottest=200.0, deviation=40.0, cell=138.0, room=18.0)
    lock, live = Watched(TwinWatch(twin, limits)), Plant(twin)
    full = (rig.driver.counts * rig.driver.polarity,)
    trips: list[int] = []
    for second in range(700):
        if second == 300:
            with jax.enable_x64(True):
                live.replace(FAULT_MODELS["fail"](twin, "P1", 1.0)(live.system))
        trip = lock.on_record(
            Sample("l", "b", at(second), second * 10**6, 0, full if second else (0,), live.ambient)
        )
        trip = trip or lock.on_record(reading(second, *live.temperatures))
        if trip is not None:
            assert trip.kind in ("unresponsive", "deviation")
            trips.append(second)
            break
        live.drive(np.ones(1))
        live.advance(second + 1.0)
    assert trips
    assert 300 < trips[0] <= 300 + 4 * MEMORY_SECONDS


@pytest.mark.parametrize(("value", "trips"), [(25.9, False), (26.1, True), (5.9, True)])
def test_a_reading_of_a_plate_as_warm_as_the_room_may_deviate_by_the_limit(
    twin: Twin, value: float, trips: bool
) -> None:
    """10 K; half of the predicted rise, which is added, is nothing."""
    lock = Watched(TwinWatch(twin, LIMITS))
    assert lock.on_record(Sample("l", "b", at(0), 0, 0, (0, 0), 16.0)) is None
    assert lock.on_record(reading(0, *[16.0] * 15)) is None
    trip = lock.on_record(reading(1, value, *[16.0] * 14))
    assert (trip is not None) is trips
    if trip is not None:
        assert trip.kind == "deviation"
        assert f"{value:.1f} degC where the twin has 16.0, more than 10 K" in trip.detail


def test_limits_that_a_rig_file_leaves_out_follow_from_the_physics(twin: Twin, rig: Rig) -> None:
    found = OperatingLimits.of(twin)
    assert (found.hottest, found.cell) == (pytest.approx(90.0), pytest.approx(125.0))
    # T_h - Z T_c^2 / 2 of a TEC1-12706 at -14 degC: 52 K below it.
    assert found.lowest == pytest.approx(-66, abs=3)
    # The twin's channels rise by less than 1 K/s.
    assert 0.5 < found.rate < 6.0
    assert rig.limits is not None
    stated = replace(
        rig.limits,
        lowest=263.15,
        rate=1.5,
        frozen=5.0,
        deviation=7.0,
        command_delay=2.0,
        cell_temperature=373.15,
    )
    numbers = astuple(OperatingLimits.of(Twin(replace(rig, limits=stated))))
    assert numbers == pytest.approx((90.0, -10.0, 100.0, 1.5, 4.6, 5.0, 7.0, 2.0, 16.0))


def test_a_resistive_heater_cools_nothing_below_the_coldest_room_that_is_accepted() -> None:
    bed = load_rig("printer-bed")
    assert bed.limits is not None
    stated = replace(bed, limits=replace(bed.limits, rate=1.0))
    assert OperatingLimits.of(Twin(stated)).lowest == pytest.approx(22 - 30)


@pytest.mark.slow
def test_a_guard_reports_a_wrong_reading_or_heat_before_silence(twin: Twin) -> None:
    greeting = Greeting("l", at(0), Hello(2, "r", "b"))
    cold = Guard.of(twin)
    state = feed(cold, [greeting, reading(0, *[16.0] * 15)], at(0), RigState())
    assert cold.finding is None
    feed(cold, [reading(0, *[-273.15] * 15)], at(0), state)  # no rig is started so
    assert cold.finding is not None
    assert cold.finding.kind == "implausible"
    guard = Guard.of(twin, silence=3.0)
    state = feed(guard, [greeting, sample(0), reading(0, *[16.0] * 15)], at(0), RigState())
    feed(guard, [command(0), reading(1, *[16.0] * 14, 95.0)], at(5), state)
    assert guard.finding is not None
    assert (guard.finding.kind, guard.finding.severity) == ("over-temperature", "critical")
    assert guard.finding.since == at(1)


def test_a_guard_is_for_one_run(twin: Twin) -> None:
    guard = Guard.of(twin)
    guard.begin()
    with pytest.raises(JaxtwinError, match="expected a new one for each run"):
        guard.begin()


@final
class DoorIsOpen(AbstractInterlock):
    """An interlock of a user: the rig does not heat while its door is open."""

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        if isinstance(record, Event) and record.kind == "device/door":
            return Finding("door", "the door is open")
        return None


def test_an_interlock_of_a_user_stands_beside_the_others(twin: Twin) -> None:
    guard = Guard([*interlocks_of(twin), DoorIsOpen()])
    feed(guard, [Event("l", at(1), "device/door")], at(1), RigState())
    assert guard.finding == Finding("door", "the door is open", since=at(1))
