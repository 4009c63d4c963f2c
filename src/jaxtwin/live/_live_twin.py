"""The twin in step with the rig: a `Stepper` with a clock."""

from typing import final

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics import System, Twin
from ..simulation import Stepper, StepperState

STEP_SECONDS = 0.1
"""The step of the stepper, s. Its error is far below a camera's noise, and ten steps a second cost
little."""


@final
class LiveTwin:
    """A twin that is driven by the reports of a rig, in the time of the rig.

    A command takes effect at the next step of 0.1 s, and then passes through the driver's delay and
    lag. The ambient temperature remains that of the start, without the rig's drift, until it is
    measured.

    **Arguments:**

    - `twin`: the twin.
    """

    def __init__(self, twin: Twin):
        self.time = 0.0
        """The time up to which the twin has been stepped, s."""
        self._stepper = Stepper(twin, STEP_SECONDS)
        self.ambient = float(self._stepper.ambient)
        """The temperature of the surroundings, degC."""
        self._command = np.zeros(len(twin.netlist.cells))
        self._temperatures: Float[np.ndarray, " channels"] | None = None
        # This also compiles the steps before the first data arrive.
        self.start(0.0)

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """Temperatures of all nodes, degC."""
        return np.asarray(self._state.nodes)

    @property
    def temperatures(self) -> Float[np.ndarray, " channels"]:
        """The readings that the twin predicts for now, degC."""
        if self._temperatures is None:  # the ambient has changed since the last step
            self._temperatures = self._step(0)
        return self._temperatures

    @property
    def system(self) -> System:
        """The equations."""
        return self._stepper.system

    def start(
        self,
        time: float | int,
        nodes: Float[np.ndarray, " nodes"] | float | int | None = None,
        ambient: float | int | None = None,
    ) -> None:
        """Sets the time (s), the temperatures of the nodes (degC; a single temperature for all;
        `None`: those of the rig file) and the ambient temperature (degC; `None`: as it was).

        A driver with a lag is assumed to have reached its last command.
        """
        self.time = time
        if ambient is not None:
            self.ambient = float(ambient)
        self._state = self._stepper.start(nodes, self._command)
        self._temperatures = self._step(0)

    def drive(self, duty: Float[np.ndarray, " cells"], ambient: float | int | None = None) -> None:
        """Sets the duty cycles (-1 to 1) and, if it is known, the ambient temperature (degC) from
        now on."""
        self._command = np.asarray(duty, np.float64)
        if ambient is not None and ambient != self.ambient:
            self.ambient = float(ambient)
            self._temperatures = None

    def advance(self, time: float | int) -> Float[np.ndarray, " channels"]:
        """Steps to a time, s. A remainder that is shorter than a step is left for the next call.

        **Returns:** the readings of the channels at that time, degC.
        """
        steps = int((time - self.time) / STEP_SECONDS + 1e-6)
        if steps > 0:
            self._temperatures = self._step(steps)
            self.time += steps * STEP_SECONDS
        return self.temperatures

    def replace(self, system: System) -> None:
        """Continues from the same temperatures with other equations, for example those of a rig
        with a fault."""
        self._stepper = Stepper(system, STEP_SECONDS)
        self._temperatures = self._step(0)

    def _step(self, steps: int) -> Float[np.ndarray, " channels"]:
        with jax.enable_x64(True):
            state, temperatures = _stepped(
                self._stepper, self._state, self._command, np.float64(self.ambient), steps
            )
        # The state is stored as NumPy arrays, because it is read between two steps.
        self._state: StepperState = jax.tree.map(np.asarray, state)
        return np.asarray(temperatures)


@jax.jit
def _stepped(
    stepper: Stepper,
    state: StepperState,
    duty: Float[Array, " cells"],
    ambient: Float[Array, ""],
    steps: Int[Array, ""],
) -> tuple[StepperState, Float[Array, " channels"]]:
    """Computes steps and readings in one call, because most of the time of a call is spent in
    Python."""
    state = stepper.step(state, duty, ambient, steps=steps)
    return state, stepper.channels(state, ambient)
