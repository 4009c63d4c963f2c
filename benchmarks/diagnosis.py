"""Which faults does a diagnosis name, how soon, and with what size?

- `dual-cell`, virtual, as in `benchmarks.monitor`: the match to the first halves of the three
  steps, twins drawn in the directions in which it is uncertain, 15 channels with errors of their
  own, noise, corrections of the camera, another room, a random duty; a fault after 15 minutes,
  which lasts until the end of the run, 400 s later. All usual suspects of the rig are looked for.
- A heated box (`incubator/`), whose lid was opened twice in one of three recordings, if `--box`
  names its rig file: match, noise and what is healthy from the two others.

    python -m benchmarks.diagnosis FOLDER_WITH_RECORDINGS [--runs 6] [--box box.toml] [--fits KEPT]
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

import jaxtwin as jt
from benchmarks._machine import processor
from benchmarks.monitor import LENGTH, ONSET, STEPS, fitted, follow, recording, template
from jaxtwin.diagnosis import Cause, Diagnosis, suspects
from jaxtwin.diagnosis._causes import diagnosed
from jaxtwin.diagnosis._diagnose import learned
from jaxtwin.diagnosis._signatures import suspected
from jaxtwin.observers._observe import filter_for

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

EARLY = 60.0
"""A cause is that of the fault if it begins no more than this before it, s."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=6, help="runs of each fault and size")
    parser.add_argument("--healthy", type=int, default=20, help="healthy runs")
    parser.add_argument("--fits", type=Path, help="a folder that keeps fits and noise")
    parser.add_argument("--box", type=Path, help="the rig file of the heated box")
    parser.add_argument("--only", nargs="+", choices=list(FAULTS), help="some of the faults")
    parser.add_argument("--real-only", action="store_true", help="no virtual rig")
    given = parser.parse_args()
    print(f"{processor()}\n")
    if given.fits is not None:
        given.fits.mkdir(exist_ok=True)
    if given.box is not None:
        box(given.folder / "incubator", given.box, given.fits)
    if not given.real_only:
        halves = [
            one.between(None, one.time[0] + one.duration / 2)
            for one in (jt.read_recording(given.folder / name) for name in STEPS)
        ]
        virtual(*fitted("dual-cell", halves, (), given.fits), given.runs, given.healthy, given.only)


def virtual(
    fit: jt.Fit, noise: jt.ProcessNoise, runs: int, healthy: int, only: list[str] | None
) -> None:
    """Faults of the virtual two-cell rig."""
    kalman = filter_for(fit, template(fit.mean_twin), noise)
    several = tuple(suspects(kalman.model.twin).values())
    arrays, prior = suspected(kalman.model, several), learned(several, [])

    def judge(fault: tuple[str, str, float] | None, seed: int) -> Diagnosis:
        observed = follow(kalman, recording(kalman, fault, seed))
        return diagnosed(observed, several, arrays, prior)

    wrong = [judge(None, 30_000 + n) for n in range(healthy)]
    false = sum(bool(one.causes) for one in wrong)
    print(f"## The virtual two-cell rig\n\n{len(several)} suspects, {runs} runs of each fault.")
    print(f"{healthy} healthy runs, {healthy * LENGTH / 3600:.1f} hours: {false} with a cause.\n")
    print(
        "| fault | size | found | within 120 s | median delay, s | named | tied | size in its band "
        "| named as |\n|---|---|---|---|---|---|---|---|---|",
        flush=True,
    )
    confused: dict[str, Counter[str]] = {}
    for place, (name, (model, part, sizes)) in enumerate(FAULTS.items()):
        if only is not None and name not in only:
            continue
        confused[name] = Counter()
        for number, size in enumerate(sizes):
            first = 40_000 + 1000 * place + 100 * number
            causes = [_own(judge((model, part, size), first + n)) for n in range(runs)]
            truth = f"{model} {part}"
            _row(name, truth, _of_suspect(several, truth, size), size, causes)
            confused[name].update("healthy" if one is None else one.name for one in causes)
    _matrix(confused)


def _own(found: Diagnosis) -> Cause | None:
    """The first cause that is not before the fault."""
    return next((one for one in found.causes if one.onset > ONSET - EARLY), None)


def _of_suspect(several: tuple, truth: str, size: float) -> float:
    """The size of a fault in the unit of its suspect."""
    suspect = next(one for one in several if one.name == truth)
    return size * suspect.none if suspect.unit == "W/K" else size


def _row(name: str, truth: str, expected: float, size: float, causes: list[Cause | None]) -> None:
    known = [one for one in causes if one is not None]
    delays = np.array([np.inf if one is None else one.found - ONSET for one in causes])
    named = np.mean([one is not None and one.name == truth for one in causes])
    tied = np.mean([one is not None and one.name != truth and truth in one.tie for one in causes])
    own = [e for one in known for e in one.explanations if e.name == truth and truth in one.tie]
    inside = sum(e.lower <= expected <= e.upper for e in own)
    names = Counter(one.name for one in known).most_common(3)
    print(
        f"| {name} | {size:g} | {100 * len(known) / len(causes):.0f} % | "
        f"{100 * (delays <= 120).mean():.0f} % | {np.median(delays):.0f} | {100 * named:.0f} % | "
        f"{100 * tied:.0f} % | {inside} of {len(own)} | "
        f"{', '.join(f'{one} {count}' for one, count in names)} |",
        flush=True,
    )


def _matrix(confused: dict[str, Counter[str]]) -> None:
    names = list(dict.fromkeys(one for row in confused.values() for one in row))
    print("\nWhat the likeliest explanation was, of all sizes together:\n")
    print(f"| | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for name, row in confused.items():
        print(f"| {name} | {' | '.join(str(row[one] or '') for one in names)} |")


def box(folder: Path, rig_file: Path, kept: Path | None) -> None:
    """The heated box: its lid was opened at 659.3 and 1220.3 s and closed at 719.3 and 1286.3 s."""
    rig = jt.load_rig(rig_file)
    runs = {
        name: _while_fan_runs(folder, name, rig) for name in ("f24-semi", "ctl-exp2", "lid-jan")
    }
    known = [runs["f24-semi"], runs["ctl-exp2"]]
    fit, noise = fitted("incubator", known, (), kept, rig)
    print("## A heated box\n")
    for one in runs.values():
        found = jt.diagnose(fit, one, noise=noise, healthy=known)
        print(found.summary(), flush=True)
    print()


def _while_fan_runs(folder: Path, name: str, rig: jt.Rig) -> jt.Experiment:
    """A recording while the fan ran; without it the box is another device."""
    fan = np.genfromtxt(folder / f"{name}.fan.csv", delimiter=",", names=True)
    time = fan["time_s"][fan["fan"] > 0]
    return jt.read_recording(folder / f"{name}.csv", rig=rig).between(time[0], time[-1])


if __name__ == "__main__":
    main()
