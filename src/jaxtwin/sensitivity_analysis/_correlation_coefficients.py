"""Correlation coefficients of outputs with the parameters of their draws."""

import numpy as np
from jaxtyping import Float


def pearson(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"]:
    """Computes the Pearson correlation of each output with each parameter; it is 0 if the output or
    the parameter is constant."""
    return standardised(outputs).T @ standardised(samples) / len(samples)


def spearman(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"]:
    """Computes the Spearman rank correlation of each output with each parameter; it is 0 if the
    output or the parameter is constant."""
    return pearson(ranks(outputs), ranks(samples))


def ranks(values: Float[np.ndarray, "draws columns"]) -> Float[np.ndarray, "draws columns"]:
    """Computes the ranks in each column, from 0 to 1; equal values share their mean rank."""
    order = np.argsort(values, axis=0)
    places = [  # found faster in the order of the columns themselves
        np.searchsorted(column, column, "left") + np.searchsorted(column, column, "right")
        for column in np.take_along_axis(values, order, axis=0).T
    ]
    result = np.empty(values.shape)
    np.put_along_axis(result, order, np.stack(places, axis=1) / (2 * len(values)), axis=0)
    return result


def standardised(
    values: Float[np.ndarray, "draws columns"],
) -> Float[np.ndarray, "draws columns"]:
    """Scales columns to mean 0 and standard deviation 1; constant columns become 0."""
    centred = np.where(np.ptp(values, axis=0) > 0, values - values.mean(axis=0), 0.0)
    scale = np.sqrt(np.mean(centred**2, axis=0))
    return np.divide(centred, scale, out=np.zeros_like(centred), where=scale > 0)
