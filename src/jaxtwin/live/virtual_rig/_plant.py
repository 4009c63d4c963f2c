"""A twin with a clock: the plant of a virtual rig."""

from typing import final

import jax
import numpy as np
from jaxtyping import Float

from ...observers import OpenLoop, OpenLoopState, predicted, started
from ...physics import System, Twin


@final
class Plant:
    """A twin with a time, whose duty, surroundings and equations may change.

    It is an `OpenLoop` that keeps its state. The ambient temperature remains that of the start,
    without the rig's drift, until another one is given.

    **Arguments:**

    - `twin`: the twin.
    """

    def __init__(self, twin: Twin):
        self.time = 0.0
        """The time of the twin, s."""
        self._use(twin)
        self.ambient = float(self._observer.stepper.ambient)
        """The temperature of the surroundings, degC."""
        self._command = np.zeros(len(twin.netlist.cells))
        # This also compiles the steps before the first data arrive.
        self.start(0.0)

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """Temperatures of all nodes, degC."""
        return np.asarray(self._state.twin.nodes)

    @property
    def temperatures(self) -> Float[np.ndarray, " channels"]:
        """The readings that the twin predicts for now, degC."""
        return self._temperatures

    @property
    def system(self) -> System:
        """The equations."""
        return self._observer.stepper.system

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
        with jax.enable_x64(True):
            at = None if nodes is None else np.asarray(nodes, float)
            state = started(self._observer, at, self._command)
        self._state = jax.tree.map(np.asarray, state)
        self._step(0.0)

    def drive(self, duty: Float[np.ndarray, " cells"], ambient: float | int | None = None) -> None:
        """Sets the duty cycles (-1 to 1) and, if it is known, the ambient temperature (degC) from
        now on."""
        self._command = np.asarray(duty, np.float64)
        if ambient is not None and ambient != self.ambient:
            self.ambient = float(ambient)
            self._step(0.0)

    def advance(self, time: float | int) -> Float[np.ndarray, " channels"]:
        """Advances to a time, s. A remainder that is shorter than a step is left for the next call.

        **Returns:** the readings of the channels at that time, degC.
        """
        if time > self.time:
            self._step(time - self.time)
            self.time = time
        return self.temperatures

    def replace(self, system: System) -> None:
        """Continues from the same temperatures with other equations, for example those of a rig
        with a fault."""
        self._use(system)
        self._step(0.0)

    def _use(self, equations: Twin | System) -> None:
        with jax.enable_x64(True):
            self._observer = OpenLoop(equations)
        self._predict = predicted.bind(self._observer)

    def _step(self, dt: float) -> None:
        with jax.enable_x64(True):
            state, temperatures = self._predict(
                self._state, self._command, np.float64(self.ambient), np.float64(dt)
            )
        # The state is stored as NumPy arrays, because it is read between two steps.
        self._state: OpenLoopState = jax.tree.map(np.asarray, state)
        self._temperatures = np.asarray(temperatures)
