"""Default settings against scipy's Radau at a relative tolerance of 1e-10 on `Circuit`.

The two share no code: the circuit is built in conftest.py from the authors' model file.
Start-up values: every node, the cells' sides too. Table 4's final values (0.01 ohm, a cell side
that settles in a millisecond and swings by 400 K): every node of the plate, so every channel.
"""

import numpy as np
import pytest

from jaxtwin import Experiment

LIMIT = 1e-3  # K
NODES = {"startup": slice(None), "published": slice(0, 24)}
VALUES = pytest.mark.parametrize("values", NODES)


def random_duty(spans: int, held: int, seed: int) -> np.ndarray:
    """Both cells on their own, -1 to 1, held for some samples each."""
    duty = np.random.default_rng(seed).uniform(-1, 1, (spans, 2)).repeat(held, axis=0)
    return np.vstack([duty, duty[-1:]])


def largest_error(circuit, twin, experiment, nodes, **air) -> float:
    run = twin.simulate(experiment)
    expected = circuit.solve(experiment.time, experiment.duty, **air)
    assert run.nodes == tuple(circuit.nodes)
    return np.abs(run.states - expected)[:, nodes].max()


@pytest.mark.slow
@VALUES
@pytest.mark.parametrize("factor", [1.0, 0.0, -1.0], ids=["steps", "zero power", "reversed"])
def test_step_recordings_inputs(values, factor, circuits, twins, paper_steps):
    experiment = Experiment(paper_steps.time, factor * paper_steps.duty)
    assert largest_error(circuits[values], twins[values], experiment, NODES[values]) < LIMIT


def test_one_cell_heats_while_the_other_cools(circuits, twins, paper_steps):
    experiment = Experiment(paper_steps.time, paper_steps.duty * [1.2, -0.4])
    assert largest_error(circuits["startup"], twins["startup"], experiment, slice(None)) < LIMIT


@pytest.mark.slow
@VALUES
def test_random_duty_every_ten_seconds(values, circuits, twins):
    experiment = Experiment(np.arange(301.0), random_duty(30, 10, seed=1))
    assert largest_error(circuits[values], twins[values], experiment, NODES[values]) < LIMIT


@pytest.mark.slow
def test_random_duty_and_ambient_every_second(circuits, twins):
    """Every sample is an input change; the recorded ambient takes the place of the rig's."""
    time = np.arange(61.0)
    ambient = 15 + np.random.default_rng(2).normal(0, 3, time.size)
    experiment = Experiment(time, random_duty(60, 1, seed=3), ambient=ambient)
    error = largest_error(
        circuits["startup"], twins["startup"], experiment, slice(None), ambient=ambient
    )
    assert error < LIMIT


@pytest.mark.slow
def test_jittered_times_that_do_not_start_at_zero(circuits, twins):
    """Samples at odd times, switches between them on odd times too."""
    rng = np.random.default_rng(4)
    time = 1234.5 + np.cumsum(rng.uniform(0.6, 1.4, 121))
    experiment = Experiment(time, random_duty(6, 20, seed=5))
    assert largest_error(circuits["startup"], twins["startup"], experiment, slice(None)) < LIMIT
