"""Second derivatives of a twin's steps, with respect to commands, temperatures and parameters: the
derivative of a derivative, which an observer and a controller take."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Stepper, Twin

pytestmark = pytest.mark.usefixtures("float64")

STEPS = 3


def start_and_duty() -> Callable[[jax.Array], jax.Array]:
    """The readings after some steps as a function of the temperature at the start and the duty. The
    cell's heat has Joule's and Peltier's terms, the plate radiates: no second derivative is 0."""
    stepper = Stepper(Twin("single-cell"), 2.0)

    def readings(at: jax.Array) -> jax.Array:
        state = stepper.step(stepper.start(at[0] * 30.0), at[1:], steps=STEPS)
        return stepper.channels(state)

    return readings


def parameter_and_duty(name: str) -> Callable[[jax.Array], jax.Array]:
    """The same as a function of a parameter, relative, and the duty. The basis of the modes is held
    fixed, and the change of the network enters as a force. Steps are short, because differences
    contain how the error of the steps changes with the parameter, and derivatives do not."""
    twin = Twin("single-cell")
    value = float(twin.values[name])

    def readings(at: jax.Array) -> jax.Array:
        stepper = Stepper(twin.with_values({name: value * at[0]}), 0.25)
        state = stepper.step(stepper.start(30.0), at[1:], steps=8)
        return stepper.channels(state)

    return readings


AT = np.array([1.0, 0.6])


def second_differences(function: Callable[[jax.Array], jax.Array], step: float) -> np.ndarray:
    """Central differences of values alone: sum of the outputs, both arguments."""
    total = jax.jit(lambda at: function(at).sum())
    rows = np.zeros((2, 2))
    for i, j in np.ndindex(2, 2):
        a, b = np.eye(2)[i] * step, np.eye(2)[j] * step
        above = float(total(jnp.asarray(AT + a + b))) - float(total(jnp.asarray(AT + a - b)))
        below = float(total(jnp.asarray(AT - a + b))) - float(total(jnp.asarray(AT - a - b)))
        rows[i, j] = (above - below) / (4 * step**2)
    return rows


def forwards_twice(function: Callable[[jax.Array], jax.Array]) -> np.ndarray:
    """A jvp of a jacfwd along each argument."""
    first = jax.jacfwd(lambda at: function(at).sum())
    along = jax.jit(lambda of: jax.jvp(first, (jnp.asarray(AT),), (of,))[1])
    return np.stack([np.asarray(along(unit)) for unit in jnp.eye(2)])


def backwards_over_forwards(function: Callable[[jax.Array], jax.Array]) -> np.ndarray:
    """A gradient of the weighted sum of a jacfwd, for each weight."""

    def weighted(at: jax.Array, weights: jax.Array) -> jax.Array:
        return (jax.jacfwd(lambda x: function(x).sum())(at) * weights).sum()

    gradient = jax.jit(jax.grad(weighted))
    return np.stack([np.asarray(gradient(jnp.asarray(AT), unit)) for unit in jnp.eye(2)])


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [forwards_twice, backwards_over_forwards])
def test_with_respect_to_start_and_duty_they_are_those_of_differences(
    derivative: Callable[..., np.ndarray],
):
    readings = start_and_duty()
    expected = second_differences(readings, 1e-3)
    assert np.abs(expected).min() > 1e-3
    np.testing.assert_allclose(derivative(readings), expected, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "derivative",
    [pytest.param(forwards_twice, marks=pytest.mark.long), backwards_over_forwards],
)
@pytest.mark.parametrize("name", ["R_pc", pytest.param("C_side", marks=pytest.mark.long)])
def test_with_respect_to_a_parameter_and_the_duty_they_are_those_of_differences(
    name: str, derivative: Callable[..., np.ndarray]
):
    """Of a resistance and of a heat capacity, which change the modes."""
    readings = parameter_and_duty(name)
    expected = second_differences(readings, 1e-3)
    np.testing.assert_allclose(derivative(readings), expected, rtol=1e-3)
