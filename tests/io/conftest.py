"""Recordings like the authors', made here, so that no test needs theirs."""

import numpy as np
import pytest

from jaxtwin.io import Experiment

ROWS = 40


@pytest.fixture(scope="session")
def two_cell_simout() -> np.ndarray:
    """`simout` of the two-cell rig: column c holds numbers that tell it from the others."""
    simout = np.empty((ROWS, 11))
    for column in range(11):
        simout[:, column] = 20 + column + 0.01 * np.arange(ROWS)
    simout[:, 0] = 253.5 - np.arange(ROWS)  # an unused controller output, partly out of range
    simout[:, 2] = np.arange(ROWS)
    simout[:, 9] = np.where(np.arange(ROWS) < 20, 128, 200)
    simout[:, 10] = np.where(np.arange(ROWS) < 30, 0, 255)
    return simout


@pytest.fixture(scope="session")
def one_cell_simout() -> np.ndarray:
    """`simout` of the one-cell rig: drive, temperature, time, set point."""
    k = np.arange(ROWS)
    return np.stack([255 * np.sin(k), 20 + 0.1 * k, k, np.full(ROWS, 23.0)], axis=1)


@pytest.fixture(scope="session")
def experiment() -> Experiment:
    """Two cells, three channels and an ambient that drifts, with numbers that need all digits."""
    k = np.arange(ROWS)
    return Experiment(
        k + 0.1,
        np.stack([np.sin(k), np.cos(k)], axis=1),
        channels=("T12", "T11", "TAM"),
        temperatures=20 + np.sqrt(k[:, None] + [1, 2, 3]),
        ambient=15 + k / 300,
        name="made here",
    )
