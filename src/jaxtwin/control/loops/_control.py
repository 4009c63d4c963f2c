"""A controller on a live rig, behind all interlocks."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import ArrayLike

from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit
from ..._jax_settings import own_settings
from ..._progress import announced
from ...errors import ControlError, SafetyStop, SimulationError
from ...io import Experiment
from ...live import Document, Ending, Finding, Guard, Moment, RecordConsumer, RigConnection, operate
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...simulation import Run, Stepper, assembled, check_values
from ..controllers._controller import AbstractController, is_same
from ..controllers._function_controller import ControlFunction, as_controller
from ._closed_loop import run_loop
from ._closed_loop_run import ClosedLoopRun
from ._loop_checks import check_cells, check_reach, check_sample_time, slowest_time_constant
from ._loop_margins import LoopMargins, check_stability, loop_margins
from ._references import reference_samples, references_ahead, sample_times
from ._scenario import scenario
from ._soft_limits import ExceededLimit, exceeded_soft_limits


@announced("closed loop")
def simulate_closed_loop(
    twin: Twin | Fit,
    controller: AbstractController | ControlFunction,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    **settings: Any,
) -> ClosedLoopRun:
    """Simulates a controller on a twin. `simulate_closed_loops` does it for many draws.

    ```python
    pid = jaxtwin.control.PID(Kp=0.1, Ki=0.001)
    run = jt.simulate_closed_loop(twin, pid, "0:35,600:45", duration=1800)
    run.measures()
    ```

    The controller reads the channels at its sample time, with the noise that the rig file states.
    The commanded duty is rounded to the driver's counts. The plant is solved in the steps of
    `Stepper`, with the driver's delay and lag. If a reading is lost or NaN, the controller receives
    the last one again. After `silence` without a reading, the cells are off for the rest of the
    run, as `jaxtwin control` switches a rig off; `switched_off` of the result says from when on.

    **Arguments:**

    - `twin`: the twin; or a fit, whose recordings' own values are averaged (`Fit.mean_twin`), as in
      `linearize`.
    - `controller`: a controller; or a function `(time_s, reference, measurement) -> duty` in
      `jax.numpy`, whose outputs are all channels.
    - `references`: the references of the outputs, degC: a number; text such as `"0:35,600:45"`,
      `"0:35/37"`, or with changes that take time `"0:16,ramp 600:40"` and the smooth
      `"0:16,curve 600:40"`; or an array `(outputs,)` or `(samples, outputs)`.
    - `duration`: the duration, s, a multiple of the controller's sample time.
    - `settings`: the further keywords of `jaxtwin.control.scenario`: disturbances, noise, faults,
      delays.

    **Returns:** a `ClosedLoopRun`.

    **Raises:** `ControlError` if twin, controller, references and settings do not fit each other,
    or if a reference is out of reach; `ParameterError` for an invalid parameter of the twin;
    `SimulationError` if the temperatures or the duty do not stay finite.
    """
    where = "simulate_closed_loop"
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    check_values(plant)
    sample_time = settings.pop("sample_time_s", None)
    chosen = as_controller(f"{where}: controller", controller, plant.rig, sample_time)
    conditions = scenario(plant, chosen, references, duration=duration, **settings)
    with own_settings():
        stepper = Stepper(plant, conditions.step, longest_delay=conditions.longest_delay)
        loop = jax.tree.map(np.asarray, run_loop(stepper, chosen, conditions))
    if not (np.isfinite(loop.nodes).all() and np.isfinite(loop.duty).all()):
        raise SimulationError(
            f"{plant.rig.name}: closed loop: the temperatures or the duty do not stay finite; look "
            "at the controller's parameters"
        )
    ambient = np.asarray(conditions.ambient).reshape(-1)[: len(loop.time)]
    names = chosen.output_names(plant.channels)
    limits, off = chosen.channel_limits(), conditions.switched_off
    return ClosedLoopRun.of(plant, loop, names, ambient, limits, off, is_linear=chosen.is_linear)


# A moment less than this before a sample counts as the sample, s.
SAMPLE_TOLERANCE = 1e-6

# The least number of samples for which a loop with constant references is simulated.
MIN_PLAN_SAMPLES = 1024

# The time after which a loop with constant references has usually come to rest, in slowest time
# constants of the rig; and the change of a reading in the last eighth of it with which it has, K.
SETTLED_TIME_CONSTANTS, SETTLED_KELVIN = 8.0, 0.05


class Decision(NamedTuple):
    """A sample of a controller on a live rig.

    - `time`: the time since the run began, in that of the rig, s.
    - `reference`, `measurement`: reference and measurement of each output, degC.
    - `duty`: the duty of each cell until the next sample, -1 to 1.
    """

    time: float
    reference: Float[np.ndarray, " outputs"]
    measurement: Float[np.ndarray, " outputs"]
    duty: Float[np.ndarray, " cells"]


def control(
    connection: RigConnection,
    guard: Guard,
    loop: "LiveLoop",
    *,
    accept: bool = False,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    consumers: Sequence[RecordConsumer] = (),
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
    on_end: Callable[[Ending], None] | None = None,
    on_decision: Callable[[Decision], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Runs a controller on a live rig. The cells are off when the function returns or raises.

    The controller is sampled in the time of the rig. Its decisions are recorded beside the
    readings: one document of the kind `decision` for each sample, with time, references,
    measurements and duty.

    **Arguments:**

    - `connection`: the started links of the rig.
    - `guard`: the guard of this run, such as `Guard.of(twin)`.
    - `loop`: the controller with its references, which `LiveLoop` has checked against the twin.
    - `accept`: whether the loop is run although the twin says that the rig would exceed its limit,
      until an interlock stops it.
    - `reset`, `about`, `stop`, `consumers`, `on_progress`, `on_alarm`, `on_end`: as in
      `jaxtwin.live.operate`.
    - `on_decision`: called with each decision, while the rig waits for its command.

    **Returns:** `"completed"` at the end of the duration, `"stopped"` if `stop` was set before.

    **Raises:** `SafetyStop` if an interlock trips, if the rig does not start, or if the controller
    returns something other than duty cycles; `JaxtwinError` if the rig would exceed its limit.
    """
    if not accept:
        guard.check_plan(loop.simulated_plan())
    return operate(
        connection,
        guard,
        loop.recorded(connection, on_decision),
        reset=reset,
        about={"control": loop.plan, **(about or {})},
        stop=stop,
        consumers=consumers,
        on_progress=on_progress,
        on_alarm=on_alarm,
        on_end=on_end,
    )


