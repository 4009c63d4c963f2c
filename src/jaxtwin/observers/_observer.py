"""What an observer is."""

from abc import abstractmethod
from typing import Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, ArrayLike, Bool, Float

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
    def correct(
        self,
        state: State,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> State:
        """The state that readings leave. Those outside of the `mask` say nothing; they may be
        NaN."""

    @abstractmethod
    def readings(self, state: State, ambient: Float[ArrayLike, ""]) -> Float[Array, " channels"]:
        """The readings of the channels that a state lets expect."""

    @abstractmethod
    def nodes(self, state: State) -> Float[Array, " nodes"]:
        """The temperatures of all nodes."""
