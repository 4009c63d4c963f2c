"""The steps of an observer as programs, for what takes them one by one in Python: the twin beside a
rig, and a virtual rig."""

from typing import TypeVar

from jaxtyping import Array, ArrayLike, Bool, Float

from .._compilation import persistent_jit, persistent_jit_unoptimised
from ._observer import AbstractObserver

State = TypeVar("State")


@persistent_jit_unoptimised
def started(
    observer: AbstractObserver[State],
    nodes: Float[ArrayLike, "..."] | None,
    duty: Float[ArrayLike, " cells"],
) -> State:
    """The state at the start; see `AbstractObserver.init`."""
    return observer.init(nodes, duty)


@persistent_jit
def predicted(
    observer: AbstractObserver[State],
    state: State,
    duty: Float[ArrayLike, " cells"],
    ambient: Float[ArrayLike, ""],
    dt: Float[ArrayLike, ""],
) -> tuple[State, Float[Array, " channels"]]:
    """The state after a time, and the readings that it lets expect, in one call, because most of
    the time of a call is spent in Python."""
    state = observer.predict(state, duty, ambient, dt)
    return state, observer.readings(state, ambient)


@persistent_jit
def followed(
    observer: AbstractObserver[State],
    state: State,
    duty: Float[ArrayLike, " cells"],
    ambient: Float[ArrayLike, ""],
    dt: Float[ArrayLike, ""],
    readings: Float[ArrayLike, " channels"],
    mask: Bool[ArrayLike, " channels"],
) -> tuple[State, Float[Array, " channels"]]:
    """The state after a time and the readings at its end, and what was expected of them before, in
    one call too."""
    state = observer.predict(state, duty, ambient, dt)
    expected = observer.readings(state, ambient)
    return observer.update(state, readings, mask, ambient), expected
