r"""Model predictive control with hard limits of the duty and of its rate, and soft ones of
temperatures.

Each sample minimises, over the duty of the next $n$ samples,

$$\sum_{k=1}^{n - 1} \left[\left(\frac{y_k - y^*_k}{\Delta y}\right)^2
+ \left(\frac{u_{k-1} - u^*_k}{\Delta u}\right)^2\right]
+ \sum_{k=1}^{n} \left(\frac{u_{k-1} - u_{k-2}}{\delta u}\right)^2 + V(x_n, u_{n-1})
+ \sum_{k=1}^{n} \sum_i \left(\frac{e_{i,k}}{\Delta e}\right)^2$$

within the limits, and commands the duty of the first sample. $e_{i,k}$ is the excess of channel i
over its limit. $y^*_k$ and $u^*_k$ are the steady state with the reference of sample $k - 1$ under
the disturbance that the Kalman filter estimates, or the nearest steady state within the limits. $V$
is the cost of an infinite horizon without limits: where no limit is active, the controller is the
linear-quadratic regulator, whatever the horizon (Rawlings, Mayne and Diehl, *Model Predictive
Control*, 2017, chapters 1 and 2).

With points that are to be even, $u^*$ is the duty of the least `AbstractEvennessCost` that holds
the references, and a point that is farther from the centre than the farthest at rest, $h_k$, has an
excess as if that were its limit: $|y_{i,k} - c_k| \le 1.03\,h_k + e_{i,k}$. For a range the centre
$c_k$ is free. $h_k$ is what the model expects at rest without disturbances, and an allowance that
slowly follows what the disturbances make of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._arguments import names_of, true_or_false, whole_number
from ..._name_suggestions import unknown_name
from ..._quadratic_program import QuadraticProgram, minimised
from ...errors import ControlError
from ..linear._state_space import StateSpace, checked_discrete_model
from ._controller import (
    AbstractController,
    DutyLimits,
    Law,
    Numbers,
    TemperatureLimit,
    accepts_design_arguments,
    checked_deviations,
    checked_measured,
    means_of,
    redesign_weights,
)
from ._controller_fields import (
    OWN,
    REQUIRED_OWN,
    ControllerField,
    FileContents,
)
from ._design_model import (
    AbstractModelController,
    check_plant,
    outputs_of,
    with_observer,
    with_temperatures,
)
from ._duty_limits import GivenLimits, checked_limits
from ._kalman import (
    KalmanFilter,
    TwinEstimator,
    TwinObserver,
    error_gain,
    kalman_filter,
    refuse_observed,
)
from ._model_file import (
    MODEL_FIELDS,
    check_numbers,
    limited_channels,
    read_filter,
    read_model,
)
from ._mpc_file import mpc_lines, mpc_settings, read_evenness
from ._mpc_law import mpc_law
from ._mpc_programs import (
    ROOM_ON_THE_WAY,
    AbstractEvennessCost,
    Condensed,
    Deviations,
    EvenPoints,
    Limits,
    Rest,
    SoftLimits,
    SoftTemperatures,
    WatchedChannels,
    condense,
    even_points,
    plan_program,
    predict,
    rest_program,
    soft_limits,
)
from ._predictive_controller import (
    DEFAULT_EXCESS,
    AbstractPredictiveController,
    accepted_excesses,
    check_horizon,
    checked_control_horizon,
    checked_evenness,
    checked_point_errors,
    checked_rate,
    checked_temperature_limits,
)

# How fast the allowance follows, relative to the slowest pole of the model. While a plate warms up,
# what is not linear in it looks like a disturbance that will be over at rest.
SLOWNESS = 1 / 3

_TEMPERATURE = ControllerField("a temperature difference", "K", "0.1 K")
_DUTY = ControllerField("a duty", "", "0.05", is_required=True)


class MPCNoises(NamedTuple):
    """The noises with which the filter of an `MPC` was designed."""

    drift: Float[Array | np.ndarray, " disturbances"]
    reading_noise: Float[Array | np.ndarray, " read"]


class MPCState(NamedTuple):
    """The state of an `MPC`: the predicted states (with an observer its estimate), the duty that
    the cells get, the errors of the model at the watched channels, and how much farther from their
    centre than the model expects the points are at rest, K."""

    states: PyTree
    duty: Float[Array, " cells"]
    errors: Float[Array, " watched"]
    allowance: Float[Array, ""]


class MPCPlant(NamedTuple):
    """The model of an `MPC`, with three sets of outputs: those that follow the references, the
    channels that are read beside them, first those with limits, and the points that are to be even.
    """

    outputs: StateSpace
    watched: StateSpace
    points: StateSpace

    @property
    def read(self) -> StateSpace:
        """The model of what the Kalman filter reads."""
        return self.watched if len(self.points.C) else self.outputs


@final
@dataclass(frozen=True, kw_only=True)
class MPCSettings:
    """What an `MPC` is designed for, as in `design_mpc`, beside its model and its filter. The
    fields that are no parameters of `design_mpc` are those of `MPC`."""

    measured: tuple[tuple[str, ...], ...] | None
    horizon: int
    control_horizon: int | None
    output_deviation: Numbers
    duty_deviation: Numbers
    duty_change_deviation: Numbers
    limits: DutyLimits
    has_own_limits: bool
    rate_limit: float | int | None = None
    temperature_limits: tuple[tuple[str, TemperatureLimit], ...]
    read_channels: tuple[str, ...]
    excess_deviation: float
    evenness: AbstractEvennessCost | None = None
    point_names: tuple[str, ...] = ()
    point_errors: Float[np.ndarray, "points channels"] | None = None
    preview: bool
    counts: int | None = None


@final
@accepts_design_arguments("design_mpc")
class MPC(AbstractPredictiveController, AbstractModelController):
    """Model predictive control, made by `design_mpc`.

    Without `preview` the controller uses the present reference for the whole horizon. `step` takes
    both: references `(outputs,)`, or `(horizon, outputs)`, those of this sample and of the next
    ones.

    **Arguments:** settings are those of `design_mpc`.

    - `model`: the model of the outputs. `gain`: its DC gain. `inverse`: the smallest duty that
      changes the outputs at rest by 1 K.
    - `condensed`, `soft`, `points`: the cost, the limited channels and the points that are to be
      even in the samples of the horizon.
    - `kalman`: the filter. `observed`: the filter with what an observer knows, if there is one.
    - `noises`: those of the filter's design; None for the filter of a file.
    - `watched`: the channels that are read beside the outputs. `of_channels`: the outputs as means
      of these; without points there are none of them.
    - `excess_deviation`: the accepted excess of each channel with limits, and then that of points,
      K.
    - `adaptation`: the part by which the allowance follows in a sample.
    - `read_channels`, `point_names`: the names of `watched`, first those with limits, and `points`.
    - `has_own_limits`: whether the limits hold on every rig.
    - `sample_time_s`: that of the model, s. `designed_for`: its rig; empty for that of no rig file.
    - `counts`: full duty in counts of the driver; None before the controller knows its rig.
    """

    kind: ClassVar[str] = "mpc"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        **MODEL_FIELDS,
        "horizon": REQUIRED_OWN,
        "control_horizon": OWN,
        "preview": OWN,
        "output_deviation": replace(_TEMPERATURE, is_required=True),
        "duty_deviation": _DUTY,
        "duty_change_deviation": _DUTY,
        "rate_limit": ControllerField("a rate of the duty", "1/s", "0.05 1/s"),
        "excess_deviation": _TEMPERATURE,
        "temperature_limits": OWN,
        "evenness": OWN,
    }

    model: StateSpace
    gain: Float[Array | np.ndarray, "outputs cells"]
    inverse: Float[Array | np.ndarray, "cells outputs"]
    condensed: Condensed
    soft: SoftLimits | None
    points: EvenPoints | None
    evenness: AbstractEvennessCost | None
    kalman: KalmanFilter
    observed: TwinEstimator | None
    noises: MPCNoises | None
    watched: WatchedChannels
    of_channels: Float[Array | np.ndarray, "outputs watched"]
    output_deviation: Float[Array | np.ndarray, " outputs"]
    duty_deviation: Float[Array | np.ndarray, " cells"]
    duty_change_deviation: Float[Array | np.ndarray, " cells"]
    excess_deviation: Float[Array | np.ndarray, " limited_and_points"]
    adaptation: Float[Array | np.ndarray, ""]
    temperature_limits: tuple[tuple[str, TemperatureLimit], ...] = eqx.field(static=True)
    read_channels: tuple[str, ...] = eqx.field(static=True)
    point_names: tuple[str, ...] = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    control_horizon: int = eqx.field(static=True)
    rate_limit: float | None = eqx.field(static=True)
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True, repr=False)
    sample_time_s: float = eqx.field(static=True)
    designed_for: str = eqx.field(static=True, repr=False)
    preview: bool = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)
    counts: int | None = eqx.field(static=True, repr=False, default=None)

    @property
    def is_linear(self) -> bool:
        """True within the limits; not with points that are to be even, because the most even rest
        lies where the hottest or the coldest point changes, and not with an observer."""
        is_smooth = self.evenness is None or self.evenness.is_quadratic
        return self.observed is None and is_smooth

    @property
    def needs_one_thread(self) -> bool:
        """True with points that are to be even: two such loops at once on the two threads of a
        processor with two cores give NaN in the first draws, and none on three threads, whatever
        XLA's options for its matrix products are (jax 0.10.2)."""
        return self.evenness is not None

    def design_weights(self) -> Mapping[str, Float[np.ndarray, "..."]]:
        """Returns accepted deviations and noises; none for a filter of a file, with an observer, or
        with points that are to be even."""
        if self.noises is None or self.observed is not None or self.points is not None:
            return {}
        named = {
            "output_deviation": self.output_deviation,
            "duty_deviation": self.duty_deviation,
            "duty_change_deviation": self.duty_change_deviation,
            **self.noises._asdict(),
        }
        return {name: np.asarray(part) for name, part in named.items()}

    def redesigned(self, weights: Mapping[str, Numbers]) -> AbstractController:
        """Returns the controller that the same model gives with other deviations and noises."""
        plant = MPCPlant(
            self.model,
            with_temperatures(self.model, np.asarray(self.watched.C), np.asarray(self.watched.at)),
            with_temperatures(self.model, np.zeros((0, len(self.model.A))), np.zeros(0)),
        )
        named = redesign_weights("MPC", self.design_weights(), weights)
        drift, reading_noise = named.pop("drift"), named.pop("reading_noise")
        settings = MPCSettings(
            **named,
            measured=self.measured,
            horizon=self.horizon,
            control_horizon=self.control_horizon,
            limits=self.limits,
            has_own_limits=True,
            rate_limit=self.rate_limit,
            temperature_limits=self.temperature_limits,
            read_channels=self.read_channels,
            excess_deviation=float(self.excess_deviation[-1]),
            preview=self.preview,
            counts=self.counts,
        )
        return _design(plant, drift, reading_noise, settings)

    def reading_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "readings channels"]:
        """Returns the weights of the outputs, those of the other channels that are read, and all
        channels for an observer."""
        watched = means_of([(name,) for name in self.read_channels], channels)
        weights = np.vstack([self.output_weights(channels), watched])
        return weights if self.observed is None else np.vstack([weights, np.eye(len(channels))])

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file: the model, the filter and the accepted deviations."""
        settings = mpc_settings(cls, contents)
        model = read_model(contents, settings["measured"])
        states = len(model.A)
        limited, even = limited_channels(contents, states), read_evenness(contents, states)
        names, C, at, gains = tuple(limited.limits), limited.C, limited.at, limited.L
        points = np.zeros((0, states)), np.zeros(0)
        if even is not None:
            channels, gains = even.channels, np.append(gains, [even.L] * len(even.channels.at))
            names = (*names, *channels.names)
            C, at = np.vstack([C, channels.C]), np.append(at, channels.at)
            points = even.points.C, even.points.at
            settings |= {
                "evenness": even.cost,
                "point_names": tuple(even.points.names),
                "point_errors": even.point_errors,
            }
        plant = MPCPlant(model, with_temperatures(model, C, at), with_temperatures(model, *points))
        kalman = read_filter(contents, plant.outputs, plant.read)
        excess = settings.setdefault("excess_deviation", DEFAULT_EXCESS)
        try:
            limits = checked_temperature_limits(limited.limits, None, excess)
            checked = MPCSettings(read_channels=names, temperature_limits=limits, **settings)
            mpc = _assembled(plant, kalman, gains, checked)
        except ControlError as error:
            contents.refuse("", str(error))
        check_numbers(mpc, contents.refuse)
        return mpc

    def file_lines(self) -> list[str]:
        """Returns the lines of the operating point, the deviations, the limits, and the model."""
        refuse_observed("save_controller: controller", self.observed)
        return mpc_lines(self)

    def law(self, cells: int) -> Law:
        """The law: its Kalman filter, its target at rest and its plan."""
        refuse_observed("export_c: model", self.observed)
        return mpc_law(self, cells)

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " readings"]
    ) -> PyTree:
        """The state at rest under this duty, with the disturbance that explains the measurement.

        If there are as many outputs as cells and the reference equals the measurement, the duty
        stays where it is. With fewer outputs, it moves to the smallest duty that holds them.
        """
        read, watched = self._parts(measurement)
        u = jnp.asarray(duty) - self.duty
        estimate = self.estimator.init(u, read)
        errors = self._missed(self.estimator.states(estimate), watched)
        return MPCState(estimate, u, errors, jnp.zeros((), u.dtype))

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, "*horizon outputs"],
        measurement: Float[ArrayLike, " readings"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        seen, program = self._problem(state, jnp.asarray(reference), measurement)
        now = minimised(program)[: len(self.duty)]
        low, high = (bound - self.duty for bound in self.duty_bounds(now.dtype))
        if self.reach is not None:
            now = jnp.clip(now, state.duty - self.reach, state.duty + self.reach)
        # Rounding must not violate the hard limits.
        now = jnp.clip(now, low, high)
        later = seen._replace(states=self.estimator.predict(seen.states, now), duty=now)
        return self.limited(now + self.duty), later

    def _parts(
        self, measurement: Float[ArrayLike, " readings"]
    ) -> tuple[Float[Array, " read"], Float[Array, " watched"]]:
        """Computes what the estimator reads, and the deviations of the watched channels from the
        operating point. The filter reads deviations too, an observer all channels and the
        room."""
        readings, count = jnp.asarray(measurement), len(self.outputs)
        last = count + len(self.read_channels)
        watched = readings[count:last] - jnp.asarray(self.watched.at)
        read = readings[:count] - self.outputs if self.points is None else watched
        return jnp.concatenate([read, readings[last:]]), watched

    def _missed(
        self, states: Float[Array, " state"], watched: Float[Array, " watched"]
    ) -> Float[Array, " watched"]:
        """Computes what the model misses of the readings of the watched channels and no disturbance
        explains, K."""
        C = jnp.asarray(self.watched.C)
        return jnp.asarray(self.watched.unexplained) @ (watched - C @ states[: C.shape[1]])

    def _problem(
        self, state: MPCState, reference: Array, measurement: Float[ArrayLike, " readings"]
    ) -> tuple[MPCState, QuadraticProgram]:
        """Computes the state after a reading, and the program whose minimum is the plan: the duty
        of the next samples, as deviations from the operating point."""
        read, watched = self._parts(measurement)
        if self.points is not None:
            read = jnp.concatenate([read[: len(watched)] - state.errors, read[len(watched) :]])
        estimate = self.estimator.update(state.states, read)
        states = self.estimator.states(estimate)
        missed = self._missed(states, watched) - state.errors
        errors = state.errors + jnp.asarray(self.watched.L) * missed
        lowest, highest = self.duty_bounds(jnp.asarray(self.duty).dtype)
        limits = lowest - self.duty, highest - self.duty
        references = jnp.atleast_2d(reference)
        rest = self._rest(references, states, errors, limits)
        allowance = state.allowance
        if self.soft_temperatures.has_bands:
            expected = self._rest(references, 0 * states, 0 * errors, limits).deviation
            more = rest.deviation[0] - expected[0]
            allowance = allowance + self.adaptation * (more - allowance)
            rest = rest._replace(deviation=ROOM_ON_THE_WAY * (expected + allowance))
        samples = self.horizon
        rest = Rest(*(jnp.broadcast_to(part, (samples, *part.shape[1:])) for part in rest))
        program = plan_program(
            self.condensed,
            states,
            state.duty,
            rest,
            limits,
            self.reach,
            self.soft_temperatures,
            errors,
        )
        return MPCState(estimate, state.duty, errors, allowance), program

    def _rest(
        self,
        references: Float[Array, "samples outputs"],
        states: Float[Array, " state"],
        errors: Float[Array, " watched"],
        limits: Limits,
    ) -> Rest:
        """Computes the state of rest for the references of some samples."""
        gain, inverse = jnp.asarray(self.gain), jnp.asarray(self.inverse)
        accepted, cells = jnp.asarray(self.output_deviation), len(self.duty)
        to_duty = jnp.asarray(self.kalman.disturbance_to_duty)
        heat = to_duty @ states[len(states) - to_duty.shape[1] :]
        coming = self.outputs + gain @ heat
        if self.points is not None:
            coming = coming + jnp.asarray(self.of_channels) @ errors

        soft = self.soft_temperatures

        def of_sample(reference: Float[Array, " outputs"]) -> Rest:
            centre = jnp.mean(reference - self.outputs)
            missing = reference - coming
            program = rest_program(
                gain,
                inverse,
                accepted,
                missing,
                heat,
                limits,
                soft,
                errors,
                centre,
            )
            optimum = minimised(program)
            deviation = optimum[cells] if soft.has_bands else jnp.zeros_like(centre)
            return Rest(optimum[:cells], deviation, centre)

        return jax.vmap(of_sample)(references)

    @property
    def soft_temperatures(self) -> SoftTemperatures:
        """The temperatures that its programs limit softly, and those that they make even."""
        return SoftTemperatures(self.soft, self.points, self.evenness, self.excess_deviation)

    def __repr__(self) -> str:
        outputs, cells = self.gain.shape
        even = ""
        if self.evenness is not None:
            even = f", {self.evenness.name} of {len(self.point_names)} points"
        return (
            f"<MPC: {outputs} outputs, {cells} cells, horizon {self.horizon}, sample time "
            f"{self.sample_time_s:g} s{even}>"
        )


def design_mpc(
    model: StateSpace,
    *,
    measured: Sequence[str | Sequence[str]] | None = None,
    horizon: int = 20,
    control_horizon: int | None = None,
    output_deviation: Numbers = 1.0,
    duty_deviation: Numbers = 0.05,
    duty_change_deviation: Numbers = 0.05,
    drift: Numbers = 0.1,
    reading_noise: Numbers = 0.5,
    limits: GivenLimits | None = None,
    rate_limit: float | int | None = None,
    temperature_limits: Mapping[str, Sequence[float | int]] | None = None,
    excess_deviation: float | int = DEFAULT_EXCESS,
    evenness: AbstractEvennessCost | None = None,
    points: Sequence[str] = (),
    point_errors: Float[np.ndarray, "points channels"] | None = None,
    preview: bool = False,
    observer: TwinObserver | None = None,
) -> MPC:
    """Designs model predictive control on a linear model.

    ```python
    model = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(1.0)
    mpc = design_mpc(model, measured=["TAM", "TCM"], limits=(0, 1), rate_limit=0.05)
    ```

    **Arguments:** deviations and noises are single numbers, or one for each output or cell; with
    points that are to be even, `reading_noise` has one for each channel that is read, and `drift`
    one for each of these, at most as many as cells.

    - `model`, `measured`, `output_deviation`, `drift`, `reading_noise`, `limits`: as in
      `design_lqi`.
    - `duty_deviation`: the accepted deviation of the duty from the one that holds the reference at
      rest. A larger value is faster, and overshoots more if the plate differs from the model.
    - `duty_change_deviation`: the accepted change of the duty from sample to sample.
    - `horizon`: the number of samples that are planned. `control_horizon`: the number of them
      after which the planned duty is held; None for all of them. A shorter one costs less time.
    - `rate_limit`: hard limit of the rate of each cell's duty, 1/s; None for none. On a rig the
      change in a sample is a whole number of the driver's counts, so that rounding keeps the limit.
    - `temperature_limits`: soft limits of channels, name -> (lowest, highest), degC, or with an
      accepted excess, K, as in `TemperatureLimit`. Each channel is read at every sample, and the
      difference of its readings from the model shifts what is predicted of it. A limit is exceeded
      if no duty can keep it; `ClosedLoopRun.exceeded` says so. Of limits that exclude each other,
      that of the smallest accepted excess has priority.
    - `evenness`: what makes the temperatures of `points`, outputs of the model, uneven; None for
      a controller of the outputs alone. With it every channel of `measured` is read at every
      sample. `point_errors`: what an error of 1 K of the model at each read channel (those with
      limits first) changes at each point; None for the channel itself alone.
      `design_uniformity_mpc` computes all of them for a plate.
    - `excess_deviation`: the accepted excess over a temperature limit that states none, and of a
      point over the farthest one at rest, K. With a smaller value the limit is stricter.
    - `observer`: an observer of the twin (`jaxtwin.observers.live_observer`), from which the Kalman
      filter knows what the twin does beyond the linear model; None for the filter alone. It reads
      all channels at every sample. Such a controller has no file and no C.
    - `preview`: whether closed loops, simulated or on a rig, give it the references of the whole
      horizon, so that it acts before a step of the reference comes.

    **Raises:** `ControlError` if the model is not a discrete model or has no stable design, a
    deviation, a noise or the rate is not a finite positive number, the horizon is not a positive
    whole number, the limits are not within -1 to 1, or a temperature limit is not one.
    """
    model = checked_discrete_model("MPC: model", model)
    groups = checked_measured("MPC", measured)
    checked_evenness(evenness, points)
    point_names = names_of("MPC: points", points, ControlError)
    for name in point_names:
        if name not in model.output_names:
            raise ControlError(f"MPC: points: {unknown_name('output', name, model.output_names)}")
    if point_errors is not None and not point_names:
        raise ControlError("MPC: point_errors: expected None without points, got some")
    (excess,) = checked_deviations("MPC", "excess_deviation", excess_deviation, 1)
    limited = checked_temperature_limits(temperature_limits, model.output_names, excess)
    of_outputs: Sequence[str] = ()
    if point_names:
        of_outputs = (
            model.output_names if groups is None else [n for group in groups for n in group]
        )
    watched = tuple(dict.fromkeys([*(name for name, _ in limited), *of_outputs]))
    sets = [(name,) for name in watched], [(name,) for name in point_names]
    plant = MPCPlant(*outputs_of(model, groups, *sets))
    settings = MPCSettings(
        measured=groups,
        horizon=horizon,
        control_horizon=control_horizon,
        output_deviation=output_deviation,
        duty_deviation=duty_deviation,
        duty_change_deviation=duty_change_deviation,
        limits=checked_limits("MPC", limits),
        has_own_limits=limits is not None,
        rate_limit=rate_limit,
        temperature_limits=limited,
        read_channels=watched,
        excess_deviation=excess,
        evenness=evenness,
        point_names=point_names,
        point_errors=point_errors,
        preview=preview,
    )
    mpc = _design(plant, drift, reading_noise, settings)
    return with_observer(mpc, observer, model, plant.read)


def _design(plant: MPCPlant, drift: Numbers, reading_noise: Numbers, settings: MPCSettings) -> MPC:
    """Designs the filter, and makes the controller with it."""
    check_plant("MPC", plant.outputs, plant.read)
    readings, cells = np.shape(plant.read.D)
    w = checked_deviations("MPC", "drift", drift, min(readings, cells))
    v = checked_deviations("MPC", "reading_noise", reading_noise, readings)
    kalman = kalman_filter("MPC", plant.read, w, v)
    assert plant.read.sample_time_s is not None
    gain = error_gain(w.mean(), v.mean(), plant.read.sample_time_s)
    gains = np.full(len(plant.watched.C), gain)
    return _assembled(plant, kalman, gains, settings, MPCNoises(w, v))


def _assembled(
    plant: MPCPlant,
    kalman: KalmanFilter,
    error_gains: Float[np.ndarray, " watched"],
    settings: MPCSettings,
    noises: MPCNoises | None = None,
) -> MPC:
    """Makes the controller: its programs over the horizon follow from the model and the settings.

    **Arguments:**

    - `error_gains`: the gain of the filter of the error of the model at each watched channel.
    - `noises`: as in `MPC`.
    """
    time, read, evenness = plant.outputs.sample_time_s, settings.read_channels, settings.evenness
    assert time is not None
    horizon = whole_number("MPC: horizon", settings.horizon, 1, ControlError)
    moves = checked_control_horizon(settings.control_horizon, horizon)
    outputs, cells = np.shape(plant.outputs.D)
    deviations = Deviations(
        checked_deviations("MPC", "output_deviation", settings.output_deviation, outputs),
        checked_deviations("MPC", "duty_deviation", settings.duty_deviation, cells),
        checked_deviations("MPC", "duty_change_deviation", settings.duty_change_deviation, cells),
    )
    to_duty = np.asarray(kalman.disturbance_to_duty)
    predicted = predict(plant.outputs, to_duty, horizon, moves)
    tracked = plant.points if evenness is not None and evenness.is_quadratic else None
    condensed = condense(plant.outputs, to_duty, predicted, deviations, tracked)
    soft, limits = None, settings.temperature_limits
    if limits:
        rows = np.eye(len(limits), len(read))
        limited = plant.watched.with_outputs(rows, read[: len(limits)])
        soft = soft_limits(limited, predicted, np.array([limit[:2] for _, limit in limits]))
    points, of_channels, unexplained = None, np.zeros((outputs, 0)), np.eye(len(read))
    if settings.point_names:
        shares = checked_point_errors(settings.point_errors, settings.point_names, read)
        centre = float(np.mean(plant.outputs.operating_point.outputs))
        points = even_points(plant.points, predicted, shares, centre)
        check_horizon(points, horizon, time)
        explained = np.asarray(plant.read.dcgain)
        unexplained -= explained @ np.linalg.pinv(explained)
        of_channels = means_of(settings.measured, read)
    gain, at = np.asarray(plant.outputs.dcgain), plant.watched.operating_point.outputs
    slowest = np.abs(np.linalg.eigvals(plant.outputs.A)).max()
    rate_limit = settings.rate_limit
    return MPC(
        model=plant.outputs,
        gain=gain,
        inverse=np.linalg.pinv(gain),
        condensed=condensed,
        soft=soft,
        points=points,
        evenness=evenness,
        kalman=kalman,
        observed=None,
        noises=noises,
        watched=WatchedChannels(plant.watched.C, at, error_gains, unexplained),
        of_channels=of_channels,
        output_deviation=deviations.output,
        duty_deviation=deviations.duty,
        duty_change_deviation=deviations.change,
        excess_deviation=accepted_excesses(limits, settings.excess_deviation),
        adaptation=np.asarray(1 - slowest**SLOWNESS),
        temperature_limits=limits,
        read_channels=read,
        point_names=settings.point_names,
        horizon=horizon,
        control_horizon=moves,
        rate_limit=None if rate_limit is None else checked_rate(rate_limit),
        limits=settings.limits,
        has_own_limits=settings.has_own_limits,
        sample_time_s=time,
        designed_for=plant.outputs.operating_point.rig,
        preview=true_or_false("MPC: preview", settings.preview, ControlError),
        measured=settings.measured,
        counts=settings.counts,
    )
