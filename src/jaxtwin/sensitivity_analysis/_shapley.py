r"""Shapley effects: the variance divided fairly, also among parameters that are correlated.

Sobol's indices of correlated parameters overlap and leave gaps. The Shapley effect of a parameter
is the increase of $c(J) = E[\operatorname{var}(f \mid x_{-J})]$ when it enters the set $J$, on
average over all orders in which parameters can enter; effects are not negative and their sum is 1
(Owen 2014; Song, Nelson and Staum, SIAM/ASA Journal on Uncertainty Quantification 4 (2016)
1060-1083). A parameter on which the twin does not depend has an effect if it is correlated with
others.

A block is a random order. Each set of parameters in this order has one outer sample of the
parameters outside the set, and three inner samples of those inside it, given the outer one. The
variance is that of the inner samples. These numbers of samples are those that Song and others
recommend.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from ._inputs import Inputs
from ._method import AbstractMethod, Design, Indices, half_width, resample_weights
from ._sampling import SampleKind

# The number of inner samples.
INNER = 3


@final
@dataclass(frozen=True)
class Shapley(AbstractMethod):
    """Shapley effects `Sh`, with `Sh_conf`, half of their 95 % bootstrap interval over orders.

    A draw is an order of the parameters, which takes 3 (d - 1) runs.
    """

    name = "shapley"
    main = "Sh"
    default_draws = 256

    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        count = len(inputs.names)
        generator = np.random.default_rng(seed)
        order = generator.permuted(np.tile(np.arange(count), (draws, 1)), axis=1)
        levels = max(count - 1, 1)
        normal = generator.standard_normal((draws, levels, INNER, count))
        scores = normal @ inputs.root.T
        for sequence, block in zip(order, scores, strict=True):
            for level in range(min(levels, count - 1)):
                _condition(block[level], sequence[level + 1 :], sequence[: level + 1], inputs)
        return Design(inputs, ndtr(scores).reshape(-1, count), levels * INNER, order)

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        assert design.order is not None
        blocks, count = design.order.shape
        rows = (outputs - outputs.mean(axis=0)).reshape(blocks, -1, INNER, outputs.shape[1])
        means, squares = rows.mean(axis=(1, 2)), (rows**2).mean(axis=(1, 2))
        # The variance that each set explains: 0 for the empty set.
        within = rows.var(axis=2, ddof=1)[:, : count - 1]
        explained = np.concatenate([np.zeros_like(means)[:, None], within], axis=1)
        gains = np.concatenate([np.diff(explained, axis=1), -explained[:, -1:]], axis=1)
        is_last = np.zeros((blocks, count))
        is_last[np.arange(blocks), design.order[:, -1]] = 1.0
        place = np.argsort(design.order, axis=1)
        gains = np.take_along_axis(gains, place[:, :, None], axis=1)

        def effects(
            weights: Float[np.ndarray, "resamples blocks"],
        ) -> Float[np.ndarray, "resamples parameters outputs"]:
            variance = np.maximum(weights @ squares - (weights @ means) ** 2, 0.0)
            variance = np.where(variance > 0, variance, np.nan)[:, None]
            # The last parameter of an order gains the rest of the whole variance.
            return np.tensordot(weights, gains, axes=1) / variance + (weights @ is_last)[:, :, None]

        once = effects(np.full((1, blocks), 1 / blocks))[0]
        return {"Sh": once.T, "Sh_conf": half_width(effects(resample_weights(blocks, seed))).T}


def _condition(
    scores: Float[np.ndarray, "inner parameters"],
    fixed: np.ndarray,
    varied: np.ndarray,
    inputs: Inputs,
) -> None:
    """Sets the fixed parameters of all inner samples to those of the first, and shifts the varied
    ones to their distribution given these (Matheron's rule)."""
    shift = scores[:1, fixed] - scores[:, fixed]
    if inputs.correlation is not None:
        among = inputs.correlation[np.ix_(fixed, fixed)]
        across = inputs.correlation[np.ix_(fixed, varied)]
        scores[:, varied] += shift @ np.linalg.lstsq(among, across, rcond=1e-10)[0]
    scores[:, fixed] += shift
