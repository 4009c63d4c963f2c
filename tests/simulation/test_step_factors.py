"""The factors of an exponential step against their definition in decimal arithmetic."""

import math
from decimal import Decimal, localcontext

import jax.numpy as jnp
import numpy as np

from jaxtwin.simulation._exponential import step_factors

# Rates for steps of 1 s; the series for small arguments ends at 0.6.
RATES = (0.0, 1e-12, 1e-6, 1e-3, 0.01, 0.59, 0.6, 0.61, 1.2, 3.0, 30.0, 1e3, 1e6)


def phi(order: int, y: Decimal) -> Decimal:
    """phi_0 is the exponential function, phi_k(y) = (phi_{k-1}(y) - 1 / (k-1)!) / y."""
    if y == 0:
        return Decimal(1) / math.factorial(order)
    if order == 0:
        return y.exp()
    return (phi(order - 1, y) - Decimal(1) / math.factorial(order - 1)) / y


def krogstad(z: Decimal) -> dict[str, Decimal]:
    """The coefficients of ETDRK4-B, Krogstad (2005), eq. 51, for a rate times step size of z."""
    half = [phi(order, -z / 2) for order in range(3)]
    whole = [phi(order, -z) for order in range(4)]
    return {
        "half_decay": half[0],
        "half": half[1] / 2,
        "half_start": half[1] / 2 - half[2],
        "half_middle": half[2],
        "decay": whole[0],
        "whole_start": whole[1] - 2 * whole[2],
        "whole_middle": 2 * whole[2],
        "first": whole[1] - 3 * whole[2] + 4 * whole[3],
        "middle": 2 * whole[2] - 4 * whole[3],
        "last": 4 * whole[3] - whole[2],
    }


def test_factors_are_those_of_the_paper_to_rounding_for_slow_and_fast_modes(float64):
    factors = step_factors(jnp.asarray(RATES), jnp.asarray(1.0))
    with localcontext(prec=120):
        expected = [krogstad(Decimal(rate)) for rate in RATES]
    for name in expected[0]:
        exact = np.array([float(of_rate[name]) for of_rate in expected])
        # Forces count by about 1 / (1 + rate).
        error = np.abs(np.asarray(getattr(factors, name)) - exact) * (1 + np.array(RATES))
        assert error.max() < 1e-14, name
