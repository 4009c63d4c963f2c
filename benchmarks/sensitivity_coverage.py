"""How often do the intervals of a sensitivity analysis hold the correlation of very many draws?

`paper-2024` at its published values, all free parameters drawn with a standard deviation of 25 %
(as `jaxtwin.sensitivity` does), each channel's mean squared error against the authors' recordings,
or the synthetic ones where those are not on this machine. The reference are the correlations of
`--reference` draws of another seed; each of `--seeds` analyses of `--draws` draws is looked at by
itself. Pairs of a channel and a parameter are grouped by the size of the reference correlation;
`least` is the pair that is held least often.

Beside jaxtwin's intervals: Fisher's, for normal variables, and the bias-corrected and accelerated
bootstrap (Efron 1987) of 1000 resamples.

    python benchmarks/sensitivity_coverage.py --seeds 30 --draws 500 --reference 200000
"""

import argparse
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from jaxtwin import Experiment, Twin, find_recordings, load_rig, read_recording, reduce_batch
from jaxtwin.data import synthetic_recordings
from jaxtwin.errors import RecordingError
from jaxtwin.sensitivity_analysis import (
    normal_draws,
    pearson,
    pearson_interval,
    spearman,
    spearman_interval,
)
from jaxtwin.sensitivity_analysis._central_values import central_values

Pair = tuple[np.ndarray, np.ndarray]
RESAMPLES = 1000
GROUPS = ((0.2, 1.0), (0.1, 0.2), (0.0, 0.1))


def costs(twin: Twin, experiments: Sequence[Experiment], draws: int, seed: int) -> Pair:
    """Costs of every channel and their mean, and the draws."""
    samples = normal_draws(central_values(twin, None), 0.25, seed, draws)
    results = [reduce_batch(twin, experiment, samples, ["cost"]) for experiment in experiments]
    cost = np.column_stack([result.cost for result in results if result.cost is not None])
    assert not any(result.failed.any() for result in results)
    return np.column_stack([cost, cost.mean(axis=1)]), np.column_stack(list(samples.values()))


def fisher(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """For two normal variables."""
    z, half = np.arctanh(pearson(y, x)), 1.96 / np.sqrt(len(y) - 3)
    return np.tanh(np.stack([z - half, z + half], axis=-1))


def accelerated_bootstrap(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Bias-corrected and accelerated percentiles of Pearson's correlation."""
    n, rng = len(y), np.random.default_rng(0)
    y, x = ((columns - columns.mean(axis=0)) / columns.std(axis=0) for columns in (y, x))
    index = y.T @ x / n
    products = y[:, :, None] * x[:, None, :]
    influence = products - index * (y[:, :, None] ** 2 + x[:, None, :] ** 2) / 2
    acceleration = (influence**3).sum(0) / (6 * (influence**2).sum(0) ** 1.5)
    counts = rng.multinomial(n, np.full(n, 1 / n), size=RESAMPLES).astype(float) / n
    my, mx, vy, vx = counts @ y, counts @ x, counts @ y**2, counts @ x**2
    both = (counts @ products.reshape(n, -1)).reshape(RESAMPLES, *index.shape)
    again = both - my[:, :, None] * mx[:, None, :]
    again /= np.sqrt((vy - my**2)[:, :, None] * (vx - mx**2)[:, None, :])
    bias = ndtri(np.clip((again < index).mean(axis=0), 1 / RESAMPLES, 1 - 1 / RESAMPLES))
    ends = []
    for quantile in (0.025, 0.975):
        z = bias + ndtri(quantile)
        place = ndtr(bias + z / (1 - acceleration * z)) * (RESAMPLES - 1)
        rank = np.rint(place).astype(int)[None]
        ends.append(np.take_along_axis(np.sort(again, axis=0), rank, axis=0)[0])
    return np.stack(ends, axis=-1)


METHODS: dict[str, tuple[Callable, Callable]] = {
    "Pearson, Fisher": (fisher, pearson),
    "Pearson, BCa bootstrap": (accelerated_bootstrap, pearson),
    "Pearson, jaxtwin": (pearson_interval, pearson),
    "Spearman, jaxtwin": (spearman_interval, spearman),
}


def coverage(analyses: Sequence[Pair], reference: Pair) -> list[str]:
    """A line of a table for each method."""
    lines = []
    for name, (interval, index) in METHODS.items():
        truth = index(*reference)
        ends = np.array([interval(*analysis) for analysis in analyses])
        inside = (ends[..., 0] <= truth) & (truth <= ends[..., 1])
        words = [f"{name:24s}"]
        for low, high in GROUPS:
            group = (np.abs(truth) > low) & (np.abs(truth) <= high)
            if not group.any():
                continue
            shares, width = inside[:, group].mean(axis=0), np.diff(ends[:, group]).mean()
            words.append(
                f"{low:.1f} to {high:.1f}: {100 * shares.mean():3.0f} % (least "
                f"{100 * shares.min():3.0f} %, {group.sum():3d} pairs, width {width:.2f})"
            )
        lines.append("   ".join(words))
    return lines


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--reference", type=int, default=200_000)
    options = parser.parse_args()
    try:
        paths = find_recordings()
    except RecordingError:
        paths = synthetic_recordings()
    experiments = [read_recording(path) for path in paths]
    rig = load_rig("paper-2024")
    twin = Twin(rig, rig.parameter_sets["published"])
    names = ", ".join(experiment.name for experiment in experiments)
    print(f"{names}; {options.seeds} x {options.draws} draws")
    reference = costs(twin, experiments, options.reference, seed=987_654)
    analyses = [costs(twin, experiments, options.draws, seed) for seed in range(options.seeds)]
    print(*coverage(analyses, reference), sep="\n")


if __name__ == "__main__":
    main()
