"""Twins beside a rig, one for each draw of what a match does not know."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._compilation import persistent_jit
from ...io import Experiment
from ...observers import OpenLoop, OpenLoopState
from ...physics import Twin
from ...simulation import Stepper, StepperState, assembled
from ._duty_response import DutyResponse, seen_nodes, step_and_read

# The step of the twins, s of the rig, within which no plate becomes much hotter.
STEP_SECONDS = 0.5

# The steps in which twins are followed after a stop.
STOP_STEPS = 16

# The step of the twins in a plan, s: 0.02 K from shorter ones on the bundled rigs.
PLAN_STEP_SECONDS = 10.0

# A plan is divided into a power of two of steps, whose duty is averaged, so that few programs are
# compiled. Those of a plan of more than two days are longer.
MIN_PLAN_STEPS, MAX_PLAN_STEPS = 128, 16_384

DRIVEN, IDLE = range(2)

# Parameter -> its values in random draws, as `jaxtwin.matching.posterior_draws` gives them.
Draws = Mapping[str, Float[np.ndarray, " draws"]]


class PlannedRun(NamedTuple):
    """What draws of a twin do in a plan.

    - `time`: the times since the start, s.
    - `nodes`, `readings`: the temperatures of the nodes and of the channels, degC; in the hottest
      rows the highest ones after that time if the duty ended then.
    """

    time: Float[np.ndarray, " rows"]
    nodes: Float[np.ndarray, "rows draws nodes"]
    readings: Float[np.ndarray, "rows draws channels"]


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
        self._twins = [
            twin.with_values({name: float(column[draw]) for name, column in values.items()})
            for draw in range(count)
        ]
        self._count = count
        self._template, stacked = _stacked(self._twins, STEP_SECONDS)
        self._step_all = _stepped.bind(stacked)
        # A power of two, so that other values of the parameters need no other program.
        longer = _seconds_to_cool(twin) / (STOP_STEPS * STEP_SECONDS)
        step = STEP_SECONDS * 2.0 ** max(0, round(math.log2(longer)))
        stopping, all_stopping = _stacked(self._twins, step)
        self._all_stopping = all_stopping.stepper
        self._stop_all = _stopped.bind(self._all_stopping)
        # The same commands are on their way through the driver's delay, one for each long step.
        transit = round(step / STEP_SECONDS) * np.arange(stopping.stepper.queue)
        self._transit = np.minimum(transit, max(self._template.stepper.queue - 1, 0))
        self._duty = np.zeros((2, len(twin.rig.driven)))
        self._heat, self._last = np.zeros((2, len(twin.rig.driven)))  # duty times time; duty
        self._stepped: float | None = None  # the time of the last step, s of the rig
        self._seen = 0.0
        self._set(np.full(len(twin.netlist.nodes), 20.0))
        self.step(0.0, 20.0)
        _ = self.after_stop  # both programs are compiled before the first data arrive

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
    def idle_readings(self) -> Float[np.ndarray, "draws channels"]:
        """The readings without any duty, degC."""
        return self._readings[:, IDLE]

    @property
    def by_duty(self) -> Float[np.ndarray, "draws channels"]:
        """The change of the readings by the duty since the start, K."""
        return self.readings - self.idle_readings

    @property
    def after_stop(
        self,
    ) -> tuple[Float[np.ndarray, "draws nodes"], Float[np.ndarray, "draws channels"]]:
        """The highest temperatures of nodes and channels now and, if the duty ended now, after it,
        degC."""
        if self._after_stop is None:
            driven = jax.tree.map(lambda leaf: leaf[:, DRIVEN], self._states.twin)
            with jax.enable_x64(True):
                hottest = self._stop_all(driven, self._transit, np.float64(self._room))
            self._after_stop = np.asarray(hottest[0]), np.asarray(hottest[1])
        return self._after_stop

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
            self.step(waited, response.room)
            self._stepped, self._heat = now, np.zeros_like(self._heat)

    def step(self, dt: float, room: float) -> None:
        """Steps all twins by `dt` s of the rig in a room of `room` degC."""
        with jax.enable_x64(True):
            states, readings = self._step_all(
                self._states, self._duty, np.float64(room), np.float64(dt)
            )
        # The states are kept as NumPy arrays, because they are read between two steps.
        self._states = jax.tree.map(np.asarray, states)
        self._readings = np.asarray(readings)
        self._room, self._after_stop = room, None

    def branch(self, duty: Float[np.ndarray, " cells"]) -> None:
        """Lets both twins of each draw go on from where the driven one is: that one with a held
        `duty`, the other without any."""
        self._duty = np.array([duty, np.zeros_like(duty)])
        self._states = jax.tree.map(
            lambda leaf: np.repeat(leaf[:, [DRIVEN]], 2, axis=1), self._states
        )

    def run(self, plan: Experiment, initial: float | None) -> PlannedRun:
        """The draws with the duty and the room of a plan, which no rig has to wait for.

        **Arguments:**

        - `initial`: the temperature at the start, degC; None: that of the rig file.
        """
        duration = float(plan.time[-1] - plan.time[0])
        steps = max(math.ceil(duration / PLAN_STEP_SECONDS), MIN_PLAN_STEPS)
        count = min(2 ** (steps - 1).bit_length(), MAX_PLAN_STEPS)
        dt = PLAN_STEP_SECONDS * math.ceil(steps / count)
        edges = dt * np.arange(count + 1)
        room = np.nan if plan.ambient is None else plan.ambient
        rooms = np.interp(
            edges[1:], plan.time - plan.time[0], np.broadcast_to(room, plan.time.shape)
        )
        template, run = self._of_plans
        with jax.enable_x64(True):
            start = np.asarray(template.init(initial, self._duty[IDLE]).twin.nodes)
            seen = seen_nodes(template.stepper.system)
            nodes, readings = run(start, mean_duty(plan, edges), rooms, np.float64(dt), seen)
        return PlannedRun(edges[1:], np.asarray(nodes), np.asarray(readings))

    @cached_property
    def _of_plans(self) -> tuple[OpenLoop, Callable[..., Any]]:
        """An observer with the step of plans, and the program that follows a plan."""
        template, stacked = _stacked(self._twins, PLAN_STEP_SECONDS)
        return template, _followed.bind((stacked, self._all_stopping))

    def _set(self, nodes: Float[np.ndarray, " nodes"]) -> None:
        with jax.enable_x64(True):
            start = self._template.init(nodes, self._duty[IDLE])
        self._states: OpenLoopState = jax.tree.map(
            lambda leaf: np.broadcast_to(np.asarray(leaf), (self._count, 2, *np.shape(leaf))), start
        )


def mean_duty(
    plan: Experiment, edges: Float[np.ndarray, " edges"]
) -> Float[np.ndarray, "rows cells"]:
    """The mean duty of a plan between times since its start; 0 behind its end."""
    held = np.diff(plan.time)[:, None] * plan.duty[:-1]
    heat = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(held, axis=0)])
    since = plan.time - plan.time[0]
    at_edges = np.stack([np.interp(edges, since, column) for column in heat.T], axis=1)
    return np.diff(at_edges, axis=0) / np.diff(edges)[:, None]


def _seconds_to_cool(twin: Twin) -> float:
    r"""The time after the end of the duty from which a rig certainly cools, s: the driver's delay,
    two of its lags, and twice the time after which a pulse of heat into one side of a cell, or into
    a heater, has warmed the part that it warms the most.

    The response of a network without cells to a pulse is
    $C^{-1/2} V e^{-\Lambda t} V^T C^{-1/2}$, with the eigenvectors $V$ of $C^{-1/2} G C^{-1/2}$.
    """
    with jax.enable_x64(True):
        system = assembled(twin)
    scale = 1 / np.sqrt(np.asarray(system.capacitance))
    rates, vectors = np.linalg.eigh(scale[:, None] * np.asarray(system.conductance) * scale)
    shapes = scale[:, None] * vectors
    seen = shapes[seen_nodes(system)]
    times = np.geomspace(0.1, 1e6, 200)
    decay = np.exp(-rates[:, None] * times)
    to_peak = 0.0
    for sides in zip(system.wiring.cold, system.wiring.hot, strict=True):
        # Of the two sides of a cell, the one that is nearer to what is seen warms it more.
        responses = np.concatenate([seen @ (shapes[side][:, None] * decay) for side in sides])
        most = responses[np.argmax(responses.max(axis=1))]
        to_peak = max(to_peak, float(times[np.argmax(most)]))
    return 2 * to_peak + float(system.delay or 0.0) + 2 * float(system.lag or 0.0)


def _stacked(twins: Sequence[Twin], step_size: float) -> tuple[OpenLoop, OpenLoop]:
    """The observer of the first twin, and those of all with their numbers stacked, which the same
    structure allows."""
    with jax.enable_x64(True):
        observers = [OpenLoop(each, step_size=step_size) for each in twins]
        if len({each.stepper.queue for each in observers}) > 1:
            # Only a driver with a delay has a queue of commands, which must be of one length.
            longest = max(float(each.stepper.system.delay or 0.0) for each in observers)
            observers = [
                OpenLoop(each, step_size=step_size, longest_delay=longest) for each in twins
            ]
    columns = zip(*map(jax.tree.leaves, observers), strict=True)
    stacked = [np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in columns]
    return observers[0], jax.tree.unflatten(jax.tree.structure(observers[0]), stacked)


def _hottest(
    stepper: Stepper, state: StepperState, room: Float[Array, ""]
) -> tuple[Float[Array, " nodes"], Float[Array, " channels"]]:
    """The highest temperatures of nodes and channels from a state on without duty, degC."""

    def seen(state: StepperState) -> tuple[Array, Array]:
        return jnp.asarray(state.nodes), stepper.channels(state, room)

    def take(carry: tuple[StepperState, Any], _: None) -> tuple[tuple[StepperState, Any], None]:
        state, hottest = carry
        state = stepper.step(state, jnp.zeros_like(state.duty), room)
        return (state, jax.tree.map(jnp.maximum, hottest, seen(state))), None

    return jax.lax.scan(take, (state, seen(state)), length=STOP_STEPS)[0][1]


@persistent_jit
def _followed(
    twins: tuple[OpenLoop, Stepper],
    start: Float[Array, " nodes"],
    duty: Float[Array, "rows cells"],
    rooms: Float[Array, " rows"],
    dt: Float[Array, ""],
    seen: Bool[Array, " nodes"],
) -> tuple[Float[Array, "rows draws nodes"], Float[Array, "rows draws channels"]]:
    """The temperatures of nodes and channels of all draws after each row of a plan, degC. The rows
    that are hottest, if the last change goes on, hold the highest ones from there on without duty:
    an interlock that follows a stop would meet its limit there."""

    def of_draw(observer: OpenLoop) -> tuple[Array, Array, Array]:
        def take(state: OpenLoopState, row: tuple[Array, Array]) -> tuple[OpenLoopState, Any]:
            state, readings = step_and_read(observer, state, *row, dt)
            return state, (observer.nodes(state), readings, state.twin.duty)

        begun = observer.init(start, jnp.zeros_like(duty[0]))
        return jax.lax.scan(take, begun, (duty, rooms))[1]

    def stopped(
        stepper: Stepper, nodes: Array, lagged: Array, command: Array, room: Array
    ) -> tuple[Array, Array]:
        room = jnp.where(jnp.isnan(room), stepper.ambient, room)  # one that nobody measures
        transit = jnp.broadcast_to(command, (stepper.queue, *command.shape))
        return _hottest(stepper, StepperState(nodes, lagged, transit), room)

    observers, stopping = twins
    nodes, readings, lagged = jax.vmap(of_draw, out_axes=1)(observers)
    mean = nodes.mean(axis=1)
    ahead = mean + jnp.maximum(jnp.diff(mean, axis=0, prepend=mean[:1]), 0.0)
    _, rows = jax.lax.top_k(jnp.where(seen, ahead, -jnp.inf).max(axis=1), MIN_PLAN_STEPS)
    of_rows = jax.vmap(jax.vmap(stopped, (0, 0, 0, None, None)), (None, 0, 0, 0, 0))
    hottest = of_rows(stopping, nodes[rows], lagged[rows], duty[rows], rooms[rows])
    return nodes.at[rows].set(hottest[0]), readings.at[rows].set(hottest[1])


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


@persistent_jit
def _stopped(
    stopping: Stepper,
    states: StepperState,
    transit: Int[Array, " long_steps"],
    room: Float[Array, ""],
) -> tuple[Float[Array, "draws nodes"], Float[Array, "draws channels"]]:
    """As `_hottest`, of all draws."""

    def of_draw(stepper: Stepper, state: StepperState) -> tuple[Array, Array]:
        return _hottest(stepper, replace(state, commands=state.commands[transit]), room)

    return jax.vmap(of_draw)(stopping, states)
