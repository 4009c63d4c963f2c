"""Sensitivity indices of samples and outputs."""

import numpy as np
from jaxtyping import Float


def pearson(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"]:
    """Pearson correlation of each output with each parameter; 0 where one of them is constant."""
    y = outputs - outputs.mean(axis=0)
    x = samples - samples.mean(axis=0)
    lengths = np.linalg.norm(y, axis=0)[:, None] * np.linalg.norm(x, axis=0)[None, :]
    return np.divide(y.T @ x, lengths, out=np.zeros(lengths.shape), where=lengths > 0)


def pearson_interval(
    correlation: Float[np.ndarray, "*shape"], draws: int
) -> Float[np.ndarray, "*shape 2"]:
    """95 % interval of a correlation, by Fisher's z transform; -1 to 1 below four draws."""
    if draws < 4:
        return np.stack([-np.ones_like(correlation), np.ones_like(correlation)], axis=-1)
    z = np.arctanh(np.clip(correlation, -1 + 1e-12, 1 - 1e-12))
    half = 1.959963984540054 / np.sqrt(draws - 3)
    return np.tanh(np.stack([z - half, z + half], axis=-1))
