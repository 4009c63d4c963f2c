"""Virtual rigs that publish as real ones do: to try a fleet, and to measure one."""

import json
import multiprocessing
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import final

import jax
import numpy as np

from ..live import Plant, close_client, connect_client, counts_of, mqtt_client
from ..physics import Fault, Faults, Twin
from ..rig import Rig, load_rig
from ..serve._child_process import end_with_parent
from ._fleet_file import FleetFile

# The duty of each virtual rig is another one after this time, s of the rig.
HOLD_SECONDS = 240.0

# Healthy rigs share this number of twins, each with its own schedule; their noise differs.
PHASES = 4

# The messages that may be on their way to the broker.
MAX_INFLIGHT = 2000


@dataclass
class _Plant:
    """A twin of some rigs with the random numbers of its schedule, and the faults to come."""

    names: list[str]
    rig: Rig
    plant: Plant
    schedule: np.random.Generator
    to_come: list[tuple[float, Fault]]
    counts: tuple[int, ...] = ()


@final
class VirtualFleet:
    """Publishes the readings of virtual rigs once in a second of theirs, and the duty with each
    change and once in ten seconds. Times are those of the rigs, which are ahead of the host's at
    higher speeds.

    **Arguments:**

    - `file`: the file of the fleet. `faults`: rig -> faults, whose times count from the start.
    """

    def __init__(self, file: FleetFile, faults: Mapping[str, Faults] | None = None, seed: int = 0):
        self.sent = 0
        """The number of readings that the broker has been given."""
        self._file, self._faults = file, faults or {}
        self._random = np.random.default_rng(seed)
        self._count = 0
        self._begin = time.time()
        groups: dict[tuple[str, int | str], list[str]] = {}
        for number, (name, member) in enumerate(file.members.items()):
            key = name if name in self._faults else number % PHASES
            groups.setdefault((member.rig, key), []).append(name)
        self._plants = [
            self._plant(rig, names, seed + number)
            for number, ((rig, _), names) in enumerate(groups.items())
        ]
        self._client = mqtt_client(file.broker, reconnect=True)
        self._client.max_inflight_messages_set(MAX_INFLIGHT)
        connect_client(self._client, file.broker)
        self._client.loop_start()

    def run(self, speed: float, is_over: Callable[[], bool]) -> None:
        """Publishes until it is to end; `speed`: seconds of the rigs in one of the host."""
        begin, first = time.monotonic(), self._count
        while not is_over():
            due = begin + (self._count - first) / speed
            time.sleep(max(due - time.monotonic(), 0.0))
            self.second()

    def second(self) -> None:
        """Publishes a second of all rigs."""
        at = float(self._count)
        for simulated in self._plants:
            rig, plant = simulated.rig, simulated.plant
            plant.advance(at)
            for fault in [fault for fault in simulated.to_come if fault[0] <= at]:
                simulated.to_come.remove(fault)
                with jax.enable_x64(True):
                    plant.replace(fault[1](plant.system))
            channels = [channel.name for channel in rig.channels]
            exact, stamp = np.asarray(plant.temperatures), round(self._begin + at, 3)
            noise = self._random.normal(0, rig.noise or 0.05, (len(simulated.names), len(channels)))
            rows = np.round(exact + noise, 3).tolist()
            duty = None
            if at % HOLD_SECONDS == 0:
                lowest = np.maximum(rig.lowest_duty, -0.3)
                level = lowest + (0.6 - lowest) * simulated.schedule.random(len(lowest))
                simulated.counts = counts_of(rig, level)
                plant.drive(np.asarray(rig.driver.duty(simulated.counts)))
            if at % 10 == 0:
                ambient = {"ambient_degC": round(plant.ambient, 2)}
                duty = {
                    "time": stamp,
                    **dict(zip(rig.driven, simulated.counts, strict=True)),
                    **ambient,
                }
            for name, row in zip(simulated.names, rows, strict=True):
                self._send(
                    name, "readings", {"time": stamp, **dict(zip(channels, row, strict=True))}
                )
                if duty is not None:
                    self._send(name, "duty", duty)
            self.sent += len(simulated.names)
        self._count += 1

    def close(self) -> None:
        """Ends the connection when the broker has everything."""
        while self._client.want_write() or self._client._out_messages:
            time.sleep(0.01)
        close_client(self._client)

    def _plant(self, name: str, names: list[str], seed: int) -> _Plant:
        rig = load_rig(name)
        twin = Twin(rig)
        known = [fault for member in names for fault in self._faults.get(member, Faults()).rig]
        plant = Plant(twin)
        to_come = [(fault.time, fault.of(twin)) for fault in known]
        with jax.enable_x64(True):
            for _, fault in to_come:
                fault(plant.system)  # compiles
        return _Plant(names, rig, plant, np.random.default_rng(seed), to_come)

    def _send(self, rig: str, what: str, content: dict[str, object]) -> None:
        self._client.publish(self._file.topic(rig, what), json.dumps(content), qos=1)


@contextmanager
def virtual_fleet_process(
    path: Path, speed: float, faults: Mapping[str, Faults]
) -> Generator[None]:
    """The same in a process of its own while the block runs."""
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_publish, args=(path, speed, faults), daemon=True)
    process.start()
    try:
        yield
    finally:
        process.terminate()
        process.join()


def _publish(path: Path, speed: float, faults: Mapping[str, Faults]) -> None:
    end_with_parent()
    VirtualFleet(FleetFile.read(path), faults).run(speed, threading.Event().is_set)
