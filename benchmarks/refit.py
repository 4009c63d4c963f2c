"""Does the gate of a refit reject poisoned recordings, and let real changes through?

A last fit of four healthy sessions of a rig that is simulated; then sessions with one thing wrong
each, drawn by a seed. Between sessions every free parameter takes a small random step. Seeds that
are judged were not looked at before; the settings of the gate were chosen on others.

- poisoned, `single-cell`: a channel that is frozen from some time on; a duty in other counts, 0.4
  to 0.8 or 1.25 to 2.5 times what it was; another rig, all of whose parameters are drawn from the
  priors of the rig file.
- poisoned, `tclab`: the two channels exchanged.
- poisoned, `heated-box`: the lid open for a third of the session, which the recording calls closed.
- sensors, `single-cell`: all readings with a gain of 0.95 about the room; all 2 K too high, with
  the room recorded or not; a clock that is 5 % fast.
- real, `single-cell`: a contact of three times the resistance, of the cell to the load or the
  sink.
- healthy, `single-cell`: nothing, with the room recorded or not.

With a folder of recordings: the real sessions 5, 6, 15 and 27 of the single cell after a match of 1
to 4, and the time of a refit of one with kept programs.

    python -m benchmarks.refit [--seeds 100] [--first 0] [--kinds frozen duty] [--recordings DIR]
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np

import jaxtwin as jt
from benchmarks._machine import processor

LENGTH = 900
"""The length of a session, s."""

DRIFT = 0.016
"""The step of a parameter from session to session, as a part of the spread of its prior: what the
sessions 1 to 4 of the real cell say of it."""

SESSIONS = (1, 2, 3, 4)

HELD = ("T_amb", "T_start", "T_sink")


def schedule(twin: jt.Twin, random: np.random.Generator, inputs: Mapping[str, object]):
    """A session: every minute another duty for each cell."""
    time_s = np.arange(LENGTH + 1.0)
    lowest = np.maximum(np.array(twin.rig.lowest_duty), -0.5)
    levels = random.uniform(lowest, 0.9, (LENGTH // 60 + 1, len(lowest)))
    duty = np.repeat(levels, 60, axis=0)[: LENGTH + 1]
    made = jt.Experiment(time_s, duty, channels=twin.channels)
    return made.with_inputs(**inputs)


def drifted(twin: jt.Twin, random: np.random.Generator) -> jt.Twin:
    """The rig of another session, in another room."""
    values = {}
    for name, row in twin.rig.parameters.items():
        value = float(twin.values[name])
        if row.free and row.scope == "shared":
            moved = DRIFT * (row.standard_deviation or 0.0) * random.normal()
            values[name] = row.from_entry(row.to_entry(value) + moved)
    room = float(random.normal(18.0, 1.0))
    values |= {name: room for name in HELD if name in twin.values}
    return twin.with_values(values)


def recorded(
    twin: jt.Twin, plan: jt.Experiment, random: np.random.Generator, name: str
) -> jt.Experiment:
    return jt.simulate(twin, plan).to_recording(seed=int(random.integers(2**31)), name=name)


@cache
def last_fit(rig: str) -> jt.Fit:
    """The last fit, of four healthy sessions. A box is matched with its lid opened once in each."""
    twin, sessions = jt.Twin(rig), []
    for number in SESSIONS:
        random = np.random.default_rng([7, number])
        inputs: dict[str, object] = {}
        if rig == "heated-box":
            lid = np.zeros(LENGTH + 1)
            lid[300 + 60 * number : 360 + 60 * number] = 1
            inputs = {"lid": lid, "fan": 1.0}
        plan = schedule(twin, random, inputs)
        sessions.append(recorded(drifted(twin, random), plan, random, f"session {number}"))
    return jt.match(twin, sessions)


def healthy(seed: int, rig: str = "single-cell") -> tuple[jt.Fit, jt.Experiment]:
    random = np.random.default_rng([11, seed])
    twin = drifted(jt.Twin(rig), random)
    return last_fit(rig), recorded(twin, schedule(twin, random, {}), random, "healthy")


def of_sensors(
    seed: int, gain: float = 1.0, offset: float = 0.0, clock: float = 1.0, has_room: bool = False
) -> tuple[jt.Fit, jt.Experiment]:
    """A healthy session whose sensors are all wrong."""
    random = np.random.default_rng([17, seed])
    twin = drifted(jt.Twin("single-cell"), random)
    one = recorded(twin, schedule(twin, random, {}), random, "sensors")
    room = float(twin.values["T_amb"])
    return last_fit("single-cell"), jt.Experiment(
        clock * one.time,
        one.duty,
        channels=one.channels,
        temperatures=room + gain * (np.array(one.temperatures) - room) + offset,
        ambient=room if has_room else None,
        name="sensors",
    )


def frozen(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    fit, one = healthy(seed)
    start = int(np.random.default_rng([12, seed]).integers(60, LENGTH - 120))
    readings = np.array(one.temperatures)
    readings[start:] = readings[start]
    return fit, jt.Experiment(
        one.time, one.duty, channels=one.channels, temperatures=readings, name="frozen"
    )


def duty(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    fit, one = healthy(seed)
    random = np.random.default_rng([13, seed])
    factor = float(np.exp(random.uniform(np.log(1.25), np.log(2.5))))
    factor = factor if random.random() < 0.5 else 1 / factor
    wrong = np.clip(factor * one.duty, -1.0, 1.0)
    return fit, jt.Experiment(
        one.time, wrong, channels=one.channels, temperatures=one.temperatures, name="duty"
    )


def another_rig(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    random = np.random.default_rng([14, seed])
    twin = drifted(jt.Twin("single-cell"), random)
    values = {}
    for name, row in twin.rig.parameters.items():
        if row.free and row.scope == "shared" and row.standard_deviation is not None:
            away = row.standard_deviation * random.normal()
            entry = row.to_entry(float(twin.values[name])) + away
            values[name] = float(np.clip(row.from_entry(entry), row.lower, row.upper))
    twin = twin.with_values(values)
    return last_fit("single-cell"), recorded(twin, schedule(twin, random, {}), random, "another")


def exchanged(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    fit, one = healthy(seed, "tclab")
    readings = np.array(one.temperatures)[:, ::-1]
    return fit, jt.Experiment(
        one.time, one.duty, channels=one.channels, temperatures=readings, name="exchanged"
    )


def lid(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    random = np.random.default_rng([15, seed])
    twin = drifted(jt.Twin("heated-box"), random)
    start = int(random.integers(60, LENGTH * 2 // 3))
    opened = np.zeros(LENGTH + 1)
    opened[start : start + LENGTH // 3] = 1
    plan = schedule(twin, random, {"lid": opened, "fan": 1.0})
    one = recorded(twin, plan, random, "lid")
    return last_fit("heated-box"), one.with_inputs(lid="closed")


def contact(seed: int) -> tuple[jt.Fit, jt.Experiment]:
    random = np.random.default_rng([16, seed])
    twin = drifted(jt.Twin("single-cell"), random)
    name = ("R_pc", "R_ph")[seed % 2]
    twin = twin.with_values({name: 3 * float(twin.values[name])})
    return last_fit("single-cell"), recorded(twin, schedule(twin, random, {}), random, "contact")


KINDS: dict[str, tuple[Callable[[int], tuple[jt.Fit, jt.Experiment]], tuple[str, ...]]] = {
    "frozen": (frozen, ("rejected",)),
    "duty": (duty, ("rejected",)),
    "another rig": (another_rig, ("rejected",)),
    "exchanged": (exchanged, ("rejected",)),
    "lid": (lid, ("rejected",)),
    "contact": (contact, ("promoted",)),
    "healthy": (healthy, ("promoted", "unchanged")),
    "healthy, room recorded": (partial(of_sensors, has_room=True), ("promoted", "unchanged")),
    "gain": (partial(of_sensors, gain=0.95), ("rejected", "ask")),
    "offset": (partial(of_sensors, offset=2.0), ("unchanged",)),
    "offset, room recorded": (
        partial(of_sensors, offset=2.0, has_room=True),
        ("rejected", "ask"),
    ),
    "clock": (partial(of_sensors, clock=1.05), ("rejected", "ask")),
}
"""Kind -> how a session of it is made from a seed, and the decisions that are right."""


def of_kind(kind: str, seeds: range, verbose: bool) -> str:
    """A row of the table: how often each decision was made, and the check behind a rejection."""
    make, right = KINDS[kind]
    decisions, reasons, seconds = Counter(), Counter(), []
    for seed in seeds:
        fit, one = make(seed)
        began = time.perf_counter()
        found = jt.refit(fit, one)
        seconds.append(time.perf_counter() - began)
        decisions[found.decision] += 1
        if found.decision in ("rejected", "ask"):
            reasons[found.failed[0].name] += 1
        if verbose or found.decision not in right:
            print(f"{kind} {seed}: {found.decision}: {found.reason}", flush=True)
    good = sum(decisions[name] for name in right)
    said = ", ".join(f"{name} {count}" for name, count in decisions.most_common())
    why = ", ".join(f"{name} {count}" for name, count in reasons.most_common())
    return f"| {kind} | {good} of {len(seeds)} | {said} | {why} | {np.median(seconds):.1f} |"


def real(folder: Path) -> None:
    """Sessions of the single cell after a match of the first four, as they were recorded."""
    files = [folder / f"BMData{number}_022722.mat" for number in (1, 2, 3, 4)]
    rig = jt.load_rig("single-cell")
    fit = jt.match(jt.Twin(rig), [jt.read_recording(file, rig=rig) for file in files])
    for number in (5, 6, 15, 27):
        one = jt.read_recording(folder / f"BMData{number}_022722.mat", rig=rig)
        jt.refit(fit, one)
        began = time.perf_counter()
        found = jt.refit(fit, one)
        print(f"session {number}, {time.perf_counter() - began:.1f} s: {found.summary()}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=[*KINDS])
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args()
    print(f"{processor()}, seeds {chosen.first} to {chosen.first + chosen.seeds - 1}")
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    print("| session | right | decisions | first check that failed | s |\n|---|---|---|---|---|")
    for kind in chosen.kinds:
        print(of_kind(kind, seeds, chosen.verbose), flush=True)
    if chosen.recordings is not None:
        real(chosen.recordings)


if __name__ == "__main__":
    main()
