"""The test of parameters against the recordings that the twin was matched on."""

import math
from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..observers._augmented_model import AugmentedModel
from ._evidence import Evidence, Seen
from ._state_test import parameter_spreads, parameters_of
from ._thresholds import Reference

# Parameters are averaged over this time before they are compared with those of the match, s.
AVERAGING_SECONDS = 600.0

# A change of a parameter must last for this time, s.
PERSISTENT = 600.0

# The probability that a recording of a healthy rig is called changed.
LEVEL = 0.05


@final
class ShiftState(eqx.Module):
    """The averaged changes of the parameters, and for how long each has been unlike those of the
    match, s. `began`: whether the average has begun."""

    averages: Float[Array, " parameters"]
    shifted: Float[Array, " parameters"]
    began: Bool[Array, ""]


@final
class ShiftTest(eqx.Module):
    """Compares the averaged parameters with what the observer said of the matched recordings.

    Those that the noise names as drifting are compared; if there is none, all of them are. The
    difference that counts follows from Student's distribution with the spread between the matched
    recordings, or, if they are too few, from what the fit does not know of the parameter.

    - `matched`: the mean in the matched recordings. `unlike`: the difference from it that counts.
    - `freedom`: the degrees of freedom of the spread.
    """

    model: AugmentedModel
    matched: Float[np.ndarray | Array, " parameters"]
    unlike: Float[np.ndarray | Array, " parameters"]
    freedom: Float[np.ndarray | Array, " parameters"]

    def __init__(self, model: AugmentedModel, references: Mapping[str, Reference]):
        from scipy.special import stdtrit  # a part of scipy.stats, which takes a second to import

        names = parameters_of(model)
        compared = [name for name in names if name in model.noise.names] or list(names)
        spreads = parameter_spreads(model)
        self.model = model
        self.matched = np.zeros(len(names))
        self.unlike = np.full(len(names), math.inf)
        self.freedom = np.full(len(names), math.inf)
        for place, name in enumerate(names):
            if name not in compared:
                continue
            known, spread = references.get(name), spreads[place]
            if known is not None:
                self.matched[place] = known.mean
                if known.recordings > 1 and known.spread > 0:
                    spread = known.spread * math.sqrt(1 + 1 / known.recordings)
                    self.freedom[place] = known.recordings - 1
            chance = LEVEL / len(compared) / 2
            self.unlike[place] = spread * -float(stdtrit(self.freedom[place], chance))

    def init(self) -> ShiftState:
        """The state before the first sample."""
        none = jnp.zeros(len(self.matched))
        return ShiftState(none, none, jnp.zeros((), bool))

    def step(
        self, state: ShiftState, seen: Seen, dt: Float[Array, ""], settled: Bool[Array, ""]
    ) -> tuple[ShiftState, Evidence]:
        """The state after a sample, and what it says of each parameter."""
        model = self.model
        if model.directions is None:
            return state, Evidence(state.averages, state.averages, state.averages)
        change = model.directions.change(jnp.asarray(seen.mean)[model.layout.of("values")])
        share = jnp.where(state.began, -jnp.expm1(-dt / AVERAGING_SECONDS), 1.0)
        averages = jnp.where(settled, state.averages + share * (change - state.averages), 0.0)
        difference = averages - self.matched
        is_unlike = settled & (jnp.abs(difference) >= self.unlike)
        shifted = jnp.where(is_unlike, state.shifted + dt, 0.0)
        is_logarithm = np.array(model.directions.is_logarithmic)
        size = jnp.where(is_logarithm, jnp.expm1(difference), difference)
        after = ShiftState(averages, shifted, state.began | settled)
        return after, Evidence(shifted / PERSISTENT, shifted, size)

    def probability(self, place: int, size: float) -> float:
        """The probability that a parameter has changed by more than it does between recordings.

        **Arguments:**

        - `place`: the number of the parameter. `size`: its relative change, or its change.
        """
        from scipy.special import stdtr, stdtrit

        assert self.model.directions is not None
        is_logarithm = self.model.directions.is_logarithmic[place]
        difference = abs(math.log1p(max(size, -0.99)) if is_logarithm else size)
        unlike, freedom = (float(one[place]) for one in (self.unlike, self.freedom))
        compared = int(np.isfinite(np.asarray(self.unlike)).sum())
        limit = -float(stdtrit(freedom, LEVEL / compared / 2))
        chance = 2 * compared * float(stdtr(freedom, -difference / unlike * limit))
        return 1 - min(1.0, chance)
