"""Parameters are compared with the recordings of the match by Student's distribution."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from faulty_runs import bench

from jaxtwin.monitoring import ObservedSample, Reference
from jaxtwin.monitoring._monitor import AVERAGING_SECONDS, LEVEL, PERSISTENT, ShiftTest
from jaxtwin.observers import ProcessNoise, live_observer

pytestmark = pytest.mark.usefixtures("float64")
KNOWN = Reference(mean=0.02, spread=0.03, recordings=4)


@pytest.fixture(scope="module")
def model() -> Any:
    noise = ProcessNoise(names=("P_1",))
    return live_observer(bench(), noise).model


def stepped(test: ShiftTest, model: Any, change: float, seconds: int):
    """The evidence after some time with a constant change of the logarithm of the parameter."""
    mean = np.zeros(model.layout.size)
    assert model.directions is not None
    mean[model.layout.of("values")] = change / model.directions.matrix[0, 0]
    none = np.zeros(2)
    sample = ObservedSample(none, none, none, mean, none, none, np.nan, 1.0)
    state = test.init()
    for n in range(seconds // 10):
        state, found = test.step(state, sample, jnp.asarray(10.0), jnp.asarray(n > 0))
    return found  # pyright: ignore[reportPossiblyUnboundVariable]


def test_the_difference_that_counts_is_that_of_student(model: Any):
    test = ShiftTest(model, {"P_1": KNOWN})
    quantile = scipy.stats.t.isf(LEVEL / 2, 3)
    assert test.unlike[0] == pytest.approx(quantile * 0.03 * math.sqrt(1.25))
    chance = 2 * scipy.stats.t.sf(0.2 / (0.03 * math.sqrt(1.25)), 3)
    assert test.probability(0, math.expm1(0.2)) == pytest.approx(1 - chance)
    at_limit = math.expm1(float(test.unlike[0]))
    assert test.probability(0, at_limit) == pytest.approx(1 - LEVEL)


def test_without_recordings_the_spread_is_that_of_the_noise(model: Any):
    for known in ({}, {"P_1": Reference(0.0, 0.0, 1)}):
        test = ShiftTest(model, known)
        slow = float(np.asarray(model.noise.slow))
        assert model.directions is not None
        spread = slow * float(model.directions.matrix[0, 0])
        assert test.unlike[0] == pytest.approx(scipy.stats.norm.isf(LEVEL / 2) * spread)


def test_a_change_counts_when_it_has_lasted(model: Any):
    test = ShiftTest(model, {"P_1": KNOWN})
    short = stepped(test, model, 0.2, int(PERSISTENT / 2))
    assert 0 < float(short.score[0]) < 1
    found = stepped(test, model, 0.2, int(PERSISTENT + 60))
    assert float(found.score[0]) >= 1
    # The limit of how far a parameter may change is smooth: it takes a little off.
    assert float(found.size[0]) == pytest.approx(math.expm1(0.2 - KNOWN.mean), rel=0.05)


def test_a_parameter_as_in_the_match_is_not_changed(model: Any):
    test = ShiftTest(model, {"P_1": KNOWN})
    assert float(stepped(test, model, 0.05, int(AVERAGING_SECONDS + PERSISTENT)).score[0]) == 0
