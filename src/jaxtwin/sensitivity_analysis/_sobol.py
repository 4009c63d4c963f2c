r"""Sobol's indices: the part of an output's variance that is due to a parameter alone (first
order), or with its interactions (total).

The runs are two independent samples A and B, and for each parameter a third sample $A_B^{(j)}$,
which is A with that parameter from B (Saltelli and others, Computer Physics Communications 181
(2010) 259-270):

$$S_j = \frac{\overline{f(B) (f(A_B^{(j)}) - f(A))}}{V}, \qquad
S_{Tj} = \frac{\overline{(f(A) - f(A_B^{(j)}))^2}}{2 V}$$

The first is Saltelli's estimator, the second Jansen's. Interactions of two parameters need a fourth
sample, $B_A^{(j)}$ (Saltelli, Computer Physics Communications 145 (2002) 280-297). Outputs are
centred beforehand, as in Sobol' and others (2007). Estimators, samples and their order are those of
SALib 1.6.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._inputs import Inputs
from ._method import AbstractMethod, Design, Indices, half_width, resample_weights
from ._sampling import SampleKind, unit_samples


@final
@dataclass(frozen=True)
class Sobol(AbstractMethod):
    """First, total and second order indices: `S1`, `ST`, `S2`, with `S1_conf` and so on, half of
    their 95 % bootstrap intervals over base samples.

    **Arguments:**

    - `second_order`: whether to estimate `S2` too, which takes 2 d + 2 runs for each draw instead
      of d + 2.
    """

    second_order: bool = False

    name = "sobol"
    main = "ST"
    default_draws = 1024
    default_samples = "sobol"

    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        inputs.check_independent("Sobol's indices")
        count = len(inputs.names)
        base = unit_samples(samples, draws, 2 * count, seed)
        a, b = base[:, None, :count], base[:, None, count:]
        each = np.arange(count)
        from_b = np.broadcast_to(a, (draws, count, count)).copy()
        from_b[:, each, each] = b[:, 0]
        parts = [a, from_b]
        if self.second_order:
            from_a = np.broadcast_to(b, (draws, count, count)).copy()
            from_a[:, each, each] = a[:, 0]
            parts.append(from_a)
        rows = np.concatenate([*parts, b], axis=1)
        return Design(inputs, rows.reshape(-1, count), rows.shape[1])

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        rows = ((outputs - outputs.mean(axis=0)) / outputs.std(axis=0)).reshape(
            design.blocks, design.block, -1
        )
        count = design.unit.shape[1]
        weights = resample_weights(design.blocks, seed)
        a, from_b, b = rows[:, 0], rows[:, 1 : count + 1], rows[:, -1]
        moments = np.stack([(a + b) / 2, (a**2 + b**2) / 2])
        first = b[:, None] * (from_b - a[:, None])
        total = (a[:, None] - from_b) ** 2 / 2

        def shares(
            products: Float[np.ndarray, "blocks *parameters outputs"],
        ) -> tuple[
            Float[np.ndarray, "*parameters outputs"],
            Float[np.ndarray, "resamples *parameters outputs"],
        ]:
            """The shares of the variance: with all blocks, and in each resample."""
            between = (1,) * (products.ndim - 2)
            once = products.mean(axis=0) / _variance(moments.mean(axis=1))
            variance = _variance(np.einsum("rb,mbo->mro", weights, moments, optimize=True))
            again = np.tensordot(weights, products, axes=1)
            return once, again / variance.reshape(len(weights), *between, -1)

        S1, S1_again = shares(first)
        ST, ST_again = shares(total)
        result = {
            "S1": S1.T,
            "S1_conf": half_width(S1_again).T,
            "ST": ST.T,
            "ST_conf": half_width(ST_again).T,
        }
        if self.second_order:
            from_a = rows[:, count + 1 : 2 * count + 1]
            shape = (outputs.shape[1], count, count)
            result["S2"], result["S2_conf"] = np.full(shape, np.nan), np.full(shape, np.nan)
            for j in range(count - 1):
                products = from_a[:, [j]] * from_b[:, j + 1 :] - (a * b)[:, None]
                both, both_again = shares(products)
                pair = both - S1[[j]] - S1[j + 1 :]
                again = both_again - S1_again[:, [j]] - S1_again[:, j + 1 :]
                result["S2"][:, j, j + 1 :] = pair.T
                result["S2_conf"][:, j, j + 1 :] = half_width(again).T
        return result


def _variance(moments: Float[np.ndarray, "2 *shape"]) -> Float[np.ndarray, "*shape"]:
    """Computes the variance from the mean and the mean square; a resample may have none."""
    variance = moments[1] - moments[0] ** 2
    return np.where(variance > 0, variance, np.nan)
