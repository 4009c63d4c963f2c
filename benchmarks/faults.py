"""Are faults found soon and named rightly, and how often is a healthy rig called faulty?

Hours of the virtual `dual-cell` (`_virtual_hours`): the twin is that of the match to the first
halves of the three steps, the noise that of the observer's results; each rig differs from the twin
by a draw from the posterior. All 15 channels are read. A fault begins 4 minutes before the end, a
weak supply 8.

- Faults of three sizes each, watched by a monitor and by a diagnosis that looks for all usual
  suspects of the rig. Four of them are judged, and have eight runs where the others have one.
- Healthy hours, watched by the monitor.
- What the diagnosis says of the time before the fault: it watches the last 12 minutes.
- Healthy hours, watched by the diagnosis from beginning to end.
- Healthy hours of rigs from the whole posterior, watched by both. The match leaves much open that
  its recordings do not show and an hour with a random duty does.

The thresholds of the monitor come from 100 other healthy hours. Each run is a line of
`results/faults.jsonl`; the script goes on where it ended, and writes the page beside it.

    python -m benchmarks.faults FOLDER_WITH_RECORDINGS KEPT [--rounds 6] [--healthy 1000]
"""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxtwin as jt
from benchmarks._faults_page import faults_page
from benchmarks._fitted import STEPS
from benchmarks._machine import processor
from benchmarks._results import parser_of
from benchmarks._virtual_hours import (
    LASTS,
    WATCHED,
    FaultCase,
    begun,
    follow,
    hour,
    template,
    values_of_filter,
    values_of_posterior,
)
from jaxtwin._jax_settings import own_settings
from jaxtwin.diagnosis import Cause, Diagnosis, Explanation, suspected, suspects
from jaxtwin.diagnosis._causes import diagnosed
from jaxtwin.diagnosis._diagnose import learned
from jaxtwin.monitoring import (
    DAY,
    Monitor,
    MonitorCalibration,
    Monitored,
    observed_sample,
    response_of,
)
from jaxtwin.monitoring._calibrate import calibration_of_recordings
from jaxtwin.monitoring._monitor import evidences_of
from jaxtwin.observers import (
    ExtendedKalmanFilter,
    FilterSamples,
    KalmanState,
    Observed,
    ProcessNoise,
    filter_for,
)

FAULTS = {
    "contact": ("loosen", "P1", (1.2, 1.5, 2.0)),
    "dead cell": ("fail", "P1", (0.25, 0.5, 1.0)),
    "R_E": ("age", "P1", (1.15, 1.3, 1.5)),
    "supply": ("weaken", "supply", (0.95, 0.9, 0.8)),
    "gain": ("gain", "T12", (0.98, 0.95, 0.9)),
    "offset": ("offset", "T12", (0.3, 0.6, 1.2)),
    "draught": ("leak", "plate", (1.2, 1.5, 2.0)),
    "camera": ("move", "x", (5e-4, 1e-3, 2e-3)),
    "sink": ("block", "P1", (3.0, 10.0, 100.0)),
}
"""Name, model, part and three sizes of the faults."""
JUDGED = {"contact": 1.5, "dead cell": 1.0, "gain": 0.95, "supply": 0.9}
"""The faults that must be found, and of which size."""
LONGER = {"supply": 490}
"""How long some faults last, s."""
MORE = 8
"""How many runs a judged fault has where another has one."""
NOISE = ProcessNoise(
    reading=0.0611, reading_time=0.107, heat=0.324, command_time=0.296, disturbance=0.299,
    disturbance_time=58.8, room=0.003, twin=1.0, twin_time=3410.0, slow=0.05, slow_time=3600.0,
    common=0.307, common_time=41.9, jump=1.0, channel=0.22, channel_time=170.0, ambient=0.2,
)  # fmt: skip
"""The noise of `dual-cell` in the results of the observer."""
SOON = 120
"""The mean duty of the first cell, at which the faults of cells are, is that of so many seconds
after the onset."""
EARLY = 60.0
"""A cause is that of the fault if it begins no more than this before it, s."""
CALIBRATED, HEALTHY, FAULTY, DIAGNOSED, OTHER = (100_000 * number for number in range(1, 6))
"""The first seeds of the hours from which thresholds come, of healthy hours, of those with a fault,
of the healthy ones that are diagnosed, and of those of the whole posterior."""
CALIBRATION_HOURS = 100
BATCH = 20
"""The number of healthy hours in a line of the results."""
FALSE_ALARM_TIME = 30 * DAY


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("kept", type=Path, help="a folder that keeps match and thresholds")
    parser.add_argument("--rounds", type=int, default=6, help="runs of each fault and size")
    parser.add_argument("--healthy", type=int, default=1000, help="healthy hours of the monitor")
    parser.add_argument("--diagnosed", type=int, default=40, help="those of the diagnosis")
    parser.add_argument("--others", type=int, default=12, help="those of the whole posterior")
    parser.add_argument("--seed", type=int, default=0, help="added to all seeds that are judged")
    parser.add_argument(
        "--share", type=int, nargs=2, default=(0, 1), metavar=("NUMBER", "OF"),
        help="this process does one of several shares of the runs with faults",
    )  # fmt: skip
    given = parser.parse_args()
    given.kept.mkdir(exist_ok=True)
    lines = given.out / "faults.jsonl"
    watch = Watch(given.folder, given.kept)
    done = read_lines(lines)
    for number, (name, case) in enumerate(plan(given.rounds)):
        seed = FAULTY + given.seed + number
        is_mine = number % given.share[1] == given.share[0]
        if is_mine and not any(one.get("seed") == seed for one in done):
            append(lines, {"fault": name, **watch.faulty(case, seed)})
    for seed in range(DIAGNOSED + given.seed, DIAGNOSED + given.seed + given.diagnosed):
        if not any(one.get("diagnosed") == seed for one in done):
            found = watch.diagnose(watch.observed(None, seed)[0])
            append(lines, {"diagnosed": seed, "causes": [one.best.text for one in found.causes]})
    for seed in range(OTHER + given.seed, OTHER + given.seed + given.others):
        if not any(one.get("other") == seed for one in done):
            append(lines, watch.other(seed))
    for number in range(0, given.healthy, BATCH):
        first = HEALTHY + given.seed + number
        if not any(one.get("first") == first for one in done):
            append(lines, watch.healthy(first))
    page = faults_page(read_lines(lines), FAULTS, JUDGED, processor())
    lines.with_suffix(".md").write_text(page)
    print(page)


