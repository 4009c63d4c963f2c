r"""Polynomial chaos: Sobol's indices from a polynomial that approximates the twin.

The output is a sum of products of orthonormal polynomials of the parameters' probabilities
(Legendre polynomials for uniform parameters, Hermite polynomials of the normal score for others),
fitted by least squares. The squares of its coefficients are the parts of the variance (Sudret,
Reliability Engineering & System Safety 93 (2008) 964-979). Each output has the total degree with
the smallest leave-one-out error, which follows from the residuals and the diagonal of the hat
matrix (Blatman and Sudret 2011).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import comb
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from ._inputs import MIN_PROBABILITY
from ._method import AbstractPlainMethod, Design, Indices

# The largest number of terms of a polynomial; the work grows with its square.
MAX_TERMS = 2000


@final
@dataclass(frozen=True)
class PolynomialChaos(AbstractPlainMethod):
    """`S1`, `ST` and `S2` of a polynomial, its `degree`, and its `loo_error`: the mean squared
    error of its prediction of a run from the other runs, as a part of the variance.

    The indices are as accurate as the polynomial: if `loo_error` is above a few percent, use more
    draws or Sobol's method.
    """

    name = "pce"
    main = "ST"
    default_draws = 1024
    default_samples = "sobol"
    needs_independence_for = "polynomial chaos"

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        runs, count = design.unit.shape
        columns = outputs.shape[1]
        variance = outputs.var(axis=0)
        names = {"S1": (count,), "ST": (count,), "S2": (count, count)}
        result: Indices = {
            name: np.full((columns, *shape), np.nan) for name, shape in names.items()
        }
        result |= {"loo_error": np.full(columns, np.inf), "degree": np.full(columns, np.nan)}
        for degree, powers in _candidates(runs, count):
            basis = _basis(design, powers)
            directions, triangle = np.linalg.qr(basis)
            if np.abs(np.diag(triangle)).min() < 1e-8 * np.abs(np.diag(triangle)).max():
                break  # the runs do not distinguish these terms
            projected = directions.T @ outputs
            coefficients = np.linalg.solve(triangle, projected)
            leverage = np.minimum(np.sum(directions**2, axis=1), 1 - 1e-9)[:, None]
            residuals = (outputs - directions @ projected) / (1 - leverage)
            error = np.mean(residuals**2, axis=0) / variance
            better = error < result["loo_error"]
            result["loo_error"][better], result["degree"][better] = error[better], degree
            for name, index in _shares(coefficients[:, better], powers).items():
                result[name][better] = index
        result["loo_error"][np.isinf(result["loo_error"])] = np.nan
        return result


def _candidates(
    runs: int, parameters: int
) -> Iterator[tuple[int, Int[np.ndarray, "terms parameters"]]]:
    """Returns the total degrees with at most half as many terms as runs, and the powers of each
    term, the constant first."""
    degree = 1
    while comb(parameters + degree, degree) <= min(runs // 2, MAX_TERMS):
        chosen = [
            np.bincount(np.array(term, int), minlength=parameters)
            for total in range(degree + 1)
            for term in combinations_with_replacement(range(parameters), total)
        ]
        yield degree, np.stack(chosen)
        degree += 1


def _basis(
    design: Design, powers: Int[np.ndarray, "terms parameters"]
) -> Float[np.ndarray, "runs terms"]:
    """Computes the product of polynomials of each term."""
    basis = np.ones((len(design.unit), len(powers)))
    highest = int(powers.max())
    for j, marginal in enumerate(design.inputs.marginals.values()):
        is_legendre = marginal.polynomials == "legendre"
        family = (_legendre if is_legendre else _hermite)(design.unit[:, j], highest)
        basis *= family[:, powers[:, j]]
    return basis


def _legendre(unit: Float[np.ndarray, " runs"], highest: int) -> Float[np.ndarray, "runs degrees"]:
    x = 2 * unit - 1
    rows = [np.ones_like(x), x]
    for k in range(1, highest):
        rows.append(((2 * k + 1) * x * rows[k] - k * rows[k - 1]) / (k + 1))
    return np.stack([np.sqrt(2 * k + 1) * row for k, row in enumerate(rows)], axis=1)


def _hermite(unit: Float[np.ndarray, " runs"], highest: int) -> Float[np.ndarray, "runs degrees"]:
    z = ndtri(np.clip(unit, MIN_PROBABILITY, 1 - 2.0**-53))
    rows = [np.ones_like(z), z]
    for k in range(1, highest):
        rows.append((z * rows[k] - np.sqrt(k) * rows[k - 1]) / np.sqrt(k + 1))
    return np.stack(rows, axis=1)


def _shares(
    coefficients: Float[np.ndarray, "terms outputs"], powers: Int[np.ndarray, "terms parameters"]
) -> Indices:
    """The shares of the polynomial's variance."""
    squares = coefficients[1:] ** 2
    variance = squares.sum(axis=0)
    share = np.divide(squares, variance, out=np.full_like(squares, np.nan), where=variance > 0)
    acts: Bool[np.ndarray, "terms parameters"] = powers[1:] > 0
    together = acts.sum(axis=1)
    count = powers.shape[1]
    pairs = np.full((coefficients.shape[1], count, count), np.nan)
    for j in range(count):
        for k in range(j + 1, count):
            pairs[:, j, k] = share[(together == 2) & acts[:, j] & acts[:, k]].sum(axis=0)
    alone = acts & (together == 1)[:, None]
    return {"S1": share.T @ alone, "ST": share.T @ acts, "S2": pairs}
