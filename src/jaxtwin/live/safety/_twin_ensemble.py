"""Twins beside a rig, one for each draw of what a match does not know."""

from collections.abc import Mapping
from typing import final

import jax
import numpy as np
from jaxtyping import Array, Float

from ..._compilation import persistent_jit
from ...observers import OpenLoop, OpenLoopState
from ...physics import Twin
from ._duty_response import DutyResponse, step_and_read

STEP_SECONDS = 0.5
"""The step of the twins, s of the rig, within which no plate becomes much hotter."""

DRIVEN, IDLE = range(2)

Draws = Mapping[str, Float[np.ndarray, " draws"]]
"""Parameter -> its values in random draws, as `jaxtwin.matching.posterior_draws` gives them."""


@final
class TwinEnsemble:
    """Twins in open loop, each with other parameters. They get the duty and the room of the rig and
    none of its readings, which a covered sensor would falsify.

    Each draw runs twice, with the duty of the rig and without any. All start at the temperatures at
    which `DutyResponse` starts.

    **Arguments:**

    - `twin`: the twin of the rig.
    - `draws`: values of some of its parameters; None: only those of the twin.
    """

    def __init__(self, twin: Twin, draws: Draws | None = None):
        values = {name: np.asarray(column, np.float64) for name, column in (draws or {}).items()}
        count = len(next(iter(values.values()))) if values else 1
        self.twins = [
            twin.with_values({name: float(column[draw]) for name, column in values.items()})
            for draw in range(count)
        ]
        """The twin of each draw."""
        with jax.enable_x64(True):
            observers = [OpenLoop(each, step_size=STEP_SECONDS) for each in self.twins]
            if len({each.stepper.queue for each in observers}) > 1:
                # Only a driver with a delay has a queue of commands, which must be of one length.
                longest = max(float(each.stepper.system.delay or 0.0) for each in observers)
                observers = [
                    OpenLoop(each, step_size=STEP_SECONDS, longest_delay=longest)
                    for each in self.twins
                ]
        self._template, self._count = observers[0], count
        # All have the same structure, so that their numbers can be stacked.
        columns = zip(*map(jax.tree.leaves, observers), strict=True)
        stacked = [np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in columns]
        self._step_all = _stepped.bind(
            jax.tree.unflatten(jax.tree.structure(observers[0]), stacked)
        )
        self._duty = np.zeros((2, len(twin.rig.driven)))
        self._heat, self._last = np.zeros((2, len(twin.rig.driven)))  # duty times time; duty
        self._stepped: float | None = None  # the time of the last step, s of the rig
        self._seen = 0.0
        self._set(np.full(len(twin.netlist.nodes), 20.0))  # this compiles the steps
        self._step(0.0, 20.0)

    @property
    def count(self) -> int:
        """The number of draws."""
        return self._count

    @property
    def nodes(self) -> Float[np.ndarray, "draws nodes"]:
        """The temperatures of all nodes with the duty of the rig, degC."""
        return np.asarray(self._states.twin.nodes)[:, DRIVEN]

    @property
    def readings(self) -> Float[np.ndarray, "draws channels"]:
        """The readings with the duty of the rig, degC."""
        return self._readings[:, DRIVEN]

    @property
    def by_duty(self) -> Float[np.ndarray, "draws channels"]:
        """The change of the readings by the duty since the start, K."""
        return self._readings[:, DRIVEN] - self._readings[:, IDLE]

    def follow(self, response: DutyResponse) -> None:
        """Goes on to the time of the twins of a `DutyResponse`, with the duty until then."""
        now = response.elapsed
        if self._stepped is None:
            self._set(response.nodes)
            self._stepped = self._seen = now
        # A duty may change within a step, so that its mean counts: a controller that pulses in step
        # with these twins would otherwise heat unseen.
        self._heat += self._last * (now - self._seen)
        self._seen, self._last = now, response.duty
        waited = now - self._stepped
        if waited >= STEP_SECONDS:
            self._duty[DRIVEN] = self._heat / waited
            self._step(waited, response.room)
            self._stepped, self._heat = now, np.zeros_like(self._heat)

    def _set(self, nodes: Float[np.ndarray, " nodes"]) -> None:
        with jax.enable_x64(True):
            start = self._template.init(nodes, self._duty[IDLE])
        self._states: OpenLoopState = jax.tree.map(
            lambda leaf: np.broadcast_to(np.asarray(leaf), (self._count, 2, *np.shape(leaf))), start
        )

    def _step(self, dt: float, room: float) -> None:
        with jax.enable_x64(True):
            states, readings = self._step_all(
                self._states, self._duty, np.float64(room), np.float64(dt)
            )
        # The states are kept as NumPy arrays, because they are read between two steps.
        self._states = jax.tree.map(np.asarray, states)
        self._readings = np.asarray(readings)


@persistent_jit
def _stepped(
    observers: OpenLoop,
    states: OpenLoopState,
    duty: Float[Array, "2 cells"],
    room: Float[Array, ""],
    dt: Float[Array, ""],
) -> tuple[OpenLoopState, Float[Array, "draws 2 channels"]]:
    """The twins of all draws after a time, and their readings."""
    of_draw = jax.vmap(step_and_read, in_axes=(None, 0, 0, None, None))
    return jax.vmap(of_draw, in_axes=(0, 0, None, None, None))(observers, states, duty, room, dt)
