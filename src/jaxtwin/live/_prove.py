"""A proof test of the chain that switches a heater off: each interlock is provoked on the heated
rig, and what follows is read back from the device. The provocations stand first."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from ..errors import JaxtwinError, SafetyStop
from ..physics import Twin
from ._operate import Moment, counts_of, operate
from ._switch_off import STILL_HEATS, STILL_ON, Ending, switch_off
from .protocol._clock import seconds
from .protocol._messages import VERSION, Hello
from .protocol._records import Command, Event, Greeting, Reading, Record, Sample
from .protocol._rig_connection import RigConnection
from .safety._guard import Guard, interlocks_of
from .safety._interlock import Finding
from .safety._operating_limits import OperatingLimits

# What a proof test does to a heated rig, so that each interlock must switch it off.
#
# A distortion changes the records between the rig and the interlocks, and nothing on the rig. An
# act is done to the rig itself.

# The longest time from a provocation to the stop, s. A drift at a low rate takes the longest.
STOPS_WITHIN = 120.0

Readings = Float[np.ndarray, " channels"]


class Scene(NamedTuple):
    """What a provocation may use.

    - `limits`: the limits of the rig.
    - `counts`: the counts of full duty.
    - `first`: the first record of each kind since the onset.
    """

    limits: OperatingLimits
    counts: int
    first: dict[type, Record]


# Changes a record; `None` takes it away.
Distortion = Callable[[Record, Scene], Record | None]


class Provocation(NamedTuple):
    """One way to make the interlocks switch a rig off.

    - `name`: what seems to happen, for people.
    - `kinds`: the kinds of interlock that may trip.
    - `distort`: changes the records that the interlocks see.
    - `act`: done once to the rig itself.
    - `trip`: the reason that the device must report; `""` for any.
    - `cell_limit`: whether the limit of a cell's sides is set 1 K above the warmest reading.
    - `trips_within`: the longest time until something must have tripped, s.
    """

    name: str
    kinds: tuple[str, ...]
    distort: Distortion | None = None
    act: Callable[[RigConnection], object] | None = None
    trip: str = ""
    cell_limit: bool = False
    trips_within: float = STOPS_WITHIN


def provocations(limits: OperatingLimits, relay: str) -> list[Provocation]:
    """The provocations of a rig: those of the relay and of frozen readings only where there is such
    an interlock."""
    chosen = list(_ALWAYS)
    if np.isfinite(limits.frozen):
        still = Provocation("readings stand still", ("frozen", "unresponsive", "deviation"), _still)
        chosen.append(still)
    if relay:
        opened = Provocation(
            "somebody opens the relay", ("device-trip",), act=RigConnection.open_relay, trip="relay"
        )
        chosen.append(opened)
    return chosen


def _readings(change: Callable[[Reading, Scene], Readings]) -> Distortion:
    """Readings with other temperatures."""

    def distort(record: Record, scene: Scene) -> Record:
        if not isinstance(record, Reading):
            return record
        return replace(record, temperatures=change(record, scene))

    return distort


def _samples(change: Callable[[Sample, Scene], Sample]) -> Distortion:
    """Other samples of the controller."""

    def distort(record: Record, scene: Scene) -> Record:
        return change(record, scene) if isinstance(record, Sample) and record.pwm else record

    return distort


def _one(values: Readings, value: float) -> Readings:
    return np.concatenate([[value], values[1:]])


def _jumps(reading: Reading, scene: Scene) -> Readings:
    """Down, because upwards the limit of temperature may be passed first."""
    return reading.temperatures - (scene.limits.jump + 4 * scene.limits.rate + 1.0)


def _drifts(reading: Reading, scene: Scene) -> Readings:
    """Slower than the limit of the rate."""
    first = scene.first[Reading]
    assert isinstance(first, Reading)
    time = (reading.device_us - first.device_us) * 1e-6
    return reading.temperatures - min(0.3 * scene.limits.rate, 2.0) * time


def _still(record: Record, scene: Scene) -> Record:
    first = scene.first.get(Reading)
    if not isinstance(record, Reading) or not isinstance(first, Reading):
        return record
    return replace(record, temperatures=first.temperatures)


def _without(what: Callable[[Record], bool]) -> Distortion:
    return lambda record, scene: None if what(record) else record


def _instead(make: Callable[[Sample], Record]) -> Distortion:
    """Another record in place of each sample of the controller."""
    return lambda record, scene: (
        make(record) if isinstance(record, Sample) and record.pwm else record
    )


def _restarted(sample: Sample) -> Greeting:
    return Greeting(sample.link, sample.arrival, Hello(VERSION, "", boot="proof-test"))


_ALWAYS: Sequence[Provocation] = (
    Provocation(
        "a reading above the limit",
        ("over-temperature",),
        _readings(lambda r, s: _one(r.temperatures, s.limits.hottest + 1.0)),
    ),
    Provocation(
        "a short-circuited sensor",
        ("implausible",),
        _readings(lambda r, s: _one(r.temperatures, -ZERO_CELSIUS)),
    ),
    Provocation(
        "a failed channel",
        ("channel-fault",),
        _readings(lambda r, s: _one(r.temperatures, np.nan)),
    ),
    Provocation("readings that jump", ("rate", "deviation", "implausible"), _readings(_jumps)),
    Provocation("readings that drift away", ("deviation", "unresponsive"), _readings(_drifts)),
    Provocation(
        "a room that no twin knows",
        ("implausible",),
        _samples(lambda d, s: replace(d, ambient=s.limits.room - 50.0)),
    ),
    Provocation("a cell that is too hot inside", ("cell-temperature",), cell_limit=True),
    Provocation("no temperatures", ("silence",), _without(lambda r: isinstance(r, Reading))),
    Provocation("no controller", ("silence",), _without(lambda r: isinstance(r, Sample))),
    Provocation(
        "a bridge at full duty",
        ("disobedience",),
        _samples(lambda d, s: replace(d, pwm=(s.counts,) * len(d.pwm))),
    ),
    Provocation(
        "commands that are not acknowledged",
        ("unacknowledged",),
        _samples(lambda d, s: replace(d, number=None)),
    ),
    Provocation(
        "a command that was never sent",
        ("disobedience",),
        _samples(lambda d, s: replace(d, number=((d.number or 0) + 1000) % 2**32)),
    ),
    Provocation(
        "another host",
        ("commander",),
        _samples(lambda d, s: replace(d, owner="proof-test")),
    ),
    Provocation("a device that restarts", ("restart",), _instead(_restarted)),
    Provocation(
        "a device that greets as another",
        ("refused",),
        _instead(lambda d: Event(d.link, d.arrival, "refused", "proof test")),
    ),
    Provocation(
        "a lost link", ("link-down",), act=lambda connection: connection.drop_links("proof test")
    ),
    Provocation(
        "somebody stops it", ("device-trip",), act=lambda connection: connection.send_order("stop")
    ),
)


# The time for which the rig is heated before each provocation, s.
HEAT_SECONDS = 3.0

# The time for which the device must stay off, before and after a duty that it must refuse, s.
SETTLING_SECONDS = 1.0

# The part of its rise by which a cell of a warm rig may be hotter than the warmest reading: bare
# metal shows a camera less than its rise.
HIDDEN_PART = 0.25

# The device has had its time before the next command.
WATCHDOG = Provocation(
    "a host that falls silent", ("device-trip", "silence"), trip="watchdog", trips_within=0.0
)


class Proof(NamedTuple):
    """The outcome of one provocation.

    - `step`: what was provoked.
    - `kind`: the interlock that tripped; `""` for none.
    - `off_after`: the time until the device reported that the cells are off, s; NaN if it did not.
    - `wrong`: what was not proven; `""` if all was.
    """

    step: str
    kind: str
    off_after: float
    wrong: str


def prove(
    connection: RigConnection,
    twin: Twin,
    *,
    duty: float | int = 0.3,
    silence: float | int = 3.0,
    ambient: float | int | None = None,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
    on_end: Callable[[Ending], None] | None = None,
) -> Iterator[Proof]:
    """Proves that each interlock switches a rig off, by heating it for seconds and provoking them.

    After each stop the device must report that the cells are off, a trip, and, if the rig file
    names a relay, that it is open. It must stay so for a second, and refuse a duty. The next
    provocation begins with a reset.

    **Arguments:**

    - `connection`: the links of the rig, started.
    - `twin`: the twin of the rig, whose file must state `limits.temperature`.
    - `duty`: the duty of each cell while it is heated, above 0 to 1.
    - `reset`: whether a trip of the device is ended before the first step.
    - `silence`, `ambient`: as in `interlocks_of`.
    - `about`, `stop`, `on_progress`, `on_alarm`: as in `operate`.
    - `on_end`: called after each step, as in `operate`; the readings are watched after the last.

    **Returns:** an iterator over the proof of each step. It ends early if the device reports heat
    after a stop.

    **Raises:** `SafetyStop` if the rig does not start, or a signal ends it; `KeyboardInterrupt` if
    `stop` was set.
    """
    if not 0 < duty <= 1:
        raise JaxtwinError(f"prove: duty: expected above 0 to 1, got {duty}")
    limits = OperatingLimits.of(twin)
    steps = [*provocations(limits, connection.relay), WATCHDOG]
    for number, step in enumerate(steps):
        attempt = _Attempt(connection, step, limits, float(duty))
        locks = interlocks_of(twin, silence=silence, ambient=ambient, limits=attempt.limits)
        kind, wrong = "", ""
        try:
            outcome = operate(
                connection,
                Guard(locks),
                attempt.duty,
                reset=reset or number > 0,
                about={**(about or {}), "plan": {"proof": step.name}},
                stop=stop,
                on_progress=on_progress,
                on_alarm=on_alarm,
                on_end=on_end,
                confirm_off=step is steps[-1],
            )
            if outcome == "stopped":
                raise KeyboardInterrupt
            wrong = "nothing has tripped: neither an interlock nor the device"
        except SafetyStop as error:
            kind, wrong = error.kind, str(error)
            if attempt.onset is None and number == 0:  # it is not ready for a proof
                raise
        finally:
            attempt.end()
        # The room is that of the first step: each heats the rig a little.
        ambient = attempt.first if ambient is None else ambient
        if kind in step.kinds and attempt.onset is not None:
            wrong = attempt.aftermath(stop, on_alarm)
        yield Proof(step.name, kind, attempt.off_after, wrong)
        if kind in (STILL_ON, STILL_HEATS) or attempt.onset is None:
            return


@final
class _Attempt:
    """One provocation: the source of the duty, and the records that follow."""

    def __init__(
        self, connection: RigConnection, step: Provocation, limits: OperatingLimits, duty: float
    ):
        self.onset: int | None = None
        """Host time of the provocation, ns."""
        self.off_after = float("nan")
        self.first: float | None = None
        """The mean of the first readings, degC."""
        self._connection, self._step = connection, step
        self._heat = (duty,) * len(connection.rig.driven)
        self._begin: int | None = None
        self._stopped = False
        self._scene = Scene(limits, connection.rig.driver.counts, {})
        self._seen: list[Record] = []
        self._distorts = True
        connection.tap = self._tapped
        self.limits = self._low_limits(limits) if step.cell_limit else limits
        """The limits of the interlocks."""

    def duty(self, moment: Moment) -> Sequence[float] | None:
        """The source of the duty: heats, then provokes."""
        now = self._connection.clock.now()
        if self._begin is None:
            self._begin = now
            if self._step.cell_limit:  # the heat itself provokes
                self.onset = now
        if self.onset is not None and seconds(now - self.onset) > self._step.trips_within:
            self._distorts = False
            return None
        if self.onset is None and seconds(now - self._begin) >= HEAT_SECONDS:
            self.onset = now
            if self._step.act is not None:
                self._step.act(self._connection)
            if self._step is WATCHDOG:
                self._fall_silent()
        return self._heat

    def end(self) -> None:
        """Leaves the records of the connection as they are."""
        self._connection.tap = None

    def aftermath(
        self, stop: threading.Event | None, on_alarm: Callable[[Finding], None] | None
    ) -> str:
        """Checks what the device did and does. Returns what is wrong, `""` for nothing."""
        wrong = self._read_back() or self._watch("")
        if not wrong:
            self._connection.send_duty(
                counts_of(self._connection.rig, self._heat)
            )  # must be refused
            wrong = self._watch("refused")
        if wrong:
            switch_off(self._connection, trip=True, stop=stop, on_alarm=on_alarm)
        return wrong

    def _tapped(self, records: list[Record]) -> list[Record]:
        """The records that the interlocks see: distorted from the onset to the first stop."""
        self._seen += records
        for record in records:
            if self.first is None and isinstance(record, Reading) and not record.recalibrating:
                self.first = float(np.nanmean(record.temperatures))
        self._stopped |= any(isinstance(r, Command) and r.kind == "stop" for r in records)
        distort = self._step.distort
        if self.onset is None or self._stopped or distort is None or not self._distorts:
            return records
        changed: list[Record] = []
        for record in records:
            self._scene.first.setdefault(type(record), record)
            other = distort(record, self._scene)
            changed += [] if other is None else [other]
        return changed

    def _fall_silent(self) -> None:
        """Sends nothing until the longest watchdog must have tripped, as a host that hangs."""
        begin = self._connection.clock.now()
        longest = max(greeting.hello.watchdog or 0.0 for greeting in self._connection.greetings)
        while seconds(self._connection.clock.now() - begin) < longest + SETTLING_SECONDS:
            self._connection.poll(0.05)

    def _read_back(self) -> str:
        """Checks that the device has reported heat, and then, after the onset, none."""
        assert self.onset is not None
        heated = False
        for record in self._seen:
            if not isinstance(record, Sample) or not record.pwm:
                continue
            heated = heated or any(record.pwm)
            if heated and not any(record.pwm) and record.arrival > self.onset:
                self.off_after = seconds(record.arrival - self.onset)
                return ""
        if not heated:
            return "the device did not report any heat before"
        return "the device has not reported that the cells are off"

    def _watch(self, event: str) -> str:
        """Polls for a while, in which the device must report off, and one event."""
        begin = self._connection.clock.now()
        samples: list[Sample] = []
        events: set[str] = set()
        while seconds(self._connection.clock.now() - begin) < SETTLING_SECONDS:
            for record in self._connection.poll(0.05):
                if isinstance(record, Sample) and record.arrival > begin:
                    samples.append(record)
                elif isinstance(record, Event):
                    events.add(record.kind)
        controller = [sample for sample in samples if sample.pwm]
        relay = [sample.relay for sample in samples if sample.relay]
        if not controller:
            return "the device is silent after the stop"
        if any(any(sample.pwm) for sample in controller):
            return "the device heats after the stop, without a reset"
        trip = controller[-1].trip
        if not trip or self._step.trip not in ("", trip):
            expected = self._step.trip or "a reason"
            return f"the device reports trip={trip or 'nothing'}, expected {expected}"
        if self._connection.relay and set(relay) != {"off"}:
            return f"the relay is not reported as open, but as {', '.join(relay) or 'nothing'}"
        if event and f"device/{event}" not in events:
            return "the device does not report that it refuses a duty until a reset"
        return ""

    def _low_limits(self, limits: OperatingLimits) -> OperatingLimits:
        """Limits at which the cells are too hot inside after little heating."""
        warmest: float | None = None
        begin = self._connection.clock.now()
        while warmest is None and seconds(self._connection.clock.now() - begin) < STOPS_WITHIN:
            for record in self._connection.poll(0.05):
                if isinstance(record, Reading) and not record.recalibrating:
                    warmest = float(record.temperatures.max())
        warmest = limits.room if warmest is None else warmest
        hidden = HIDDEN_PART * max(warmest - limits.room, 0.0)
        return replace(limits, cell=warmest + hidden + 1.0)
