"""Values evaluated all at once agree with values evaluated one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin.physics._expressions import Expressions
from jaxtwin.rig import Value

NAMES = ("a", "b", "c")
powers = st.lists(
    st.tuples(st.sampled_from(NAMES), st.sampled_from([-2, -1, 0.5, 1, 2])), max_size=3
)
# Factors of the size that rig files may have, in SI units: XLA flushes subnormal products to 0.
sizes = st.floats(1e-30, 1e30)
values = st.tuples(st.one_of(st.just(0.0), sizes, sizes.map(lambda size: -size)), powers)
sums = st.lists(st.lists(values, max_size=3), min_size=1, max_size=5)
parameters = st.fixed_dictionaries(dict.fromkeys(NAMES, st.floats(0.5, 2)))


@settings(max_examples=30)
@given(sums, parameters)
def test_equals_the_sum_of_single_values(sums, parameters):
    sums = [[Value(factor, tuple(powers)) for factor, powers in terms] for terms in sums]
    expected = [sum(value.evaluate(parameters) for value in terms) for terms in sums]
    scale = [sum(abs(value.evaluate(parameters)) for value in terms) for terms in sums]
    with jax.enable_x64(True):
        found = Expressions(sums)({name: jnp.asarray(p) for name, p in parameters.items()})
        error = np.abs(np.asarray(found) - expected)
    assert (error <= 1e-13 * np.array(scale)).all()


def test_equal_products_share_a_column():
    """However many links a parameter stands in, it is raised to its power once."""
    resistance = Value(1.0, (("R", 1),))
    expressions = Expressions([[resistance * factor, Value(factor)] for factor in (1.0, 2.0, 3.0)])
    assert expressions.factors.tolist() == [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]


def test_slope_is_that_of_the_product(float64):
    """d(3 a b^2)/db = 6 a b, by hand."""
    expressions = Expressions([[Value(3.0, (("a", 1), ("b", 2)))]])
    slope = jax.grad(lambda b: expressions({"a": jnp.asarray(0.5), "b": b})[0])(4.0)
    assert float(slope) == pytest.approx(12.0)


def test_nothing_to_evaluate_gives_zeros():
    assert Expressions([[], []])({}).tolist() == [0.0, 0.0]
