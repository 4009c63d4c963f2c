"""What does a monitor find in recordings, and do its thresholds hold?

- Textbook thresholds: how often a cumulative sum with h = 5 alarms, on normal innovations and on
  real ones.
- Extrapolation: from ten hours of independent innovations with heavy tails to what is passed once
  in 12 days, which is then counted in 44 days.
- `single-cell`: matched, noise and thresholds from the sessions 1 to 4; then the others.
- `dual-cell`: match, noise and thresholds from the first halves of the three steps; then the whole
  steps, and another day.
- A heated box (`incubator/`), whose lid was opened twice in one of three recordings.
- The time of a step.

`benchmarks.faults` has faults and false alarms of a virtual rig.

    python -m benchmarks.monitor FOLDER_WITH_RECORDINGS
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

import jaxtwin as jt
from benchmarks._devices import box_recordings
from benchmarks._fitted import MATCHED, STEPS, fitted, single_cell_sessions
from benchmarks._machine import processor
from jaxtwin._jax_settings import own_settings
from jaxtwin.live import Finding
from jaxtwin.monitoring import (
    Evidence,
    FindingLog,
    Monitor,
    Monitored,
    MonitorState,
    ObservedSample,
    joined,
    observed_sample,
)
from jaxtwin.monitoring._calibrate import block_maxima, tail_of
from jaxtwin.monitoring._innovation_tests import InnovationState, InnovationTests
from jaxtwin.monitoring._thresholds import alarms_of_sum, mean_run_length

RUN_LENGTHS = (3.0, 4.0, 5.0, 6.0, 8.0)
"""The thresholds of the table of textbook sums."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fits", type=Path, help="a folder that keeps fits and noise")
    given = parser.parse_args()
    print(f"{processor()}\n")
    extrapolation()
    single(given.folder, given.fits)
    box(given.folder / "incubator", given.fits)
    speed(double(given.folder, given.fits))


def extrapolation() -> None:
    """Tails of hours against what is counted in weeks, at 1 Hz."""
    chains, length, rare = 64, 60_000, 1e6
    random = np.random.default_rng(0)
    loud = random.uniform(size=(chains, length)) < 0.05
    innovations = random.normal(size=(chains, length)) * np.where(loud, 3.0, 1.0)
    tests = InnovationTests(np.ones(1), np.zeros(1), np.ones(4), np.array(np.inf))
    with own_settings():
        scores = np.asarray(_scores(tests, jax.numpy.asarray(innovations)))
    time = np.arange(float(length))
    print("## Extrapolation\n")
    print("| statistic | level | passed a second | scale | once in 12 days, from 10 h | counted |")
    print("|---|---|---|---|---|---|")
    for place, name in enumerate(("sum", "ratio", "energy")):
        maxima = [block_maxima(time, one) for one in scores[place]]
        few = int(36_000 / length * len(maxima[0]))
        short, whole = tail_of([maxima[0][:few]], "simulations"), tail_of(maxima, "simulations")
        assert short is not None
        assert whole is not None
        limit = short.threshold(rare)
        passed = sum(int((one > limit).sum()) for one in maxima)
        expected = chains * length / rare
        print(
            f"| {name} | {whole.level:.2f} | {whole.rate:.2g} | {whole.scale:.3f} | {limit:.1f} | "
            f"{passed} times, {expected:.1f} expected |"
        )
    print()


@jax.jit
def _scores(tests: InnovationTests, innovations: jax.Array) -> jax.Array:
    """The statistics of several series of innovations."""
    one = jax.numpy.ones(())

    def run(series: jax.Array) -> jax.Array:
        def take(state: InnovationState, x: jax.Array) -> tuple[InnovationState, jax.Array]:
            none = jax.numpy.zeros(1)
            sample = ObservedSample(x[None], none, x[None], none, none, none, one, one)
            after, found = tests.step(state, sample, one, one > 0)
            picked = [found[place].score[0] for place in (0, 1, 3)]
            return after, jax.numpy.stack(picked)

        return jax.lax.scan(take, tests.init(), series)[1].T

    return jax.lax.map(run, innovations).swapaxes(0, 1)


def single(folder: Path, kept: Path | None) -> None:
    """The sessions of the single cell."""
    sessions = single_cell_sessions(folder)
    known = [sessions[number] for number in MATCHED]
    fit, noise = fitted("single-cell", known, ("R_E",), kept)
    observed = [jt.observe(fit, one, noise) for one in known]
    textbook([one.standardised[120:, 0] for one in observed])
    print("\n## The single cell\n")
    judged = {f"session {number}": one for number, one in sorted(sessions.items())}
    recorded(fit, noise, known, judged)