def plan(rounds: int) -> Iterator[tuple[str, FaultCase]]:
    """The faults in the order of their runs."""
    several = [
        (name, FaultCase(model, part, size, LONGER.get(name, LASTS)))
        for name, (model, part, sizes) in FAULTS.items()
        for size in sizes
    ]
    judged = [(name, case) for name, case in several if JUDGED.get(name) == case.size]
    for _ in range(rounds):
        yield from judged * MORE
        yield from (one for one in several if one not in judged)


class Watch:
    """A monitor and a diagnosis of the twin."""

    def __init__(self, folder: Path, kept: Path):
        halves = [
            one.between(None, one.time[0] + one.duration / 2)
            for one in (jt.read_recording(folder / name) for name in STEPS)
        ]
        saved = kept / "dual-cell.toml"
        if not saved.exists():
            jt.match(jt.Twin("dual-cell"), halves).save(saved)
        self.fit = jt.Fit.load(saved, experiments=halves)
        self.kalman: ExtendedKalmanFilter = filter_for(
            self.fit, template(self.fit.mean_twin), NOISE
        )
        self._thresholds = kept / "virtual-calibration.toml"

    @cached_property
    def calibration(self) -> MonitorCalibration:
        """The thresholds."""
        if not self._thresholds.exists():
            hours = range(CALIBRATED, CALIBRATED + CALIBRATION_HOURS)
            calibration_of_recordings([self.observed(None, seed)[0] for seed in hours]).save(
                self._thresholds
            )
        return MonitorCalibration.load(self._thresholds)

    @cached_property
    def monitor(self) -> Monitor:
        return Monitor(
            self.kalman, self.calibration, response_of(self.kalman), float(FALSE_ALARM_TIME)
        )

    @cached_property
    def suspects(self) -> tuple[jt.diagnosis.Suspect, ...]:
        return tuple(suspects(self.kalman.model.twin).values())

    @cached_property
    def diagnose(self) -> partial[Diagnosis]:
        return partial(
            diagnosed,
            several=self.suspects,
            arrays=suspected(self.kalman.model, self.suspects),
            prior=learned(self.suspects, []),
        )

    def faulty(self, case: FaultCase, seed: int) -> dict[str, Any]:
        """What monitor and diagnosis say of an hour with a fault."""
        began = time.process_time()
        observed, onset = self.observed(case, seed)
        alarms = self._monitored(observed).alarms
        found = self.diagnose(last_of(observed))
        times = [one.found or 0.0 for one in alarms]
        own = next((one for one in found.causes if one.onset > onset - EARLY), None)
        before = [one for one in found.causes if one.onset <= onset - EARLY]
        return {
            "model": case.model, "part": case.part, "size": case.size, "seed": seed, "onset": onset,
            "duty": round(float(observed.experiment.duty[onset : onset + SOON, 0].mean()), 3),
            "monitor_s": min((at - onset for at in times if at >= onset), default=None),
            "kinds": sorted({one.kind for one in alarms if (one.found or 0.0) >= onset}),
            "false_alarms": sum(at < onset for at in times),
            "false_causes": [one.best.text for one in before],
            "cause": None if own is None else self._said(own, case, onset),
            "cpu_s": round(time.process_time() - began, 1),
        }  # fmt: skip

    def healthy(self, first: int) -> dict[str, Any]:
        """The alarms of a monitor in some healthy hours."""
        began, largest = time.process_time(), 0.0
        alarms = []
        for seed in range(first, first + BATCH):
            recorded, _ = hour(self.kalman, values_of_filter(self.kalman, seed), None, seed)
            start, samples, _ = begun(self.kalman, recorded)
            with own_settings():
                score = float(loudest_of_hour(self.kalman, self.monitor, start, samples))
            largest = max(largest, score)
            if score >= 1:
                observed = follow(self.kalman, recorded)
                texts = [one.detail for one in self._monitored(observed).alarms]
                alarms.append({"seed": seed, "alarms": texts})
        return {
            "first": first, "hours": BATCH, "largest": largest, "alarms": alarms,
            "cpu_s": round(time.process_time() - began, 1),
        }  # fmt: skip

    def other(self, seed: int) -> dict[str, Any]:
        """What both say of a healthy hour of a rig from the whole posterior."""
        recorded, _ = hour(self.kalman, values_of_posterior(self.fit, seed), None, seed)
        observed = follow(self.kalman, recorded)
        causes = [one.best.text for one in self.diagnose(observed).causes]
        return {"other": seed, "alarms": len(self._monitored(observed).alarms), "causes": causes}

    def observed(self, case: FaultCase | None, seed: int) -> tuple[Observed, int]:
        """An hour that the filter has followed, and when its fault begins."""
        recorded, onset = hour(self.kalman, values_of_filter(self.kalman, seed), case, seed)
        return follow(self.kalman, recorded), onset

    def _monitored(self, observed: Observed) -> Monitored:
        found = evidences_of(self.monitor, observed)
        return Monitored(observed, self.monitor, self.calibration, float(FALSE_ALARM_TIME), found)

    def _said(self, cause: Cause, case: FaultCase, onset: int) -> dict[str, Any]:
        suspect = next(one for one in self.suspects if one.name == case.suspect)
        truth = case.size * suspect.none if suspect.unit == "W/K" else case.size
        own: Sequence[Explanation] = [e for e in cause.explanations if e.name == case.suspect]
        return {
            "name": cause.name, "tie": list(cause.tie), "found_s": cause.found - onset,
            "probability": cause.probability, "size": cause.size,
            "inside": bool(own and own[0].lower <= truth <= own[0].upper),
            "until_s": cause.until, "misfit": cause.misfit,
        }  # fmt: skip


