"""Varies one parameter at a time, from its median to a low and a high quantile: the numbers of a
tornado plot."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._inputs import Inputs
from ._marginals import TAIL
from ._method import AbstractMethod, Design, Indices
from ._unit_samples import SampleKind


@final
@dataclass(frozen=True)
class OneAtATime(AbstractMethod):
    """Each parameter at its 2.5 % and 97.5 % quantile while the others are at their medians: the
    change of the output, `low` and `high`, and `swing`, the span of the three values.

    The method takes 2 d + 1 runs for d parameters, whatever `draws`, and ignores interactions.
    """

    name = "oat"
    main = "swing"
    default_draws = 1
    min_draws = 1

    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        inputs.check_independent("one parameter at a time")
        count = len(inputs.names)
        unit = np.full((2 * count + 1, count), 0.5)
        each = np.arange(count)
        unit[1 + 2 * each, each], unit[2 + 2 * each, each] = TAIL, 1 - TAIL
        return Design(inputs, unit)

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        changes = (outputs[1:] - outputs[0]).reshape(-1, 2, outputs.shape[1])
        low, high = changes[:, 0].T, changes[:, 1].T
        swing = np.maximum(np.maximum(low, high), 0) - np.minimum(np.minimum(low, high), 0)
        return {"low": low, "high": high, "swing": swing}
