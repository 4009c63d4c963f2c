"""The temperatures with which the runs of a match begin, for compiled code."""

from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..physics import System
from ..simulation import TimeGrid
from ..simulation._drive import Drive
from ..simulation._initial import (
    CheckedInitial,
    initial_temperatures,
    keeps_symmetry,
)


@final
class RunStart(eqx.Module):
    """The start of all runs: that of the rig by default.

    - `temperatures`: a temperature for each node or a single one, K; None for none.
    - `is_steady`: whether runs begin in the steady state under the first input.
    """

    temperatures: Float[np.ndarray | Array, "*descents starts"] | None
    is_steady: bool = eqx.field(static=True)

    @classmethod
    def of(cls, initial: CheckedInitial) -> "RunStart":
        """The start that `checked_initial` found."""
        if isinstance(initial, str):
            return cls(None, is_steady=True)
        return cls(None if initial is None else np.asarray(initial), is_steady=False)

    @property
    def is_lumped(self) -> bool:
        """Whether equal nodes begin alike, so that a lumped system is sufficient."""
        return keeps_symmetry(self._initial)

    def node_temperatures(self, system: System, grid: TimeGrid) -> Float[Array, " nodes"]:
        """The absolute temperatures of the nodes at the start, K."""
        if self._initial is None:
            return system.initial_temperature
        reference = Drive.of(system, grid).reference
        return initial_temperatures(system, self._initial, grid.summary().first, reference)

    @property
    def _initial(self) -> CheckedInitial:
        return "steady" if self.is_steady else self.temperatures


OF_THE_RIG = RunStart(None, is_steady=False)
