"""The interface of a method of global sensitivity analysis: the runs that it needs, and the indices
that it estimates from them.

Runs come in blocks, such as the rows of Saltelli's scheme that share a base sample, or a trajectory
of Morris. A block is complete if all its runs have finite outputs. Incomplete blocks are left out
as a whole, and resampling takes whole blocks.
"""

import abc
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from jaxtyping import Bool, Float, Int

from .._statistics import QUANTILE_975
from ._inputs import Inputs
from ._sampling import SampleKind, unit_samples

# The number of outputs that are analysed at a time, so that products of blocks, parameters and
# outputs stay small.
COLUMNS = 64

# The smallest number of complete blocks from which indices of an output are estimated.
MIN_BLOCKS = 2

# An output whose values differ by less than this fraction of their size counts as constant: the
# differences are rounding.
CONSTANT = 1e-12

# Name -> index of each output `(outputs,)`, of each of its parameters `(outputs, parameters)`, or
# of each pair of them `(outputs, parameters, parameters)`.
Indices = dict[str, Float[np.ndarray, "outputs ..."]]


@final
@dataclass(frozen=True, eq=False)
class Design:
    """The runs of an analysis.

    **Arguments:**

    - `inputs`: the distributions of the drawn parameters.
    - `unit`: probabilities of the parameters' values, `(runs, parameters)`.
    - `block`: the number of runs in a block; blocks follow each other.
    - `order`: the order of the parameters in each block, if it differs between blocks.
    """

    inputs: Inputs
    unit: Float[np.ndarray, "runs parameters"]
    block: int = 1
    order: Int[np.ndarray, "blocks parameters"] | None = None

    def __repr__(self) -> str:
        return f"<Design: {len(self.unit)} runs of {', '.join(self.inputs.marginals)}>"

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return len(self.unit) // self.block

    @property
    def samples(self) -> Float[np.ndarray, "runs parameters"]:
        """The parameters' values."""
        return self.inputs.values(self.unit)

    def of_blocks(self, mask: Bool[np.ndarray, " blocks"]) -> "Design":
        """Returns the design with the blocks for which the mask is true."""
        return replace(
            self,
            unit=self.unit[np.repeat(mask, self.block)],
            order=None if self.order is None else self.order[mask],
        )


class AbstractMethod(abc.ABC):
    """A method of global sensitivity analysis.

    - `name`: the name of the method in `jaxtwin.global_sensitivity`.
    - `main`: the index by which parameters are ranked.
    - `default_draws`, `default_samples`: the number and the kind of samples if the caller chooses
      none.
    - `min_draws`: the smallest number of draws that the method accepts.
    - `needs_slopes`: whether the method needs derivatives of the outputs with respect to the
      parameters.
    """

    name: ClassVar[str]
    main: ClassVar[str]
    default_draws: ClassVar[int]
    default_samples: ClassVar[SampleKind] = "random"
    min_draws: ClassVar[int] = 3
    needs_slopes: ClassVar[bool] = False

    @abc.abstractmethod
    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        """Makes the runs that the method needs.

        **Arguments:**

        - `inputs`: the distributions of the drawn parameters.
        - `draws`: the number of blocks.
        - `seed`: the same seed gives the same runs.
        - `samples`: the kind of samples; methods with samples of their own ignore it.
        """

    @abc.abstractmethod
    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        """Estimates the indices of outputs that vary and are finite in all runs.

        **Arguments:**

        - `design`: the result of the method `design`, or some blocks of it.
        - `outputs`: the outputs of its runs.
        - `slopes`: the derivatives of the outputs with respect to the parameters; None for a method
          that does not need them.
        - `seed`: the seed of the resampling.
        """


class AbstractPlainMethod(AbstractMethod):
    """A method whose runs are samples of all parameters together; each run is a block.

    - `needs_independence_for`: the name of the method in the error for correlated parameters; None
      if the method supports correlated parameters.
    """

    needs_independence_for: ClassVar[str | None] = None

    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        if self.needs_independence_for is not None:
            inputs.check_independent(self.needs_independence_for)
        unit = unit_samples(samples, draws, len(inputs.names), seed)
        return Design(inputs, inputs.correlated(unit))


def indices_of(
    method: AbstractMethod,
    design: Design,
    outputs: Float[np.ndarray, "runs outputs"],
    slopes: Float[np.ndarray, "runs outputs parameters"] | None = None,
    seed: int = 0,
) -> tuple[Indices, Int[np.ndarray, " outputs"]]:
    """Estimates the indices of outputs that may be constant, or whose runs may have failed.

    **Arguments:**

    - `method`, `design`: a method, and its design.
    - `outputs`: the outputs of all runs; NaN for a failed run.
    - `slopes`: their derivatives with respect to the parameters, if the method needs them.
    - `seed`: the seed of the resampling.

    **Returns:** the indices, NaN for outputs that do not vary or have fewer than two complete
    blocks; and the number of complete blocks of each output.
    """
    finite = np.isfinite(outputs)
    if slopes is not None:
        finite &= np.isfinite(slopes).all(axis=2)
    complete = finite.reshape(design.blocks, design.block, -1).all(axis=1)
    patterns, group = np.unique(complete, axis=1, return_inverse=True)
    indices: Indices = {}
    for number, mask in enumerate(patterns.T):
        columns = np.flatnonzero(group.ravel() == number)
        if np.count_nonzero(mask) < MIN_BLOCKS:
            continue
        part = design.of_blocks(mask)
        runs = np.repeat(mask, design.block)
        columns = columns[varies(outputs[np.ix_(runs, columns)])]
        for first in range(0, len(columns), COLUMNS):
            some = columns[first : first + COLUMNS]
            rates = None if slopes is None else slopes[np.ix_(runs, some)]
            estimates = method.estimate(part, outputs[np.ix_(runs, some)], rates, seed)
            for name, values in estimates.items():
                shape = (outputs.shape[1], *values.shape[1:])
                indices.setdefault(name, np.full(shape, np.nan))[some] = values
    return indices or _no_indices(method, design, outputs), complete.sum(axis=0)


def varies(outputs: Float[np.ndarray, "runs outputs"]) -> Bool[np.ndarray, " outputs"]:
    """Returns which outputs differ between runs by more than rounding."""
    return np.ptp(outputs, axis=0) > CONSTANT * np.abs(outputs).max(axis=0)


def _no_indices(
    method: AbstractMethod, design: Design, outputs: Float[np.ndarray, "runs outputs"]
) -> Indices:
    return {method.main: np.full((outputs.shape[1], design.unit.shape[1]), np.nan)}


# The number of bootstrap resamples: that of SALib.
RESAMPLES = 100


def resample_weights(blocks: int, seed: int) -> Float[np.ndarray, "resamples blocks"]:
    """Returns the weights of the blocks in each resample: the number of times that a block is
    drawn, divided by the number of blocks.

    Seeds other than 0 draw the resamples that SALib's analyser of Sobol's indices draws.
    """
    chosen = np.random.default_rng(seed).integers(blocks, size=(blocks, RESAMPLES))
    return np.stack([np.bincount(column, minlength=blocks) for column in chosen.T]) / blocks


def half_width(resampled: Float[np.ndarray, "resamples *shape"]) -> Float[np.ndarray, "*shape"]:
    """Computes half of the 95 % interval of an index from its resamples: SALib's `*_conf`."""
    return QUANTILE_975 * resampled.std(axis=0, ddof=1)
