"""The twin in step with the rig: one small compiled call brings it from sample to sample."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..physics import System, Twin
from ..simulation._exponential import (
    Inputs,
    Modes,
    StepFactors,
    exponential_step,
    network_modes,
    step_factors,
)

ZERO_CELSIUS = 273.15

STEP_SECONDS = 0.1
"""Of the solver; its error is far below a camera's noise, and ten steps a second cost little."""


@final
class LiveTwin:
    """A twin that is driven by what a rig reports, on the rig's time.

    The same exponential steps as in `jaxtwin.simulate`, but one after the other; any number of them
    is one compiled call.

    **Arguments:**

    - `twin`: rig and parameters.
    """

    def __init__(self, twin: Twin):
        self.time = 0.0
        """Up to where it has been stepped, s."""
        with jax.enable_x64(True):
            self._system = twin.system()
        self._reference = float(self._system.ambient_temperature)
        self._ambient = 0.0
        self._duty = np.zeros(len(twin.netlist.cells))
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
        """Sets time (s) and node temperatures (degC, one for all, or `None`: the rig file's)."""
        self.time = time
        absolute = (
            np.asarray(self._system.initial_temperature)
            if nodes is None
            else np.broadcast_to(np.asarray(nodes) + ZERO_CELSIUS, self._capacitance.shape)
        )
        # V^T C V = 1, so V^T C is the inverse of the shapes V.
        self._amplitudes = self._shapes.T @ (self._capacitance * (absolute - self._reference))

    def drive(self, duty: Float[np.ndarray, " cells"], ambient: float | int | None = None) -> None:
        """Sets the duty cycles (-1 to 1) and, where it is known, the ambient (degC) from now on."""
        self._duty = np.asarray(duty, np.float64)
        if ambient is not None:
            self._ambient = ambient + ZERO_CELSIUS - self._reference
            self._offset()

    def advance(self, time: float | int) -> Float[np.ndarray, " channels"]:
        """Steps to a time, s, but for what is less than one step of the solver.

        **Returns:** the channels there, degC.
        """
        steps = int((time - self.time) / STEP_SECONDS + 1e-6)
        if steps > 0:
            inputs = np.append(self._duty, self._ambient)
            with jax.enable_x64(True):
                stepped = _advance(self._amplitudes, inputs, steps, self._equations)
                self._amplitudes = np.asarray(stepped)
            self.time += steps * STEP_SECONDS
        return self.temperatures

    def replace(self, system: System) -> None:
        """Goes on from the same temperatures with other equations: a fault of the rig, say."""
        time, nodes = self.time, self.nodes
        self._system = system
        self._prepare()
        self.start(time, nodes)

    @property
    def system(self) -> System:
        """The equations."""
        return self._system

    def _prepare(self) -> None:
        system, reference = self._system, self._reference
        with jax.enable_x64(True):
            modes = network_modes(system)
            factors = step_factors(modes.rates, jnp.asarray(STEP_SECONDS))
            at_reference = jnp.asarray(reference)

            self._shapes = np.asarray(modes.shapes)
            self._capacitance = np.asarray(system.capacitance)
            gain = np.asarray(system.gain)
            self._equations = (factors, system, modes, at_reference)
            # Compiled now, not when the first data wait for it.
            idle = np.zeros(len(self._duty) + 1)
            _advance(np.zeros(len(self._capacitance)), idle, 0, self._equations)
        self._gain = gain
        self._channels = gain[:, None] * (system.wiring.channel_weights @ self._shapes)
        self._offset()

    def _offset(self) -> None:
        # reading = ambient + gain (T - ambient)
        self._channel_offset = self._reference - ZERO_CELSIUS + (1 - self._gain) * self._ambient


@jax.jit
def _advance(
    amplitudes: jax.Array | np.ndarray,
    inputs: jax.Array | np.ndarray,
    steps: jax.Array | int,
    equations: tuple[StepFactors, System, Modes, jax.Array],
) -> jax.Array:
    """`steps` steps under duty and ambient `(cells + 1,)`; compiled once for a rig."""
    factors, system, modes, reference = equations
    now = Inputs(jnp.asarray(inputs[:-1]), jnp.asarray(inputs[-1]))

    def step(_: jax.Array, z: jax.Array) -> jax.Array:
        return exponential_step(z, factors, system, modes, now, reference)[0]

    return jax.lax.fori_loop(0, steps, step, amplitudes)