def last_of(observed: Observed) -> Observed:
    """The end of an observed recording."""
    rows = slice(-WATCHED, None)
    experiment = observed.experiment
    samples, states = jax.tree.map(
        lambda leaf: np.asarray(leaf)[rows], (observed.samples, observed.filtered)
    )
    return replace(
        observed,
        experiment=experiment.between(float(experiment.time[-WATCHED]), None),
        samples=samples._replace(dt=np.where(np.arange(WATCHED) == 0, 0.0, samples.dt)),
        is_sample=observed.is_sample[rows],
        filtered=states,
    )


@jax.jit
def loudest_of_hour(
    kalman: ExtendedKalmanFilter, monitor: Monitor, start: KalmanState, samples: FilterSamples
) -> jax.Array:
    """The largest score of all tests but that of changed parameters, which is a notice."""

    def take(at: tuple[Any, Any], sample: FilterSamples) -> tuple[tuple[Any, Any], jax.Array]:
        state, watched = at
        state = kalman.step(state, sample.duty, sample.dt, sample.levels)
        expected = kalman.readings(state, sample.ambient)
        there = jax.numpy.isfinite(sample.readings)
        state = kalman.update(state, sample.readings, there, sample.ambient)
        what = observed_sample(state, expected, sample.readings, sample.ambient, sample.dt)
        watched, said = monitor.step(watched, what)
        alarms = said._replace(changed=said.sum)
        return (state, watched), jax.numpy.concatenate([one.score for one in alarms]).max()

    return jax.lax.scan(take, (start, monitor.init()), samples)[1].max()


def read_lines(file: Path) -> list[dict[str, Any]]:
    """The lines that are there."""
    return [json.loads(one) for one in file.read_text().splitlines()] if file.exists() else []


def append(file: Path, line: dict[str, Any]) -> None:
    """Adds a line."""
    with file.open("a") as opened:
        opened.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
