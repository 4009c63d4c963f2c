"""What a method of global sensitivity analysis is: which runs it needs, and what it makes of them.

Runs come in blocks, such as the rows of Saltelli's scheme that share a base sample, or a trajectory
of Morris. A block is complete where all its runs gave finite outputs; those that are not are left
out as a whole and counted, and resampling takes whole blocks.
"""

import abc
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from jaxtyping import Bool, Float, Int

from ._inputs import Inputs
from ._unit_samples import SampleKind, unit_samples

COLUMNS = 64
"""Outputs that are worked on at a time, so that products of blocks, parameters and outputs stay
small."""

LEAST_BLOCKS = 2
"""Complete blocks below which nothing is said of an output."""

CONSTANT = 1e-12
"""An output whose values differ by less than this part of them has no variance: the rest is
rounding."""

Indices = dict[str, Float[np.ndarray, "outputs ..."]]
"""Name -> index of each output `(outputs,)`, of each of its parameters `(outputs, parameters)`, or
of each pair of them `(outputs, parameters, parameters)`."""


@final
@dataclass(frozen=True, eq=False)
class Design:
    """The runs of an analysis.

    **Arguments:**

    - `inputs`: what is drawn.
    - `unit`: probabilities of the parameters' values, `(runs, parameters)`.
    - `block`: runs in a block; blocks follow each other.
    - `order`: of the parameters in each block, where that differs between blocks.
    """

    inputs: Inputs
    unit: Float[np.ndarray, "runs parameters"]
    block: int = 1
    order: Int[np.ndarray, "blocks parameters"] | None = None

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return len(self.unit) // self.block

    @property
    def samples(self) -> Float[np.ndarray, "runs parameters"]:
        """The parameters' values."""
        return self.inputs.values(self.unit)

    def of_blocks(self, chosen: Bool[np.ndarray, " blocks"]) -> "Design":
        """The design with some of its blocks only."""
        return replace(
            self,
            unit=self.unit[np.repeat(chosen, self.block)],
            order=None if self.order is None else self.order[chosen],
        )


class AbstractMethod(abc.ABC):
    """A method of global sensitivity analysis.

    - `name`: as `jaxtwin.sensitivity` takes it.
    - `main`: the index by which parameters are ranked.
    - `usual_draws`, `usual_samples`: of its design, unless others are asked for.
    - `least_draws`: below which it says nothing.
    - `needs_slopes`: whether it takes derivatives of the outputs in the parameters.
    """

    name: ClassVar[str]
    main: ClassVar[str]
    usual_draws: ClassVar[int]
    usual_samples: ClassVar[SampleKind] = "random"
    least_draws: ClassVar[int] = 3
    needs_slopes: ClassVar[bool] = False

    @abc.abstractmethod
    def design(self, inputs: Inputs, draws: int, seed: int, samples: SampleKind) -> Design:
        """The runs that the method needs.

        **Arguments:**

        - `inputs`: what is drawn.
        - `draws`: how many blocks.
        - `seed`: the same seed gives the same runs.
        - `samples`: where the method does not have its own.
        """

    @abc.abstractmethod
    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        """The indices of outputs that all runs gave and that vary.

        **Arguments:**

        - `design`: what `design` gave, or some blocks of it.
        - `outputs`: of its runs.
        - `slopes`: of the outputs in the parameters, where the method needs them.
        - `seed`: of the resampling.
        """


class AbstractPlainMethod(AbstractMethod):
    """A method that takes samples of all parameters together, each run a block.

    - `needs_independence_for`: what it is called where it refuses correlated parameters; None where
      it takes them, with the correlations that they have.
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
    """The indices of outputs some of whose runs may have failed, or which may not vary.

    **Arguments:**

    - `method`, `design`: a method, and its design.
    - `outputs`: NaN where a run failed.
    - `slopes`: where the method needs them.
    - `seed`: of the resampling.

    **Returns:** the indices, NaN for outputs that do not vary or have no two complete blocks; and
    how many blocks each output had.
    """
    finite = np.isfinite(outputs)
    if slopes is not None:
        finite &= np.isfinite(slopes).all(axis=2)
    complete = finite.reshape(design.blocks, design.block, -1).all(axis=1)
    patterns, group = np.unique(complete, axis=1, return_inverse=True)
    found: Indices = {}
    for number, chosen in enumerate(patterns.T):
        columns = np.flatnonzero(group.ravel() == number)
        if np.count_nonzero(chosen) < LEAST_BLOCKS:
            continue
        part = design.of_blocks(chosen)
        runs = np.repeat(chosen, design.block)
        columns = columns[varies(outputs[np.ix_(runs, columns)])]
        for first in range(0, len(columns), COLUMNS):
            some = columns[first : first + COLUMNS]
            rates = None if slopes is None else slopes[np.ix_(runs, some)]
            estimates = method.estimate(part, outputs[np.ix_(runs, some)], rates, seed)
            for name, values in estimates.items():
                shape = (outputs.shape[1], *values.shape[1:])
                found.setdefault(name, np.full(shape, np.nan))[some] = values
    return found or _nothing(method, design, outputs), complete.sum(axis=0)


def varies(outputs: Float[np.ndarray, "runs outputs"]) -> Bool[np.ndarray, " outputs"]:
    """Which outputs differ between runs by more than rounding."""
    return np.ptp(outputs, axis=0) > CONSTANT * np.abs(outputs).max(axis=0)


def _nothing(
    method: AbstractMethod, design: Design, outputs: Float[np.ndarray, "runs outputs"]
) -> Indices:
    return {method.main: np.full((outputs.shape[1], design.unit.shape[1]), np.nan)}