def box(folder: Path, kept: Path | None) -> None:
    """The heated box, while its fan runs."""
    rig, known, third = box_recordings(folder)
    fit, noise = fitted("incubator", known, (), kept, rig)
    print("\n## A heated box\n")
    recorded(fit, noise, known, {one.name: one for one in (*known, third)})


def double(folder: Path, kept: Path | None) -> Monitored:
    """The recordings of the two-cell rig; what was found in the last of them."""
    steps = {name: jt.read_recording(folder / name) for name in STEPS}
    halves = [one.between(0, one.duration / 2) for one in steps.values()]
    fit, noise = fitted("dual-cell", halves, (), kept)
    day = jt.read_recording(folder / "other-day" / "peltierMIMOSecA1.mat")
    print("\n## The two-cell rig\n")
    return recorded(fit, noise, halves, {**steps, "another day": day})


def recorded(
    fit: jt.Fit,
    noise: jt.ProcessNoise,
    known: Sequence[jt.Experiment],
    judged: Mapping[str, jt.Experiment],
) -> Monitored:
    """What is found in recordings with thresholds from those that are known; that of the last."""
    calibration = jt.calibrate_monitor(fit, known, noise)
    print("| recording | thresholds know it | alarms | findings |\n|---|---|---|---|")
    found = None
    for name, one in judged.items():
        found = jt.monitor(fit, one, noise, calibration=calibration)
        is_known = "yes" if one.fingerprint in [each.fingerprint for each in known] else "no"
        texts = "; ".join(text(finding) for finding in found.findings) or "none"
        print(f"| {name} | {is_known} | {len(found.alarms)} | {texts} |", flush=True)
    assert found is not None
    print(f"\n{thresholds(found)}")
    return found


def textbook(series: Sequence[np.ndarray]) -> None:
    """How often Page's two-sided sum with k = 0.5 alarms."""
    print("## Textbook thresholds\n")
    print("| h | normal, samples | at 10 Hz, every s | single cell, sessions 1-4, samples |")
    print("|---|---|---|---|")
    for limit in RUN_LENGTHS:
        normal = mean_run_length(limit)
        count = sum(alarms_of_sum(one[np.isfinite(one)], limit) for one in series)
        real = sum(len(one) for one in series) / count if count else np.inf
        print(f"| {limit:g} | {normal:.0f} | {normal / 10:.0f} | {real:.0f} |")


def text(finding: Finding) -> str:
    """A finding in a table."""
    since, found = finding.since or 0, finding.found or 0
    sure = "" if finding.probability is None else f", probability {finding.probability:.3g}"
    return f"{finding.kind} since {since:.0f} s, found at {found:.0f} s: {finding.detail}{sure}"


def thresholds(found: Monitored) -> str:
    """The thresholds, and where they come from."""
    table = found.thresholds()
    lines = ["| statistic | threshold | from | hours | days between false alarms, 95 % |"]
    lines.append("|---|---|---|---|---|")
    for name, row in table.iterrows():
        span = (
            f"{row.days_lower:.2g} to {row.days_upper:.2g}" if row.days_lower > 0 else "not known"
        )
        lines.append(f"| {name} | {row.threshold:.1f} | {row.source} | {row.hours:.0f} | {span} |")
    return "\n".join(lines)


def speed(found: Monitored) -> None:
    """Prints how long a step of observer and monitor takes beside a rig."""
    monitor, observed = found.monitor, found.observed
    readings = observed.samples.readings[-1]
    with own_settings():
        state, begun = observed.state, monitor.init()
        sample = observed_sample(state, readings, readings, np.nan, np.asarray(1.0))

        @jax.jit
        def one(
            tests: Monitor, where: MonitorState, what: ObservedSample
        ) -> tuple[MonitorState, Evidence]:
            after, evidences = tests.step(where, what)
            return after, joined(evidences)

        log = FindingLog(monitor, found.calibration, found.false_alarm_time)
        durations = []
        for n in range(300):
            start = time.perf_counter()
            begun, evidence = one(monitor, begun, sample)
            log.take(float(n), evidence)
            durations.append(time.perf_counter() - start)
    print(f"\nA step of the monitor with 15 channels: {1e3 * np.median(durations[10:]):.2f} ms")


if __name__ == "__main__":
    main()
