"""Rigs of one structure side by side: one compiled step of observer and monitor for a block of
lanes. A block always has the same number of lanes, so that a rig that comes compiles nothing."""

import math
from typing import Any, NamedTuple, TypeAlias, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..monitoring import Evidence, Monitor, MonitorState, joined, observed_sample
from ..observers import ExtendedKalmanFilter, KalmanState, Moment
from ..serve._contents import HORIZON

# The number of lanes of a block: the states of more do not fit into a processor's cache, and the
# lanes of fewer cost more each (`benchmarks/results/fleet.md`).
LANES = 64

Watcher: TypeAlias = tuple[ExtendedKalmanFilter, Monitor]
"""The observer and the monitor of a rig."""

LaneState: TypeAlias = tuple[KalmanState, MonitorState]

Tree = TypeVar("Tree")


class LaneSteps(NamedTuple):
    """What the lanes of a block do in a step. `moves` are those that have one, `reads` those with
    readings at its end."""

    dt: Float[np.ndarray, " lanes"]
    elapsed: Float[np.ndarray, " lanes"]
    duty: Float[np.ndarray, "lanes cells"]
    ambient: Float[np.ndarray, " lanes"]
    readings: Float[np.ndarray, "lanes channels"]
    moves: Bool[np.ndarray, " lanes"]
    reads: Bool[np.ndarray, " lanes"]

    @classmethod
    def none(cls, cells: int, channels: int) -> "LaneSteps":
        """No lane has a step."""
        nothing, no = np.zeros(LANES), np.zeros(LANES, bool)
        return cls(
            nothing, nothing.copy(), np.zeros((LANES, cells)), np.full(LANES, np.nan),
            np.full((LANES, channels), np.nan), no, no.copy(),
        )  # fmt: skip


class LaneResult(NamedTuple):
    """What a step says of each lane.

    - `evidence`: what the monitor says. `expected`: the readings before they corrected anything.
    - `whitened`: the whitened innovations. `is_finite`: whether the observer has not diverged.

    All are arrays of JAX in the program, and of NumPy outside.
    """

    evidence: Evidence
    expected: Any
    whitened: Any
    is_finite: Any


def structure_of(watcher: Watcher) -> Any:
    """What rigs that share a block have in common: all but the numbers."""
    leaves, structure = jax.tree.flatten(watcher)
    return structure, tuple((np.shape(leaf), np.asarray(leaf).dtype.str) for leaf in leaves)


