"""How near a simulation is to a recording, over the samples that are not missing (NaN)."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float


def fit_percent(
    recorded: Float[np.ndarray, "*shape times channels"],
    simulated: Float[np.ndarray, "*shape times channels"],
) -> Float[np.ndarray, "*shape channels"]:
    r"""NRMSE fit of each channel, %:
    $100 (1 - \lVert y - \hat y \rVert_2 / \lVert y - \bar y \rVert_2)$.

    100 is a perfect fit, 0 is what the channel's own mean would reach; NaN for a channel that never
    changes, or whose samples are all missing: the measure says nothing of it.
    """
    there = ~np.isnan(recorded)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.sum(recorded, axis=-2, keepdims=True, where=there) / there.sum(-2, keepdims=True)
        error = np.linalg.norm(np.where(there, recorded - simulated, 0.0), axis=-2)
        scatter = np.linalg.norm(np.where(there, recorded - mean, 0.0), axis=-2)
        # Rounding: the mean of equal numbers may be beside them.
        first = np.where(there, recorded, -np.inf).max(axis=-2)
        constant = first == np.where(there, recorded, np.inf).min(axis=-2)
        return 100 * (1 - error / np.where(constant, np.nan, scatter))


def mean_fit_percent(fits: Iterable[float]) -> float:
    """Mean of the fits of several channels, %, without the constant ones; NaN where all are."""
    defined = [fit for fit in fits if not np.isnan(fit)]
    return float(np.mean(defined)) if defined else float("nan")


def fit_text(percent: float, unit: str = "") -> str:
    """A channel's fit for tables and pictures; a word where it never changes and has none."""
    return "constant" if np.isnan(percent) else f"{percent:.1f}{unit}"


def rmse(recorded: Float[np.ndarray, "*shape"], simulated: Float[np.ndarray, "*shape"]) -> float:
    """Root of the mean squared error over all samples and channels, K."""
    return float(np.sqrt(np.mean((recorded - simulated) ** 2, where=~np.isnan(recorded))))
