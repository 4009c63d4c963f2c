"""Are the intervals of a match honest? Synthetic recordings of known truth, matched in one batch.

Each recording has the sensor's noise, noise that stays for half a minute, and a camera with an
offset, a slow drift and corrections. For every parameter: in how many of the recordings the 95 %
interval holds the truth. The true values of a recording, and what its camera adds, are drawn from
what the rig file says beforehand, as intervals beside priors mean; parameters that the recordings
cannot tell must be flagged as such.

With `--steady-camera` it has corrections alone: the intervals then allow for an offset and a drift
that are not there, and those of the temperatures are too wide.

    python benchmarks/coverage.py --recordings 200
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from jaxtwin import Experiment, Fit, Twin, match_many, simulate_batch

FREE = ("h_A", "R_pc1_row2", "C_side", "R_sink2", "g_T11", "g_T12", "T_amb", "T_start")
CHANNELS = ("T11", "T12", "T21", "T22", "TAM")
SENSOR, CREEP, JUMP = 0.1, 0.05, 1.0
"""Standard deviations, K: of the sensor, of noise with a memory of 20 s, of a correction."""


def synthetic(
    twin: Twin, count: int, seed: int, steady: bool = False
) -> tuple[list[Experiment], dict[str, np.ndarray]]:
    """Recordings and the true values of each."""
    rng = np.random.default_rng(seed)
    drive = Experiment.schedule("0:0.5,300:0.8", duration=600, step=2.0, cells=2, channels=CHANNELS)
    truth = {}
    for name in FREE:
        row = twin.rig.parameters[name]
        assert row.prior_value is not None
        assert row.prior_spread is not None
        normal = np.clip(rng.standard_normal(count), -2, 2) * row.prior_spread
        truth[name] = row.prior_value * np.exp(normal) if row.is_logarithmic else normal + row.value
    seen = simulate_batch(twin, drive, truth)
    seen += SENSOR * rng.standard_normal(seen.shape)
    memory = np.exp(-2.0 / 20.0)
    shocks = np.sqrt(1 - memory**2) * rng.standard_normal(seen.shape)
    seen += CREEP * np.asarray(lfilter([1.0], [1, -memory], shocks, axis=1))
    for number in range(count):
        for event in 40 + rng.uniform(0, 100) + 164.0 * np.arange(4):
            late = np.maximum(drive.time - event, 0)
            fading = np.where(drive.time >= event, np.exp(-late / 25), 0)
            seen[number] += JUMP * rng.standard_normal() * fading[:, None]
    camera = twin.rig.common_error
    assert camera is not None
    if not steady:
        corners = np.arange(0, drive.time[-1] + camera.drift_time, camera.drift_time)
        for number in range(count):
            drift = camera.drift * rng.standard_normal(len(corners))
            added = camera.offset * rng.standard_normal() + np.interp(drive.time, corners, drift)
            seen[number] += added[:, None]
    experiments = [
        Experiment(
            drive.time, drive.duty, channels=CHANNELS, temperatures=temperatures, name=f"{number}"
        )
        for number, temperatures in enumerate(seen)
    ]
    return experiments, truth


def coverage(fits: Sequence[Fit], truth: dict[str, np.ndarray]) -> dict[str, tuple[float, float]]:
    """Name -> share of the fits whose 95 % interval holds the truth, and share that were flagged
    as told by the prior only."""
    result = {}
    for name, values in truth.items():
        inside, flagged = [], []
        for fit, value in zip(fits, values, strict=True):
            row = fit[name]
            entry = [label.split("[")[0] for label in fit.uncertainty.labels].index(name)
            spread = np.sqrt(fit.uncertainty.vector_covariance[entry, entry])
            at = np.log(row.value / value) if row.is_logarithmic else row.value - value
            inside.append(abs(at) < 1.96 * spread)
            flagged.append(row.prior_to_data_ratio < 1)
        result[name] = (float(np.mean(inside)), float(np.mean(flagged)))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steady-camera", action="store_true")
    options = parser.parse_args()
    twin = Twin("dual-cell")
    experiments, truth = synthetic(twin, options.recordings, options.seed, options.steady_camera)
    began, work = time.perf_counter(), time.process_time()
    fits = match_many(twin, [[experiment] for experiment in experiments], free=FREE)
    wall, work = time.perf_counter() - began, time.process_time() - work
    kept = [number for number, fit in enumerate(fits) if fit is not None]
    print(
        f"{len(fits)} recordings in {wall:.1f} s ({work:.1f} s of CPU time, with compilation), "
        f"{len(fits) - len(kept)} of them without a fit"
    )
    print("| parameter | 95 % interval holds the truth | told by the prior only |")
    print("|---|---:|---:|")
    truth = {name: values[kept] for name, values in truth.items()}
    found = [fit for fit in fits if fit is not None]
    for name, (inside, flagged) in coverage(found, truth).items():
        print(f"| {name} | {100 * inside:.1f} % | {100 * flagged:.0f} % |")


if __name__ == "__main__":
    main()
