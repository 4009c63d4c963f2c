"""Steps of any length, by the numbers of a stepper."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Stepper, Twin
from jaxtwin.simulation._stepper import variable_step

pytestmark = pytest.mark.usefixtures("float64")


class TestSteps:
    """Steps of any length by the numbers of a stepper."""

    HEAT = 0.4

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["tclab", "single-cell"])
    def test_a_step_of_a_steppers_size_is_its_step(self, name: str):
        """The second has losses that are not linear."""
        stepper = Stepper(Twin(name), 0.8)
        cells, nodes = len(stepper.system.wiring.cold), stepper.system.capacitance
        x = np.linspace(5.0, 12.0, len(nodes))
        duty, heat = jnp.full(cells, 0.6), np.zeros(len(nodes))
        heat[0] = self.HEAT
        room = float(stepper.ambient)
        expected = stepper.step(stepper.start(room + x), duty, room + 2.0, heat=heat)
        found = _after(stepper, x, duty, 2.0, heat, 0.8)
        np.testing.assert_allclose(found, np.asarray(expected.nodes) - room, rtol=0, atol=1e-9)

    def test_a_step_of_a_linear_twin_is_two_of_half_its_length(self):
        stepper = Stepper(Twin("tclab"), 1.0)
        given = jnp.array([0.6, 0.3]), 2.0, np.array([0.0, self.HEAT, 0.0, 0.0])
        x = np.array([3.0, 8.0, 1.0, 2.0])
        half = _after(stepper, x, *given, 3.5)
        twice = _after(stepper, np.asarray(half), *given, 3.5)
        np.testing.assert_allclose(_after(stepper, x, *given, 7.0), twice, rtol=0, atol=1e-9)

    @pytest.mark.parametrize("name", ["tclab", "single-cell"])
    def test_a_step_of_no_length_leaves_the_state(self, name: str):
        stepper = Stepper(Twin(name), 1.0)
        cells, nodes = len(stepper.system.wiring.cold), len(stepper.system.capacitance)
        x = np.linspace(5.0, 12.0, nodes)
        found = _after(stepper, x, jnp.full(cells, 0.6), 2.0, np.ones(nodes), 0.0)
        np.testing.assert_allclose(found, x, rtol=0, atol=1e-12)


def _after(
    stepper: Stepper, x: np.ndarray, duty: jax.Array, room: float, heat: np.ndarray, size: float
) -> np.ndarray:
    """The deviations of the nodes after a step of some length with the same duty, K."""
    modes = stepper.field.modes
    after = variable_step(
        stepper,
        modes.amplitudes(jnp.asarray(x)),
        jnp.broadcast_to(duty, (3, len(duty))),
        jnp.asarray(room),
        modes.shapes.T @ jnp.asarray(heat),
        jnp.asarray(size),
    )
    return np.asarray(modes.shapes @ after)
