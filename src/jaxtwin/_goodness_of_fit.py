"""Measures of the agreement between a simulation and a recording. Missing samples (NaN) are left
out."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float


def fit_percent(
    recorded: Float[np.ndarray, "*shape times channels"],
    simulated: Float[np.ndarray, "*shape times channels"],
) -> Float[np.ndarray, "*shape channels"]:
    r"""NRMSE fit of each channel, %:
    $100 (1 - \lVert y - \hat y \rVert_2 / \lVert y - \bar y \rVert_2)$.

    100 is a perfect fit, and 0 is the fit of a constant prediction, the channel's mean. The fit is
    NaN for a channel that never changes or whose samples are all missing, for which it is not
    defined.
    """
    there = ~np.isnan(recorded)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.sum(recorded, axis=-2, keepdims=True, where=there) / there.sum(-2, keepdims=True)
        error = np.linalg.norm(np.where(there, recorded - simulated, 0.0), axis=-2)
        scatter = np.linalg.norm(np.where(there, recorded - mean, 0.0), axis=-2)
        # Because of rounding, the mean of equal numbers may differ from them.
        first = np.where(there, recorded, -np.inf).max(axis=-2)
        constant = first == np.where(there, recorded, np.inf).min(axis=-2)
        return 100 * (1 - error / np.where(constant, np.nan, scatter))


def mean_fit_percent(fits: Iterable[float]) -> float:
    """Mean of the fits of several channels, %, without constant ones; NaN if all are constant."""
    defined = [fit for fit in fits if not np.isnan(fit)]
    return float(np.mean(defined)) if defined else float("nan")


def fit_text(percent: float, unit: str = "") -> str:
    """A channel's fit for tables and pictures; a word for a constant channel, which has no fit."""
    return "constant" if np.isnan(percent) else f"{percent:.1f}{unit}"


def rmse(recorded: Float[np.ndarray, "*shape"], simulated: Float[np.ndarray, "*shape"]) -> float:
    """Root of the mean squared error over all samples and channels, K."""
    return float(np.sqrt(np.mean((recorded - simulated) ** 2, where=~np.isnan(recorded))))
