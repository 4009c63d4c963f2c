"""What is known of a rig now: one fold over its records, for all that watch or drive it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from ._clock import seconds
from ._messages import Hello
from ._records import Event, Gap, Greeting, LinkChange, LinkState, Reading, Record, Sample

# The largest relative error of a device's clock. The crystal of a computer is off by 1e-5, the
# oscillator of a cheap microcontroller by up to this.
CLOCK_DRIFT = 0.01

# The longest time by which a twin beside a rig lags behind, ns. Without this bound, the twin of a
# device whose clock stands still would stand still too.
MAX_WAIT = 10 * 10**9


@final
class BootClock(NamedTuple):
    """The clock of one start of a device, as its messages show it.

    The lag of a message is its arrival time less the device time at which it was made. The smallest
    lag shows best how the two clocks differ, because such a message has waited least. It grows
    with `CLOCK_DRIFT`, so that a device whose clock is a little slow does not seem late after some
    hours. A queue that grows more slowly than that is not noticed by its clock alone.

    - `boot`: the start of the device. `rate`: the seconds of the device in a second.
    - `least_lag`: the smallest lag, ns. `arrival`: that of the last message, ns.
    """

    boot: str
    rate: float
    least_lag: int
    arrival: int

    def after(self, device_us: int, arrival: int) -> "BootClock":
        """The clock after a message that was made at a time of the device's clock."""
        lag = arrival - round(device_us * 1e3 / self.rate)
        drifted = self.least_lag + round(CLOCK_DRIFT * max(arrival - self.arrival, 0))
        return self._replace(least_lag=min(lag, drifted), arrival=arrival)

    def host_time(self, device_us: int) -> int:
        """The host time at which the device's clock showed a time, ns."""
        return round(device_us * 1e3 / self.rate) + self.least_lag


@final
@dataclass(frozen=True, eq=False)
class RigState:
    """What is known of a rig after its records up to now.

    All times are host times in ns since 1970. The time of a sample or of a reading is that of the
    device, moved to the host's clock: a message that waited in a buffer is not taken for new.

    **Arguments:**

    - `links`: the state of each link. `greetings`: the last greeting of each link.
    - `sample`: the last sample of the device that drives the cells; None before the first.
    - `relay`: the last sample of the device that has a relay in the supply; None before the first.
    - `reading`: the last reading, except those of a camera that recalibrates itself; None before
      the first.
    - `temperatures`: the last valid temperature of each channel, degC; NaN where there was none.
      There are no channels before the first reading.
    - `measured`: the time at which each of them was measured, ns; 0 where there was none.
    - `faults`: the channels that have failed in the last reading, with the reason.
    - `recalibrating`: whether the camera recalibrates itself.
    - `counts`: how many messages were lost, damaged, repeated or without sense.
    - `clocks`: the clock of the device on each link.
    """

    links: Mapping[str, LinkState] = field(default_factory=dict)
    greetings: Mapping[str, Hello] = field(default_factory=dict)
    sample: Sample | None = None
    relay: Sample | None = None
    reading: Reading | None = None
    temperatures: Float[np.ndarray, " channels"] = field(default_factory=lambda: np.zeros(0))
    measured: Int[np.ndarray, " channels"] = field(default_factory=lambda: np.zeros(0, np.int64))
    faults: Mapping[int, str] = field(default_factory=dict)
    recalibrating: bool = False
    counts: Mapping[str, int] = field(default_factory=dict)
    clocks: Mapping[str, BootClock] = field(default_factory=dict)

    def after(self, record: Record) -> "RigState":
        """The state after the next record."""
        match record:
            case Greeting():
                # A controller that has restarted says anew what it applies. One that only greets
                # again, as to a host that begins a run, goes on, and so does its clock: a camera
                # whose frames are late is not up to date because it has reconnected.
                known = self.greetings.get(record.link)
                has_restarted = known is None or known.boot != record.hello.boot
                sample = None if has_restarted and record.hello.cells else self.sample
                greetings = {**self.greetings, record.link: record.hello}
                return replace(self, greetings=greetings, sample=sample)
            case LinkChange():
                sample, links = self.sample, {**self.links, record.link: record.state}
                if sample is not None and sample.link == record.link:
                    sample = None if record.state is LinkState.DOWN else sample
                return replace(self, links=links, sample=sample)
            case Sample():
                state = replace(self, clocks=self._clocks_after(record))
                relay = record if record.relay else self.relay
                return replace(state, sample=record if record.pwm else self.sample, relay=relay)
            case Reading():
                return self._read(record)
            case Gap():
                return self._counted("lost", record.count)
            case Event(kind="garbage" | "nonsense" | "duplicate"):
                return self._counted(record.kind, 1)
        return self

    @property
    def rate(self) -> float:
        """The seconds of the rig in a second of the host: 1, but for a virtual rig."""
        rates = [hello.rate for hello in self.greetings.values() if hello.cells]
        return rates[-1] if rates else 1.0

    @property
    def boots(self) -> dict[str, str]:
        """The present start of the device on each link."""
        return {link: hello.boot for link, hello in self.greetings.items()}

    @property
    def ambient(self) -> float | None:
        """The measured ambient temperature, degC; None if the device measures none."""
        return None if self.sample is None else self.sample.ambient

    @property
    def trip(self) -> str:
        """Why the device refuses every duty; `""` if it does not."""
        if self.sample is not None and self.sample.trip:
            return self.sample.trip
        return "relay" if self.relay is not None and self.relay.relay == "off" else ""

    def time_of(self, record: Sample | Reading) -> int:
        """The host time at which a sample or a reading was made, ns, but at most `MAX_WAIT`
        before it arrived."""
        return max(self.made(record), record.arrival - MAX_WAIT)

    def age(self, record: Sample | Reading, now: int) -> float:
        """The time since a sample or a reading was made, s, at host time `now`, ns.

        It is told by the device's clock, so that what waited on the way is as old as it is, however
        new it has arrived.
        """
        return seconds(now - self.made(record))

    def made(self, record: Sample | Reading) -> int:
        """The host time at which a sample or a reading was made, ns, however long ago."""
        clock = self.clocks.get(record.link)
        if clock is None or clock.boot != record.boot:
            return record.arrival
        return min(clock.host_time(record.device_us), record.arrival)

    def _read(self, reading: Reading) -> "RigState":
        state = replace(
            self, clocks=self._clocks_after(reading), recalibrating=reading.recalibrating
        )
        if reading.recalibrating:
            return state
        values = reading.temperatures
        valid = np.isfinite(values)
        before, measured = self.temperatures, self.measured
        if len(before) != len(values):
            before, measured = np.full(len(values), np.nan), np.zeros(len(values), np.int64)
        return replace(
            state,
            reading=reading,
            temperatures=np.where(valid, values, before),
            measured=np.where(valid, state.time_of(reading), measured),
            faults={
                int(place): reading.faults.get(int(place), "no number")
                for place in np.flatnonzero(~valid)
            },
        )

    def _clocks_after(self, record: Sample | Reading) -> Mapping[str, BootClock]:
        clock = self.clocks.get(record.link)
        if clock is None or clock.boot != record.boot:
            hello = self.greetings.get(record.link)
            rate = 1.0 if hello is None else hello.rate
            lag = record.arrival - round(record.device_us * 1e3 / rate)
            clock = BootClock(record.boot, rate, lag, record.arrival)
        return {**self.clocks, record.link: clock.after(record.device_us, record.arrival)}

    def _counted(self, what: str, count: int) -> "RigState":
        return replace(self, counts={**self.counts, what: self.counts.get(what, 0) + count})
