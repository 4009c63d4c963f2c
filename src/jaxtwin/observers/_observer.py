"""What an observer is, and the simplest: a twin in open loop."""

import warnings
from abc import abstractmethod
from typing import Generic, TypeVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from ..physics import System, Twin
from ..simulation import Stepper, StepperState

# The state of an observer: a PyTree of arrays.
State = TypeVar("State")


class AbstractObserver(eqx.Module, Generic[State]):
    """Estimates what a rig is doing from its duty and its readings.

    All methods are pure, and their arguments and results have static shapes: many observers, or
    many states of one, run side by side under `jax.vmap`. Temperatures are in degC.
    """

    @abstractmethod
    def init(
        self, nodes: Float[ArrayLike, "..."] | None, duty: Float[ArrayLike, " cells"]
    ) -> State:
        """The state at the start.

        **Arguments:**

        - `nodes`: the temperatures of all nodes, or one for all; None: those of the rig file.
        - `duty`: the duty cycles that the driver has reached, -1 to 1.
        """

    @abstractmethod
    def predict(
        self,
        state: State,
        duty: Float[ArrayLike, " cells"],
        ambient: Float[ArrayLike, ""],
        dt: Float[ArrayLike, ""],
    ) -> State:
        """The state after `dt` seconds with a duty (-1 to 1) and an ambient temperature, NaN if it
        is not measured."""

    @abstractmethod
    def update(
        self,
        state: State,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> State:
        """The state that readings leave. Those outside of the `mask` say nothing; they may be
        NaN."""

    def correct(
        self,
        state: State,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> State:
        """The old name of `update`."""
        warnings.warn("correct is now called update", DeprecationWarning, stacklevel=2)
        return self.update(state, readings, mask, ambient)

    @abstractmethod
    def readings(self, state: State, ambient: Float[ArrayLike, ""]) -> Float[Array, " channels"]:
        """The readings of the channels that a state lets expect."""

    @abstractmethod
    def nodes(self, state: State) -> Float[Array, " nodes"]:
        """The temperatures of all nodes."""


# The open-loop observer: a twin that gets the duty of its rig, and no correction by readings.

# The step of the stepper, s. Its error is far below a camera's noise, and ten steps a second cost
# little.
STEP_SECONDS = 0.1

# The part of a step by which a time may be short of a step, by rounding.
STEP_TOLERANCE = 1e-6


@final
class OpenLoopState(eqx.Module):
    """The state of an `OpenLoop`.

    - `twin`: that of its stepper.
    - `rest`: the time since the last step, s, less than a step.
    """

    twin: StepperState
    rest: Float[Array | ArrayLike, ""]


@final
class OpenLoop(AbstractObserver[OpenLoopState]):
    """A twin that follows the duty of its rig: an observer of gain zero.

    A command takes effect at the next step, and then passes through the driver's delay and lag.

    **Arguments:**

    - `twin`: the twin; or its equations, as `twin.system()` makes them.
    - `step_size`: the size of a step, s.
    - `longest_delay`: the longest delay for which the state has room, s, so that twins with other
      delays have states of the same shape; None: that of the twin.
    """

    stepper: Stepper
    step_size: float = eqx.field(static=True)

    def __init__(
        self,
        twin: Twin | System,
        *,
        step_size: float | int = STEP_SECONDS,
        longest_delay: float | int | None = None,
    ):
        self.stepper = Stepper(twin, step_size, longest_delay=longest_delay)
        self.step_size = float(step_size)

    def init(
        self, nodes: Float[ArrayLike, "..."] | None, duty: Float[ArrayLike, " cells"]
    ) -> OpenLoopState:
        return OpenLoopState(self.stepper.start(nodes, duty), jnp.zeros(()))

    def predict(
        self,
        state: OpenLoopState,
        duty: Float[ArrayLike, " cells"],
        ambient: Float[ArrayLike, ""],
        dt: Float[ArrayLike, ""],
    ) -> OpenLoopState:
        ambient = self._room(ambient)
        passed = jnp.asarray(state.rest) + jnp.asarray(dt)
        steps = jnp.floor(passed / self.step_size + STEP_TOLERANCE).astype(int)
        twin = self.stepper.step(state.twin, duty, ambient, steps=steps)
        return OpenLoopState(twin, passed - steps * self.step_size)

    def update(
        self,
        state: OpenLoopState,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> OpenLoopState:
        return state

    def readings(
        self, state: OpenLoopState, ambient: Float[ArrayLike, ""]
    ) -> Float[Array, " channels"]:
        return self.stepper.channels(state.twin, self._room(ambient))

    def _room(self, ambient: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """The ambient temperature, that of the twin where none is measured."""
        measured = jnp.asarray(ambient)
        return jnp.where(jnp.isnan(measured), self.stepper.ambient, measured)

    def nodes(self, state: OpenLoopState) -> Float[Array, " nodes"]:
        return jnp.asarray(state.twin.nodes)