@final
class Lanes:
    """A block of lanes.

    **Arguments:**

    - `watcher`: that of the first rig, whose structure all have.
    """

    def __init__(self, watcher: Watcher):
        self.structure = structure_of(watcher)
        self._leaves = [np.repeat(np.asarray(leaf)[None], LANES, 0) for leaf in _leaves(watcher)]
        self._bind()
        model = watcher[0].model
        self._longest = watcher[0].longest_seconds
        self._cells, self._channels = model.layout.heats, len(model.columns)
        with own_settings():
            self._states = self._begin(np.full(LANES, 20.0), np.zeros((LANES, self._cells)))
        # These compile before the first data.
        self.step(self.none())
        self.ahead(np.zeros((LANES, self._cells)))

    def none(self) -> LaneSteps:
        """Steps of a block without any."""
        return LaneSteps.none(self._cells, self._channels)

    def put(self, lane: int, watcher: Watcher) -> None:
        """Gives a lane to another rig, or to another twin of it, which then has to begin."""
        for all_lanes, leaf in zip(self._leaves, _leaves(watcher), strict=True):
            all_lanes[lane] = leaf
        self._is_bound = False

    def begin(
        self,
        first: Float[np.ndarray, " lanes"],
        duty: Float[np.ndarray, "lanes cells"],
        which: Bool[np.ndarray, " lanes"],
    ) -> None:
        """Begins the observers of some lanes at a temperature, degC, as a `Follower` does."""
        self._bind()
        with own_settings():
            start = self._begin(np.where(which, first, 0.0), duty)

        def choose(new: Any, old: Any) -> np.ndarray:
            new, old = np.asarray(new), np.asarray(old)
            return np.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old)

        self._states = jax.tree.map(choose, start, self._states)

    def step(self, steps: LaneSteps) -> LaneResult:
        """Takes a step in each lane that has one."""
        self._bind()
        with own_settings():
            self._states, result = self._step(self._states, steps)
        return jax.tree.map(np.asarray, result)

    def ahead(self, duty: Float[np.ndarray, "lanes cells"]) -> Moment:
        """The readings of all lanes that are expected in a minute with the duty held, with the
        spread of those that are expected now."""
        self._bind()
        count = math.ceil(HORIZON / self._longest - 1e-9)
        with own_settings():
            result = self._ahead(self._states[0], duty, np.full(count, HORIZON / count))
        return Moment(*map(np.asarray, result))

    def kalman(self, lane: int) -> KalmanState:
        """What the observer of a lane knows."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[lane], self._states[0])

    def packed(self, lane: int) -> bytes:
        """The state of a lane."""
        return b"".join(np.asarray(leaf)[lane].tobytes() for leaf in jax.tree.leaves(self._states))

    def unpack(self, lane: int, content: bytes) -> bool:
        """Gives a lane the state that `packed` gave; false if it is that of another structure."""
        leaves, structure = jax.tree.flatten(self._states)
        copies, place = [np.array(leaf) for leaf in leaves], 0
        for copy in copies:
            size = copy[lane].nbytes
            part = content[place : place + size]
            if len(part) < size:
                return False
            copy[lane] = np.frombuffer(part, copy.dtype).reshape(copy.shape[1:])
            place += size
        if place != len(content):
            return False
        self._states = jax.tree.unflatten(structure, copies)
        return True

    def _bind(self) -> None:
        """Brings the numbers of all lanes to the device, after one has changed."""
        if getattr(self, "_is_bound", False):
            return
        watchers = jax.tree.unflatten(self.structure[0], self._leaves)
        self._begin = begun_lanes.bind(watchers)
        self._step = stepped_lanes.bind(watchers)
        self._ahead = ahead_of_lanes.bind(watchers)
        self._is_bound = True


@persistent_jit_unoptimised
def begun_lanes(
    watchers: Watcher, first: Float[Array, " lanes"], duty: Float[Array, "lanes cells"]
) -> LaneState:
    """The states at the start."""

    def begin(watcher: Watcher, first: Array, duty: Array) -> LaneState:
        observer, monitor = watcher
        return observer.init(first, duty), monitor.init()

    return jax.vmap(begin)(watchers, first, duty)


@persistent_jit
def stepped_lanes(
    watchers: Watcher, states: LaneState, steps: LaneSteps
) -> tuple[LaneState, LaneResult]:
    """A step in all lanes."""
    return jax.vmap(_stepped)(watchers, states, steps)


@persistent_jit
def ahead_of_lanes(
    watchers: Watcher,
    states: KalmanState,
    duty: Float[Array, "lanes cells"],
    steps: Float[Array, " steps"],
) -> Moment:
    """What is expected after some steps, s. The covariance, into which most of the time would go,
    stays that of now."""

    def ahead(watcher: Watcher, state: KalmanState, duty: Array) -> Moment:
        observer, _ = watcher

        def move(state: KalmanState, dt: Array) -> tuple[KalmanState, None]:
            return observer.predict_mean(state, duty, dt), None

        later, _ = jax.lax.scan(move, state, steps)
        spread = jnp.sqrt(jnp.diag(observer.reading_covariance(state)))
        return Moment(observer.readings(later, jnp.nan), spread)

    return jax.vmap(ahead)(watchers, states, duty)


def _stepped(watcher: Watcher, state: LaneState, step: LaneSteps) -> tuple[LaneState, LaneResult]:
    observer, monitor = watcher
    kalman, tests = state
    predicted = observer.step(kalman, step.duty, step.dt)
    expected = observer.readings(predicted, step.ambient)
    is_there = jnp.isfinite(step.readings)
    updated = observer.update(predicted, step.readings, is_there, step.ambient)
    after, evidences = monitor.step(
        tests, observed_sample(updated, expected, step.readings, step.ambient, step.elapsed)
    )
    kalman = _chosen(step.reads, updated, _chosen(step.moves, predicted, kalman))
    result = LaneResult(
        joined(evidences), expected, updated.whitened, jnp.isfinite(kalman.mean).all()
    )
    return (kalman, _chosen(step.reads, after, tests)), result


def _chosen(which: Bool[Array | np.ndarray, ""], first: Tree, other: Tree) -> Tree:
    """One of two trees."""
    return jax.tree.map(lambda new, old: jnp.where(which, new, old), first, other)


def _leaves(watcher: Watcher) -> list[Any]:
    leaves = jax.tree.leaves(watcher)
    assert all(eqx.is_array(leaf) for leaf in leaves)
    return leaves
