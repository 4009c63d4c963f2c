"""The twin in open loop: a pure observer of gain zero."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin
from jaxtwin.observers import OpenLoop
from jaxtwin.simulation import simulate


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="module")
def observer(twin: Twin) -> OpenLoop:
    with jax.enable_x64(True):
        return OpenLoop(twin)


@pytest.mark.slow
def test_it_predicts_what_the_twin_simulates(twin: Twin, observer: OpenLoop):
    """At times between its steps it stands at the last one, 0.1 s behind at most."""
    drive = Experiment.schedule("0:0.5,20:-0.3/0.4", duration=40, cells=2)
    expected = simulate(twin, drive).temperatures
    with jax.enable_x64(True):
        predict = eqx.filter_jit(observer.predict)
        state = observer.init(None, np.zeros(2))
        room = observer.stepper.ambient
        for second in range(40):
            for part in (0.25, 0.5, 0.25):
                state = predict(state, drive.duty[second], room, part)
            seen = np.asarray(observer.readings(state, room))
            np.testing.assert_allclose(seen, expected[second + 1], atol=0.06)
        assert float(np.asarray(state.rest)) < 0.1


def test_readings_correct_nothing(observer: OpenLoop):
    with jax.enable_x64(True):
        state = observer.init(20.0, np.zeros(2))
        seen = np.full(15, np.nan)
        after = observer.update(state, seen, np.zeros(15, bool), np.asarray(16.0))
    for a, b in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(a, b)


def test_many_states_run_side_by_side(observer: OpenLoop):
    with jax.enable_x64(True):
        starts = jnp.array([10.0, 20.0, 30.0])
        rooms = jnp.array([10.0, 16.0, 16.0])
        duty = jnp.array([[0.0, 0.0], [0.5, 0.0], [0.0, -0.5]])

        def run(start: jax.Array, room: jax.Array, duty: jax.Array) -> jax.Array:
            state = observer.predict(observer.init(start, jnp.zeros(2)), duty, room, 30.0)
            return observer.readings(state, room)

        together = jax.jit(jax.vmap(run))(starts, rooms, duty)
        alone = [run(*row) for row in zip(starts, rooms, duty, strict=True)]
    np.testing.assert_allclose(together, np.stack(alone), atol=1e-9)
    assert np.abs(np.asarray(together)[0] - 10.0).max() < 1e-3
