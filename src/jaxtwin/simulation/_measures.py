"""How near a simulation is to a recording, over the samples that are not missing (NaN)."""

import numpy as np
from jaxtyping import Float


def fit_percent(
    recorded: Float[np.ndarray, "*shape times channels"],
    simulated: Float[np.ndarray, "*shape times channels"],
) -> Float[np.ndarray, "*shape channels"]:
    r"""NRMSE fit of each channel, %:
    $100 (1 - \lVert y - \hat y \rVert_2 / \lVert y - \bar y \rVert_2)$.

    100 is a perfect fit, 0 is what the channel's own mean would reach. NaN for a channel whose
    samples are all missing.
    """
    there = ~np.isnan(recorded)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.sum(recorded, axis=-2, keepdims=True, where=there) / there.sum(-2, keepdims=True)
        error = np.linalg.norm(np.where(there, recorded - simulated, 0.0), axis=-2)
        spread = np.linalg.norm(np.where(there, recorded - mean, 0.0), axis=-2)
        return 100 * (1 - error / spread)


def rmse(recorded: Float[np.ndarray, "*shape"], simulated: Float[np.ndarray, "*shape"]) -> float:
    """Root of the mean squared error over all samples and channels, K."""
    return float(np.sqrt(np.mean((recorded - simulated) ** 2, where=~np.isnan(recorded))))
