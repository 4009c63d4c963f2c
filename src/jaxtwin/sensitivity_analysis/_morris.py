"""Effects of one parameter at a time: Morris's elementary effects, which say what parameters have
an effect, and which without interactions, and the numbers of a tornado plot, from each parameter's
median to a low and a high quantile.

The runs are random trajectories through a grid of levels, along which every parameter changes once
(Morris, Technometrics 33 (1991) 161-174; mu_star by Campolongo and others, Environmental Modelling
& Software 22 (2007) 1509-1518). The grid divides the probability of each parameter evenly; for a
distribution with tails, it divides the central 95 %. An effect is the change of the output over the
step on the grid, whose whole range counts as 1, as in SALib.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from .._arguments import whole_number
from ..errors import SimulationError
from ._inputs import TAIL, Inputs
from ._method import AbstractMethod, Design, Indices, half_width, resample_weights
from ._sampling import SampleKind


@final
@dataclass(frozen=True)
class Morris(AbstractMethod):
    """Elementary effects: their mean `mu`, mean size `mu_star` with `mu_star_conf`, half of its
    95 % bootstrap interval over trajectories, and standard deviation `sigma`, which is 0 if a
    parameter has a linear effect without interactions.

    **Arguments:**

    - `levels`: the number of levels of the grid, which is even.

    **Raises:** `SimulationError` if they are not.
    """

    levels: int = 4

    name = "morris"
    main = "mu_star"
    default_draws = 40

    def __post_init__(self) -> None:
        levels = whole_number("Morris: levels", self.levels, 2, SimulationError)
        if levels % 2:
            raise SimulationError(f"Morris: levels: expected an even number, got {levels}")

    @property
    def step(self) -> float:
        """On the grid, whose range is 1: half of the levels."""
        return self.levels / (2 * (self.levels - 1))

    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        inputs.check_independent("Morris's effects")
        generator, count = np.random.default_rng(seed), len(inputs.names)
        low = generator.integers(self.levels // 2, size=(draws, 1, count)) / (self.levels - 1)
        rises = generator.integers(2, size=(draws, 1, count))
        order = generator.permuted(np.tile(np.arange(count), (draws, 1)), axis=1)
        # A parameter has moved in all rows after its place in the order.
        place = np.argsort(order, axis=1)
        moved = np.arange(count + 1)[:, None] > place[:, None]
        grid = low + self.step * np.where(rises, moved, ~moved)
        tails = np.array([marginal.tail for marginal in inputs.marginals.values()])
        unit = tails + (1 - 2 * tails) * grid.reshape(-1, count)
        return Design(inputs, unit, count + 1, order)

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        assert design.order is not None
        count = design.unit.shape[1]
        unit = design.unit.reshape(design.blocks, design.block, count)
        changes = np.diff(outputs.reshape(design.blocks, design.block, -1), axis=1)
        # Sorts the changes of each trajectory by parameter.
        place = np.argsort(design.order, axis=1)
        effects = np.take_along_axis(changes, place[:, :, None], axis=1)
        effects *= np.sign(unit[:, -1] - unit[:, 0])[:, :, None] / self.step
        resampled = np.tensordot(resample_weights(design.blocks, seed), np.abs(effects), axes=1)
        return {
            "mu": effects.mean(axis=0).T,
            "mu_star": np.abs(effects).mean(axis=0).T,
            "mu_star_conf": half_width(resampled).T,
            "sigma": effects.std(axis=0, ddof=1).T,
        }


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