def checked_loop(
    twin: Twin,
    controller: AbstractController,
    references: Any,
    duration: float | int,
    ambient: float | int | None = None,
) -> Float[np.ndarray, "samples outputs"]:
    """Checks a loop before it runs on a rig, and returns the references at its samples, degC.

    `ambient` is the temperature of the room, degC; None: that of the rig file.

    **Raises:** `ControlError` for a controller of another number of cells, invalid references,
    references out of reach, a sample time above the time constants of the rig, a duration that is
    not a multiple of the sample time, or a loop that is not stable.
    """
    weights = np.asarray(controller.output_weights(twin.channels), float)
    times = sample_times("control", duration, controller.sample_time_s)
    samples = reference_samples("control: references", references, times, len(weights))
    with own_settings():
        system = assembled(twin)
        room = (
            float(system.ambient_temperature) - ZERO_CELSIUS if ambient is None else float(ambient)
        )
        check_cells("control", controller, twin.rig, len(weights))
        check_sample_time(system, controller.sample_time_s)
        surroundings = np.full((1, 1), room)
        # One sample stands for all of constant references: the checks are compiled for a number.
        few = samples[:1] if (samples == samples[0]).all() else samples
        check_reach(system, weights, few, times[: len(few)], surroundings, controller.limits)
        check_stability(twin, controller, weights, few)
    return samples


