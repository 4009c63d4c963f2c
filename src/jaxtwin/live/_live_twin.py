"""The twin in step with the rig: one small compiled call brings it from sample to sample."""

from collections import deque
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._compilation import persistent_jit
from ..physics import System, Twin
from ..simulation._exponential import (
    Inputs,
    ModalField,
    StepFactors,
    exponential_step,
    step_factors,
)
from ..simulation._modes import network_modes

ZERO_CELSIUS = 273.15

STEP_SECONDS = 0.1
"""Of the solver; its error is far below a camera's noise, and ten steps a second cost little."""


@final
class LiveTwin:
    """A twin that is driven by what a rig reports, on the rig's time.

    The same exponential steps as in `jaxtwin.simulate`, but one after the other; any number of them
    under one command is one compiled call. A command takes effect at the next step, a driver's
    delay is rounded to steps. The room stays as warm as at the start, without the rig's drift,
    until a reading of it says otherwise.

    **Arguments:**

    - `twin`: rig and parameters.
    """

    def __init__(self, twin: Twin):
        self.time = 0.0
        """Up to where it has been stepped, s."""
        with jax.enable_x64(True):
            self._system = _assembled(twin)
        self._reference = float(self._system.ambient_temperature)
        self._ambient = 0.0
        self._command = np.zeros(len(twin.netlist.cells))  # the last one
        self._upcoming: deque[tuple[float, np.ndarray]] = deque()  # those on their way: when, what
        self._obeyed = self._command  # what the driver follows
        self._duty = self._command  # what the cells get
        self._prepare()
        self.start(0.0)

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """Temperatures of all nodes, degC."""
        return self._shapes @ self._amplitudes + self._reference - ZERO_CELSIUS

    @property
    def ambient(self) -> float:
        """Of the surroundings, degC."""
        return self._reference + self._ambient - ZERO_CELSIUS

    @property
    def temperatures(self) -> Float[np.ndarray, " channels"]:
        """What the camera should read now, degC."""
        return self._channels @ self._amplitudes + self._channel_offset

    def start(
        self, time: float | int, nodes: Float[np.ndarray, " nodes"] | float | int | None = None
    ) -> None:
        """Sets time (s) and node temperatures (degC, one for all, or `None`: the rig file's).

        A driver that lags behind its command has reached the last one.
        """
        self.time = time
        self._upcoming.clear()
        self._obeyed = self._duty = self._command
        if nodes is None:
            nodes = np.asarray(self._system.initial_temperature) - ZERO_CELSIUS
        self._place(np.broadcast_to(np.asarray(nodes, np.float64), self._capacitance.shape))

    def drive(self, duty: Float[np.ndarray, " cells"], ambient: float | int | None = None) -> None:
        """Sets the duty cycles (-1 to 1) and, where it is known, the ambient (degC) from now on."""
        command = np.asarray(duty, np.float64)
        if not np.array_equal(command, self._command):
            self._command = command
            self._upcoming.append((self.time + self._delay, command))
        if ambient is not None:
            self._ambient = ambient + ZERO_CELSIUS - self._reference
            self._offset()

    def advance(self, time: float | int) -> Float[np.ndarray, " channels"]:
        """Steps to a time, s, but for what is less than one step of the solver.

        **Returns:** the channels there, degC.
        """
        steps = int((time - self.time) / STEP_SECONDS + 1e-6)
        while steps > 0:
            while self._upcoming and self._steps_to(self._upcoming[0][0]) <= 0:
                self._obeyed = self._upcoming.popleft()[1]
            now = steps
            if self._upcoming:
                now = min(steps, self._steps_to(self._upcoming[0][0]))
            inputs = np.append(self._obeyed, self._ambient)
            with jax.enable_x64(True):
                state = _advance(self._amplitudes, self._duty, inputs, now, self._equations)
            self._amplitudes, self._duty = map(np.asarray, state)
            self.time += now * STEP_SECONDS
            steps -= now
        return self.temperatures

    def replace(self, system: System) -> None:
        """Goes on from the same temperatures with other equations: a fault of the rig, say."""
        nodes = self.nodes
        self._system = system
        self._prepare()
        self._place(nodes)

    @property
    def system(self) -> System:
        """The equations."""
        return self._system

    def _steps_to(self, time: float) -> int:
        return round((time - self.time) / STEP_SECONDS)

    def _place(self, nodes: Float[np.ndarray, " nodes"]) -> None:
        deviation = nodes + ZERO_CELSIUS - self._reference
        # V^T C V = 1, so V^T C is the inverse of the shapes V.
        self._amplitudes = self._shapes.T @ (self._capacitance * deviation)

    def _prepare(self) -> None:
        system, reference = self._system, self._reference
        with jax.enable_x64(True):
            self._equations = _, field = _solved(system, jnp.asarray(reference))
            self._shapes = np.asarray(field.modes.shapes)
            self._capacitance = np.asarray(system.capacitance)
            gain = np.asarray(system.gain)
            # Compiled now, not when the first data wait for it.
            still, idle = np.zeros(len(self._capacitance)), np.zeros(len(self._command) + 1)
            _advance(still, idle[:-1], idle, 0, self._equations)
            self._delay = 0.0 if system.delay is None else float(system.delay)
        self._gain = gain
        self._channels = gain[:, None] * (system.wiring.channel_weights @ self._shapes)
        self._offset()

    def _offset(self) -> None:
        # reading = ambient + gain (T - ambient)
        self._channel_offset = self._reference - ZERO_CELSIUS + (1 - self._gain) * self._ambient


@persistent_jit
def _assembled(twin: Twin) -> System:
    return twin.system()


@persistent_jit
def _solved(system: System, reference: jax.Array) -> tuple[StepFactors, ModalField]:
    at_rest = jnp.zeros(len(system.wiring.cold))
    modes = network_modes(system, at_rest, reference)
    field = ModalField.of(system, modes, reference)
    return step_factors(modes.rates, jnp.asarray(STEP_SECONDS)), field


@jax.jit
def _advance(
    amplitudes: jax.Array | np.ndarray,
    duty: jax.Array | np.ndarray,
    inputs: jax.Array | np.ndarray,
    steps: jax.Array | int,
    equations: tuple[StepFactors, ModalField],
) -> tuple[jax.Array, jax.Array]:
    """`steps` steps under a command and an ambient `(cells + 1,)`; compiled once for a rig.

    **Returns:** the amplitudes and the duty cycles at their end.
    """
    factors, field = equations
    lag = field.system.lag
    command, ambient = jnp.asarray(inputs[:-1]), jnp.asarray(inputs[-1])

    def step(_: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        z, u = state
        if lag is None:
            now, after = Inputs(command, ambient), command
        else:
            # du/dt = (command - u) / lag, at the start, in the middle and at the end of the step.
            left = jnp.exp(-STEP_SECONDS * jnp.array([0.0, 0.5, 1.0]) / lag)[:, None]
            stages = command + (u - command) * left
            now, after = Inputs(stages, ambient), stages[-1]
        end, _ = exponential_step(z, field.force(z, now.at(0)), factors, field, now)
        return end, after

    return jax.lax.fori_loop(0, steps, step, (jnp.asarray(amplitudes), jnp.asarray(duty)))
