"""Rigs that are matched to a part of their recordings, with the noise that their observer takes."""

import time
from collections.abc import Sequence
from pathlib import Path

import jaxtwin as jt

MATCHED = (1, 2, 3, 4)
"""The sessions of `single-cell` that match and noise see."""

STEPS = tuple(f"peltierMIMOStepSec{zone}.mat" for zone in "ABC")
"""The recordings of `dual-cell`; match and noise see their first halves."""


def single_cell_sessions(folder: Path) -> dict[int, jt.Experiment]:
    """All sessions, by their number."""
    return {
        int(file.stem.removeprefix("BMData").split("_")[0]): jt.read_recording(file)
        for file in sorted((folder / "single-cell").glob("BMData*.mat"))
    }


def fitted(
    name: str,
    experiments: Sequence[jt.Experiment],
    names: Sequence[str],
    kept: Path | None,
    rig: jt.Rig | None = None,
) -> tuple[jt.Fit, jt.ProcessNoise]:
    """The match and its noise; both are kept in a folder, if one is given. Prints the noise, and
    how long its estimate took."""
    if kept is not None:
        kept.mkdir(exist_ok=True)
        if (kept / f"{name}.toml").exists():
            fit = jt.Fit.load(kept / f"{name}.toml", rig=rig, experiments=experiments)
            return fit, jt.ProcessNoise.load(kept / f"{name}-noise.toml")
    fit = jt.match(jt.Twin(name if rig is None else rig), experiments)
    start, cpu = time.perf_counter(), time.process_time()
    noise = jt.estimate_noise(fit, experiments, names=names)
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    levels = ", ".join(f"{key} {level:.3g}" for key, level in noise.levels().items())
    print(f"<!-- noise of {name}: {levels}; {wall:.0f} s, CPU {cpu:.0f} s -->", flush=True)
    if kept is not None:
        fit.save(kept / f"{name}.toml")
        noise.save(kept / f"{name}-noise.toml")
    return fit, noise
