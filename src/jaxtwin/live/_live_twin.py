"""The twin in step with the rig: a `Stepper` with a clock."""

from typing import final

import jax
import numpy as np
from jaxtyping import Float

from ..physics import System, Twin
from ..simulation import Stepper, StepperState

STEP_SECONDS = 0.1
"""Of the stepper; its error is far below a camera's noise, and ten steps a second cost little."""


@final
class LiveTwin:
    """A twin that is driven by what a rig reports, on the rig's time.

    A command takes effect at the next step of 0.1 s, and then passes through the driver's delay and
    lag. The room stays as warm as at the start, without the rig's drift, until a reading of it says
    otherwise.

    **Arguments:**

    - `twin`: rig and parameters.
    """

    def __init__(self, twin: Twin):
        self.time = 0.0
        """Up to where it has been stepped, s."""
        self._stepper = Stepper(twin, STEP_SECONDS)
        self.ambient = float(self._stepper.ambient)
        """Temperature of the surroundings, degC."""
        self._command = np.zeros(len(twin.netlist.cells))
        self.start(0.0)
        # Compiled now, not when the first data wait for it.
        self._stepper.step(self._state, self._command, self.ambient, steps=0)
        self.temperatures  # noqa: B018

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """Temperatures of all nodes, degC."""
        return np.asarray(self._state.nodes)

    @property
    def temperatures(self) -> Float[np.ndarray, " channels"]:
        """What the camera should read now, degC."""
        return np.asarray(self._stepper.channels(self._state, self.ambient))

    @property
    def system(self) -> System:
        """The equations."""
        return self._stepper.system

    def start(
        self, time: float | int, nodes: Float[np.ndarray, " nodes"] | float | int | None = None
    ) -> None:
        """Sets time (s) and node temperatures (degC, one for all, or `None`: the rig file's).

        A driver that lags behind its command has reached the last one.
        """
        self.time = time
        self._take(self._stepper.start(nodes, self._command))

    def drive(self, duty: Float[np.ndarray, " cells"], ambient: float | int | None = None) -> None:
        """Sets the duty cycles (-1 to 1) and, where it is known, the ambient (degC) from now on."""
        self._command = np.asarray(duty, np.float64)
        if ambient is not None:
            self.ambient = float(ambient)

    def advance(self, time: float | int) -> Float[np.ndarray, " channels"]:
        """Steps to a time, s, but for what is less than one step of the stepper.

        **Returns:** the channels there, degC.
        """
        steps = int((time - self.time) / STEP_SECONDS + 1e-6)
        if steps > 0:
            self._take(self._stepper.step(self._state, self._command, self.ambient, steps=steps))
            self.time += steps * STEP_SECONDS
        return self.temperatures

    def replace(self, system: System) -> None:
        """Goes on from the same temperatures with other equations: a fault of the rig, say."""
        self._stepper = Stepper(system, STEP_SECONDS)

    def _take(self, state: StepperState) -> None:
        # On the host, where it is read between two steps.
        self._state = jax.tree.map(np.asarray, state)
