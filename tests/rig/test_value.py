"""`Value`: a commutative group of products, evaluated with whatever arithmetic is handed in."""

import math

import jax
import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.rig import Value

NAMES = ("R_E", "alpha", "k")
numbers = st.floats(min_value=1e-3, max_value=1e3)
exponents = st.integers(-3, 3).map(float)
# What a value is made of. It is made in the test: the type checks on it draw random numbers, which
# hypothesis does not want where examples are made.
products = st.tuples(
    numbers, st.lists(st.tuples(st.sampled_from(NAMES), exponents), max_size=4).map(tuple)
)
parameters = st.fixed_dictionaries(dict.fromkeys(NAMES, numbers))


@given(products, products, parameters)
def test_products_and_quotients_evaluate_to_those_of_the_numbers(a, b, p):
    a, b = Value(*a), Value(*b)
    assert (a * b).evaluate(p) == pytest.approx(a.evaluate(p) * b.evaluate(p), rel=1e-12)
    assert (a / b).evaluate(p) == pytest.approx(a.evaluate(p) / b.evaluate(p), rel=1e-12)


@given(products, exponents, parameters)
def test_powers_evaluate_to_those_of_the_number(a, n, p):
    a = Value(*a)
    assert (a**n).evaluate(p) == pytest.approx(a.evaluate(p) ** n, rel=1e-9)


@given(products, products)
def test_equal_products_are_equal_and_hash_alike_in_any_order(a, b):
    a, b = Value(*a), Value(*b)
    assert a * b == b * a
    assert hash(a * b) == hash(b * a)


@given(products)
def test_a_value_times_its_inverse_is_one_without_parameters(a):
    a = Value(*a)
    ratio = a * (1 / a)
    assert ratio.is_constant
    assert ratio.factor == pytest.approx(1)


@given(products)
def test_powers_are_sorted_unique_and_never_zero(a):
    a = Value(*a)
    names = [name for name, _ in a.powers]
    assert names == sorted(set(names))
    assert all(exponent != 0 for _, exponent in a.powers)


def test_text_reads_like_the_product():
    assert str(Value(0.04)) == "0.04"
    assert str(Value(1.0, (("R_E", 1.0),))) == "R_E"
    assert str(Value(2.0, (("k", -1.0), ("R_E", 2.0)))) == "2 R_E^2 k^-1"


def test_a_missing_parameter_is_named():
    with pytest.raises(KeyError, match="R_E"):
        Value(1.0, (("R_E", 1.0),)).evaluate({})


@pytest.mark.parametrize("factor", [math.nan, math.inf])
def test_a_value_that_is_no_finite_number_is_refused(factor):
    with pytest.raises(ValueError, match="finite"):
        Value(factor)


def test_a_negative_value_has_no_fractional_power():
    with pytest.raises(ValueError, match="no real power"):
        _ = Value(-2.0) ** 0.5


@pytest.mark.parametrize("exponent", [1.0, -1.0, 2.0, 0.5])
def test_gradients_flow_through_evaluation(exponent):
    """d(3 x^n)/dx = 3 n x^(n-1)."""
    value = Value(3.0, (("x", exponent),))
    slope = jax.grad(lambda x: value.evaluate({"x": x}))(jnp.asarray(2.0))
    assert float(slope) == pytest.approx(3 * exponent * 2.0 ** (exponent - 1), rel=1e-6)


def test_a_number_divides_the_factor():
    half = Value(3.0, (("k", 1.0),)) / 2
    assert half == Value(1.5, (("k", 1.0),))
