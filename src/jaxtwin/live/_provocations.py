"""What a proof test does to a heated rig, so that each interlock must switch it off.

A distortion changes the records between the rig and the interlocks, and nothing on the rig. An act
is done to the rig itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from .protocol._messages import VERSION, Hello
from .protocol._records import Event, Greeting, Reading, Record, Sample
from .protocol._rig_connection import RigConnection
from .safety._operating_limits import OperatingLimits

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
