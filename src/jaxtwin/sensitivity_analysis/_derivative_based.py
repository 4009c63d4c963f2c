r"""Derivative-based measures: exact derivatives at random points bound Sobol's total indices.

By Poincaré's inequality, $S_{Tj} \le E[(w_j \, \partial f / \partial x_j)^2] / V$, with a weight
that follows from the parameter's distribution: its standard deviation for a normal distribution,
its range divided by $\pi$ for a uniform one (Sobol' and Kucherenko, Mathematics and Computers in
Simulation 79 (2009) 3009-3017; Lamboni and others, the same, 87 (2013) 45-54). A parameter with a
small bound does not matter. A parameter with a large bound may or may not matter.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._bootstrap import half_width, resample_weights
from ._method import AbstractPlainMethod, Design, Indices


@final
@dataclass(frozen=True)
class DerivativeBased(AbstractPlainMethod):
    """The mean squared derivative `vi`, its standard deviation over draws `vi_std`, and the bound
    of the total index `dgsm`, with `dgsm_conf`, half of its 95 % bootstrap interval. SALib's
    `dgsm_conf` is that of `vi`."""

    name = "dgsm"
    main = "dgsm"
    default_draws = 256
    default_samples = "sobol"
    needs_independence_for = "derivative-based bounds"
    needs_slopes = True

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        assert slopes is not None
        pairs = zip(design.inputs.marginals.values(), design.samples.T, strict=True)
        weight = np.stack([marginal.poincare_weight(column) for marginal, column in pairs], axis=1)
        squares, bounds = slopes**2, (slopes * weight[:, None]) ** 2
        again = resample_weights(len(outputs), seed)
        centred = outputs - outputs.mean(axis=0)
        variance = np.maximum(again @ centred**2 - (again @ centred) ** 2, 0.0)
        variance = np.where(variance > 0, variance, np.nan)[:, :, None]
        return {
            "vi": squares.mean(axis=0),
            "vi_std": squares.std(axis=0),
            "dgsm": bounds.mean(axis=0) / outputs.var(axis=0)[:, None],
            "dgsm_conf": half_width(np.tensordot(again, bounds, axes=1) / variance),
        }