@final
class LiveLoop:
    """A controller in the form of a command, which `operate` calls for the duty.

    The duty is held between two samples. If `operate` calls later than the next sample, the samples
    in between are left out. The controller never receives a reading that is not a number: the last
    valid one of that channel replaces it, and after `silence` without one the run stops, as in
    `simulate_closed_loop`. The cells stay off until the first reading. (The interlocks of `operate`
    react faster: a channel that reports its failure stops the rig at the next frame.)

    **Arguments:**

    - `twin`: the twin of the rig, for which the loop is checked.
    - `controller`: the controller that commands the cells.
    - `references`: as in `simulate_closed_loop`.
    - `duration`: the duration in the time of the rig, s, a multiple of the sample time.
    - `silence`: the longest time without a reading, in the time of the rig, s.
    - `ambient`: the temperature of the room, degC; None: that of the rig file.

    **Raises:** `ControlError` for a controller of another number of cells, invalid references,
    references out of reach, a sample time above the time constants of the rig, and a loop of a
    linear controller that is not stable.
    """

    def __init__(
        self,
        twin: Twin,
        controller: AbstractController,
        references: object,
        *,
        duration: float | int,
        silence: float | int = 3.0,
        ambient: float | int | None = None,
    ):
        controller = controller.for_rig(twin.rig)
        text = references if isinstance(references, str) else np.asarray(references).tolist()
        self._duration = float(duration)
        self.plan = {"references": text, "duration_s": self._duration}
        """References and duration, for the recording."""
        self.decision: Decision | None = None
        """The last decision; None before the first."""
        self._twin, self._controller = twin, controller
        self._decide = _step.bind(controller)
        self._weights = np.asarray(controller.reading_weights(twin.channels), float)
        self._ambient = ambient
        self._references = checked_loop(twin, controller, references, duration, ambient)
        self._ahead = references_ahead(self._references, controller.preview_samples)
        with own_settings():
            # Compiled here, because messages of a connected rig would wait during a compilation.
            off = np.zeros(len(twin.rig.driven))
            still = self._references[0]
            readings = np.full(len(self._weights) + controller.reads_room, still[0])
            self._state: Any = jax.tree.map(np.asarray, _begun(controller, off, readings))
            self._decide(self._state, self._ahead[0], readings)
        self._silence = float(silence)
        self._sample: int | None = None
        self._taken_over: Float[np.ndarray, " cells"] | None = None
        self._time = self._phase = 0.0
        self._duty = np.zeros(len(twin.rig.driven))
        self._lowest = np.array(twin.rig.lowest_duty)
        self._limits = controller.channel_limits()
        self._exceeded: dict[tuple[str, float], ExceededLimit] = {}

    def continue_from(self, other: "LiveLoop") -> None:
        """Takes over the state of another loop of the same controller, whose references and
        duration end here: its integrals and its samples go on. From a loop of another controller it
        takes over the duty."""
        if other._sample is None:
            return
        if not is_same(other._controller, self._controller):
            self._taken_over = self._duty = other._duty
            return
        self._state, self._duty, self._sample = other._state, other._duty, 0
        passed = other._time + other._phase - other._sample * self._controller.sample_time_s
        self._phase = max(passed, 0.0)

    def simulated_plan(self) -> Experiment:
        """The duty with which the controller holds the references on the twin, which begins at the
        temperature of the room; with `Guard.check_plan`, what the rig would reach."""
        references = self._references
        if not (references == references[0]).all():
            return self._simulated(references).experiment
        # A loop that has come to rest stays there: a day at one reference is seen in some hours.
        with own_settings():
            tau = abs(float(slowest_time_constant(assembled(self._twin))))
        # A rig that loses no heat never settles, and its slowest rate is a rounding error of either
        # sign: it is simulated to the end.
        settled = min(
            SETTLED_TIME_CONSTANTS * tau / self._controller.sample_time_s, len(references)
        )
        run = self._held(math.ceil(settled))
        part = len(run.time) // 8
        earlier, later = run.temperatures[-2 * part : -part], run.temperatures[-part:]
        drift = np.abs(later.mean(axis=0) - earlier.mean(axis=0)).max()
        if settled < len(references) and drift > SETTLED_KELVIN:
            run = self._held(len(references))
        return run.experiment

    def _held(self, samples: int) -> Run:
        """A run at the first references."""
        # Few lengths, because each is compiled: it is simulated for longer than it lasts.
        samples = max(2 ** (samples - 1).bit_length(), MIN_PLAN_SAMPLES)
        return self._simulated(np.repeat(self._references[:1], samples, axis=0))

    def _simulated(self, references: Float[np.ndarray, "samples outputs"]) -> Run:
        return simulate_closed_loop(
            self._twin,
            self._controller,
            references,
            duration=(len(references) - 1) * self._controller.sample_time_s,
            initial=self._ambient,
            ambient=self._ambient,
            noise=False,
        ).run

    def margins(self) -> LoopMargins | None:
        """Computes the margins of the loop at the last references; None for a controller that is
        not linear."""
        if not self._controller.is_linear:
            return None
        return loop_margins(self._twin, self._controller, self._references[-1])

    @property
    def exceeded(self) -> tuple[ExceededLimit, ...]:
        """The temperature limits of the controller that the readings exceeded until now."""
        return tuple(self._exceeded.values())

    def __call__(self, moment: Moment) -> Float[np.ndarray, " cells"] | None:
        """Returns the duty at a moment; None at the end of the run."""
        self._time = moment.time
        if moment.time >= self._duration - SAMPLE_TOLERANCE:
            return None
        passed = moment.time + self._phase + SAMPLE_TOLERANCE
        sample = int(passed / self._controller.sample_time_s)
        if self._sample is not None and sample <= self._sample:
            return self._duty
        measurement = self._measured(moment)
        if measurement is None:
            return self._duty
        with own_settings():
            if self._sample is None:
                self._state = self._begin(moment, measurement)
            ahead = self._ahead[min(sample, len(self._ahead) - 1)]
            asked, state = self._decide(self._state, ahead, measurement)
            self._state = jax.tree.map(np.asarray, state)
        duty = np.asarray(asked, float)
        if duty.shape != self._duty.shape or not np.isfinite(duty).all():
            raise SafetyStop(f"stopped: the controller asked for duty {duty}", "controller")
        self._sample, self._duty = sample, np.clip(duty, self._lowest, 1.0)
        reference = self._references[min(sample, len(self._references) - 1)]
        outputs = measurement[: len(reference)]
        watched = measurement[None, len(reference) : len(self._weights)]
        for limit in exceeded_soft_limits(
            self._limits, [*self._limits], np.array([moment.time]), watched
        ):
            key = limit.channel, limit.limit
            self._exceeded[key] = limit.after(self._exceeded.get(key))
        self.decision = Decision(moment.time, reference, outputs, self._duty)
        return self._duty

    def _begin(self, moment: Moment, measurement: Float[np.ndarray, " readings"]) -> PyTree:
        """Returns the state of the first sample."""
        duty = np.asarray(moment.duty, float)
        if (before := self._taken_over) is not None:
            # A state knows no reference. What the error of this moment would add to the duty is
            # taken off, so that the duty goes on where it is.
            begun = _begun(self._controller, before, measurement)
            asked, _ = self._decide(begun, self._ahead[0], measurement)
            duty = 2 * before - np.asarray(asked, float)
        return jax.tree.map(np.asarray, _begun(self._controller, duty, measurement))

    def recorded(
        self,
        connection: RigConnection,
        on_decision: Callable[[Decision], None] | None = None,
    ) -> Callable[[Moment], Float[np.ndarray, " cells"] | None]:
        """Returns the loop as a command that notes its decisions in the recording of a connection.

        **Arguments:** those of `control`.
        """

        def duty(moment: Moment) -> Float[np.ndarray, " cells"] | None:
            before = self.decision
            asked = self(moment)
            decision = self.decision
            if decision is not None and decision is not before:
                content = {
                    name: np.asarray(value).tolist() for name, value in decision._asdict().items()
                }
                connection.note(Document(connection.clock.now(), "decision", "control", content))
                if on_decision is not None:
                    on_decision(decision)
            return asked

        return duty

    def _measured(self, moment: Moment) -> Float[np.ndarray, " readings"] | None:
        """Returns the measurement by the last valid readings; None before the first.

        **Raises:** `SafetyStop` if a reading that the controller uses is too old.
        """
        used = (self._weights != 0).any(axis=0)
        if np.isnan(moment.temperatures).any():
            waited, measurement = moment.time, None
        else:
            waited = float(moment.age[used].max(initial=0.0))
            measurement = self._weights @ moment.temperatures
            if self._controller.reads_room:
                room = np.nan if moment.ambient is None else moment.ambient
                measurement = np.append(measurement, room)
        if waited > self._silence:
            raise SafetyStop(
                f"stopped: the controller has had no reading that it uses for {waited:.1f} s",
                "controller",
            )
        return measurement


@persistent_jit
def _begun(
    controller: AbstractController,
    duty: Float[Array | np.ndarray, " cells"],
    measurement: Float[Array | np.ndarray, " readings"],
) -> PyTree:
    return controller.init(duty, measurement)


@persistent_jit
def _step(
    controller: AbstractController,
    state: PyTree,
    reference: Float[Array | np.ndarray, "*preview outputs"],
    measurement: Float[Array | np.ndarray, " readings"],
) -> tuple[Float[Array, " cells"], PyTree]:
    return controller.step(state, reference, measurement)
