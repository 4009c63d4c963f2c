r"""Model predictive control on a twin's own equations, in real time.

Each sample minimises, over the duty of the next $n$ samples,

$$\sum_{k=1}^{n} \left(\frac{y_k - r_k}{\Delta y}\right)^2
+ \sum_{k=0}^{n-1} \left(\frac{u_k - u_{k-1}}{\delta u}\right)^2
+ \sum_{k=1}^{n} \sum_i \left(\frac{e_{i,k}}{\Delta e}\right)^2$$

within the limits of the duty and of its rate, where the twin's equations lead from $u$ to the
outputs $y$ and to the excess $e_{i,k}$ of channel i over its limit. It is solved by sequential
quadratic programming with the Hessian of Gauss and Newton, over the intervals of
`_multiple_shooting`. One step of it a sample, from the plan of the sample before moved on by a
sample, is the real-time iteration of Diehl, Bock and Schlöder (SIAM J. Control Optim. 43, 2005).

The estimate of the state moves by the twin's equations and is corrected by the gain of a
steady-state Kalman filter, with its disturbances as lasting heat of the cells (`_kalman`). The
outputs therefore come to rest at their references, however wrong the twin is.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from ..._arguments import true_or_false, whole_number
from ..._celsius import ZERO_CELSIUS
from ..._jax_settings import in_precision, to_numpy
from ..._lapack import solve
from ..._quadratic_program import QuadraticProgram, minimised
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ...simulation import Stepper
from ..linear._linearize import linearize
from ._controller import (
    DutyLimits,
    Law,
    Numbers,
    TemperatureLimit,
    accepts_design_arguments,
    checked_deviations,
    checked_measured,
    checked_sample_time,
    means_of,
)
from ._design_model import check_plant, outputs_of
from ._duty_limits import GivenLimits, bounds_of, checked_limits, limits_of_rig
from ._kalman import KalmanFilter, error_gain, kalman_filter
from ._mpc_programs import Condensed, Rest, SoftLimits, SoftTemperatures, plan_program
from ._multiple_shooting import (
    CondensedPath,
    ShootingPath,
    after_interval,
    as_state,
    as_vector,
    condensed_path,
)
from ._predictive_controller import (
    DEFAULT_EXCESS,
    AbstractPredictiveController,
    accepted_excesses,
    checked_control_horizon,
    checked_rate,
    checked_temperature_limits,
)

# The longest step of the prediction, s: its errors are below a millikelvin on `dual-cell`.
MAX_STEP = 2.0

# Steps of the search for the state at rest with which a controller takes over.
NEWTON_STEPS = 12


class NonlinearMPCState(NamedTuple):
    """The state of a `NonlinearMPC`.

    - `estimate`: the state of the twin that is expected at the next sample, a vector.
    - `disturbance`: what heat that the twin does not know changes at rest, K.
    - `errors`: the errors of the twin at the limited channels, K.
    - `duty`: the duty that the cells get.
    - `path`: the plan from the next sample on.
    """

    estimate: Float[Array, " state"]
    disturbance: Float[Array, " disturbances"]
    errors: Float[Array, " limited"]
    duty: Float[Array, " cells"]
    path: ShootingPath


@final
@accepts_design_arguments("design_nonlinear_mpc")
class NonlinearMPC(AbstractPredictiveController):
    """Model predictive control whose model is a twin itself, made by `design_nonlinear_mpc`.

    **Arguments:** settings are those of `design_nonlinear_mpc`.

    - `stepper`: the twin's equations over a step of the prediction.
    - `kalman`: its gain and its outputs; its states are deviations of the nodes from `nodes`, the
      temperatures where the filter was designed, degC.
    - `heat`: the heat into the nodes of each disturbance, W/K.
    - `inverse`: the smallest duty that changes the outputs at rest by 1 K.
    - `readings`: the outputs and the limited channels by the temperatures of the nodes. `at`: their
      temperatures at `nodes`, degC.
    - `error_gain`: the gain of the filter of the errors of the twin at the limited channels.
    - `excess_deviation`: the accepted excess of each channel with limits; the last one stands for
      points, of which there are none.
    - `has_own_limits`: whether the limits hold on every rig.
    - `designed_for`: the name of the rig.
    - `counts`: full duty in counts of the driver; None before the controller knows its rig.
    """

    stepper: Stepper
    kalman: KalmanFilter
    heat: Float[Array | np.ndarray, "nodes disturbances"]
    inverse: Float[Array | np.ndarray, "cells outputs"]
    readings: Float[Array | np.ndarray, "readings nodes"]
    at: Float[Array | np.ndarray, " readings"]
    nodes: Float[Array | np.ndarray, " nodes"]
    output_deviation: Float[Array | np.ndarray, " outputs"]
    duty_change_deviation: Float[Array | np.ndarray, " cells"]
    error_gain: Float[Array | np.ndarray, ""]
    excess_deviation: Float[Array | np.ndarray, " limited_and_points"]
    temperature_limits: tuple[tuple[str, TemperatureLimit], ...] = eqx.field(static=True)
    horizon: int = eqx.field(static=True)
    control_horizon: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    rate_limit: float | None = eqx.field(static=True)
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)
    preview: bool = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)
    designed_for: str = eqx.field(static=True)
    counts: int | None = eqx.field(static=True, default=None)

    @property
    def is_linear(self) -> bool:
        """False: its model is the twin's equations."""
        return False

    def reading_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "readings channels"]:
        """Returns the weights of the outputs, and those of the limited channels."""
        limited = means_of([(name,) for name, *_ in self.temperature_limits], channels)
        return np.vstack([self.output_weights(channels), limited])

    def law(self, cells: int) -> Law:
        """Refuses: a microcontroller has no solver of the twin's equations with derivatives.

        **Raises:** `ControlError`.
        """
        raise ControlError(
            "export_c: model: a NonlinearMPC has no C, because it differentiates the twin at each "
            "sample; export an MPC of linearize(twin, ...) instead"
        )

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " readings"]
    ) -> PyTree:
        """The state at rest under this duty, with the heat that explains the measurement. If the
        reference equals the measurement, the duty stays where it is."""
        stepper = self._prediction()
        u = jnp.asarray(duty, stepper.reference.dtype)
        seen, outputs = jnp.asarray(measurement, u.dtype), len(self.output_deviation)
        nodes, unknown = len(self.nodes), np.shape(self.heat)[1]
        heat = jnp.asarray(self.heat, u.dtype)

        def missing(point: Array) -> Array:
            deviation, disturbance = point[:nodes], point[nodes:]
            flow = stepper.system.heat_into_nodes(deviation, u, stepper.reference)
            read = self._read(stepper, deviation)[:outputs]
            return jnp.concatenate([flow + heat @ disturbance, read - seen[:outputs]])

        def newton(_: Int[Array, ""], point: Array) -> Array:
            return point - solve(jax.jacfwd(missing)(point), missing(point))

        start = jnp.zeros(nodes + unknown, u.dtype)
        point = jax.lax.fori_loop(0, NEWTON_STEPS, newton, start)
        amplitudes = stepper.field.modes.amplitudes(point[:nodes])
        state = jnp.concatenate([amplitudes, jnp.tile(u, 1 + stepper.queue)])
        path = ShootingPath(jnp.tile(state, (self.horizon + 1, 1)), jnp.tile(u, (self.horizon, 1)))
        errors = (seen - self._read(stepper, point[:nodes]))[outputs:]
        return NonlinearMPCState(state, point[nodes:], errors, u, path)

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, "*horizon outputs"],
        measurement: Float[ArrayLike, " readings"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        stepper, dtype = self._prediction(), state.duty.dtype
        references = jnp.atleast_2d(jnp.asarray(reference, dtype))
        references = jnp.broadcast_to(references, (self.horizon, references.shape[1]))
        seen = self._corrected(stepper, state, jnp.asarray(measurement, dtype))

        def improved(_: Int[Array, ""], path: ShootingPath) -> ShootingPath:
            return self._improved(stepper, seen._replace(path=path), references)

        path = jax.lax.fori_loop(0, self.iterations, improved, seen.path)
        low, high = self.duty_bounds(dtype)
        now = path.duty[0]
        if self.reach is not None:
            now = jnp.clip(now, state.duty - self.reach, state.duty + self.reach)
        # Rounding must not violate the hard limits.
        now = jnp.clip(now, low, high)
        heat = jnp.asarray(self.heat, dtype) @ seen.disturbance
        starts = jnp.stack([seen.estimate, path.states[-1]])
        expected, last = jax.vmap(
            lambda start, held: after_interval(stepper, self.steps, start, held, heat)
        )(starts, jnp.stack([now, path.duty[-1]]))
        moved = ShootingPath(
            jnp.concatenate([path.states[1:], last[None]]),
            jnp.concatenate([path.duty[1:], path.duty[-1:]]),
        )
        return now, seen._replace(estimate=expected, duty=now, path=moved)

    def _corrected(
        self, stepper: Stepper, state: NonlinearMPCState, measurement: Float[Array, " readings"]
    ) -> NonlinearMPCState:
        """The state after a reading."""
        dtype, outputs, nodes = measurement.dtype, len(self.output_deviation), len(self.nodes)
        expected = as_state(stepper, state.estimate)
        deviation = stepper.field.modes.shapes @ expected.amplitudes
        from_design = deviation + stepper.reference - ZERO_CELSIUS - jnp.asarray(self.nodes, dtype)
        read = measurement - jnp.asarray(self.at, dtype)
        kalman = in_precision(self.kalman, dtype)
        states = jnp.concatenate([from_design, state.disturbance])
        corrected = kalman.update(states, read[:outputs])
        change = corrected[:nodes] - from_design
        amplitudes = expected.amplitudes + stepper.field.modes.amplitudes(change)
        missed = (measurement - self._read(stepper, deviation + change))[outputs:] - state.errors
        return state._replace(
            estimate=as_vector(replace(expected, amplitudes=amplitudes)),
            disturbance=corrected[nodes:],
            errors=state.errors + jnp.asarray(self.error_gain, dtype) * missed,
        )

    def _improved(
        self,
        stepper: Stepper,
        seen: NonlinearMPCState,
        references: Float[Array, "horizon outputs"],
    ) -> ShootingPath:
        """The plan after a step of the sequential quadratic programming."""
        dtype, outputs = references.dtype, len(self.output_deviation)
        shapes = stepper.field.modes.shapes
        now = self._read(stepper, shapes @ as_state(stepper, seen.estimate).amplitudes)[:outputs]
        wanted = jnp.asarray(self.inverse, dtype) @ (references[0] - now)
        upward = (wanted >= 0) | (self.duty_bounds(dtype)[0] >= 0)
        result = condensed_path(
            stepper,
            self.steps,
            seen.estimate,
            seen.path,
            jnp.asarray(self.heat, dtype) @ seen.disturbance,
            jnp.where(upward, 1.0, -1.0).astype(dtype),
            self.control_horizon,
        )
        moves = minimised(self._program(stepper, result, references, seen))
        samples = jnp.minimum(jnp.arange(self.horizon), self.control_horizon - 1)
        later = result.still + result.by_moves @ moves
        return ShootingPath(
            jnp.concatenate([seen.estimate[None], later]),
            moves.reshape(self.control_horizon, -1)[samples],
        )

    def _program(
        self,
        stepper: Stepper,
        path: CondensedPath,
        references: Float[Array, "horizon outputs"],
        seen: NonlinearMPCState,
    ) -> QuadraticProgram:
        """The program whose minimum is the duty of the control horizon, in a row."""
        dtype, cells = references.dtype, len(seen.duty)
        outputs, size = len(self.output_deviation), path.by_moves.shape[-1]
        modes = stepper.field.modes.shapes.shape[1]
        rows = jnp.asarray(self.readings, dtype) @ stepper.field.modes.shapes
        by_moves = jnp.einsum("rm,kmv->krv", rows, path.by_moves[:, :modes])
        still = path.still[:, :modes] @ rows.T + self._read(stepper, jnp.zeros(len(self.nodes)))
        accepted = jnp.asarray(self.output_deviation, dtype)
        slope = (by_moves[:, :outputs] / accepted[:, None]).reshape(-1, size)
        off = ((still[:, :outputs] - references) / accepted).reshape(-1)
        price = jnp.tile(jnp.asarray(self.duty_change_deviation, dtype) ** -2, size // cells)
        differences = jnp.eye(size, dtype=dtype) - jnp.eye(size, k=-cells, dtype=dtype)
        condensed = Condensed(
            hessian=slope.T @ slope + differences.T @ (price[:, None] * differences),
            by_states=(slope.T @ off)[:, None],
            by_last_duty=-differences.T @ (price[:, None] * jnp.eye(size, cells, dtype=dtype)),
            by_target=jnp.zeros((size, 0), dtype),
        )
        soft = None
        if self.temperature_limits:
            lowest, highest = self._limits_of_samples()
            none = jnp.zeros((len(self.temperature_limits), cells), dtype)
            soft = SoftLimits(
                still[:, outputs:].reshape(-1, 1),
                by_moves[:, outputs:].reshape(-1, size),
                jnp.asarray(lowest, dtype),
                jnp.asarray(highest, dtype),
                rest_gain=none,
            )
        low, high = self.duty_bounds(dtype)
        return plan_program(
            condensed,
            jnp.ones(1, dtype),  # what is constant in the program stands by this "state"
            seen.duty,
            Rest(jnp.zeros((self.horizon, 0), dtype), off[:0], off[:0]),
            (jnp.broadcast_to(low, (cells,)), jnp.broadcast_to(high, (cells,))),
            self.reach,
            SoftTemperatures(soft, None, None, jnp.asarray(self.excess_deviation, dtype)),
            seen.errors,
        )

    def _limits_of_samples(self) -> Float[np.ndarray, "2 rows"]:
        """The lowest and the highest temperature of each limited channel in each sample, degC."""
        ends = [limit[:2] for _, limit in self.temperature_limits]
        return np.tile(ends, (self.horizon, 1)).T

    def _read(
        self, stepper: Stepper, deviation: Float[Array, " nodes"]
    ) -> Float[Array, " readings"]:
        """What the nodes' deviations from the reference of the stepper let the controller read,
        degC."""
        dtype = stepper.reference.dtype
        rises = deviation + stepper.reference - ZERO_CELSIUS - jnp.asarray(self.nodes, dtype)
        return jnp.asarray(self.at, dtype) + jnp.asarray(self.readings, dtype) @ rises

    def _prediction(self) -> Stepper:
        """The stepper, in the precision that JAX is set to."""
        return in_precision(self.stepper, jnp.zeros(()).dtype)

    @property
    def steps(self) -> int:
        """The steps of the prediction in a sample."""
        return _steps(self.sample_time_s)

    def __repr__(self) -> str:
        outputs, cells = len(self.output_deviation), len(self.duty_change_deviation)
        return (
            f"<NonlinearMPC of {self.designed_for}: {outputs} outputs, {cells} cells, horizon "
            f"{self.horizon}, sample time {self.sample_time_s:g} s>"
        )


def design_nonlinear_mpc(
    twin: Twin | Fit,
    *,
    measured: Sequence[str | Sequence[str]] | None = None,
    sample_time_s: float | int = 10.0,
    horizon: int = 30,
    control_horizon: int | None = None,
    output_deviation: Numbers = 1.0,
    duty_change_deviation: Numbers = 0.05,
    drift: Numbers = 0.1,
    reading_noise: Numbers = 0.1,
    limits: GivenLimits | None = None,
    rate_limit: float | int | None = None,
    temperature_limits: Mapping[str, Sequence[float | int]] | None = None,
    excess_deviation: float | int = DEFAULT_EXCESS,
    iterations: int = 1,
    preview: bool = False,
) -> NonlinearMPC:
    """Designs model predictive control whose model is a twin itself, and not its linearisation.

    ```python
    controller = design_nonlinear_mpc(twin, measured=["TAM", "TCM"], limits=(0, 1))
    jt.simulate_closed_loop(twin, controller, 40, duration=900)
    ```

    It is worth its time where the plate goes far: the heat of a cell grows with the square of its
    current, its gain falls as the plate warms, and the losses grow faster than the rise. Near one
    operating point an `MPC` does the same in a seventh of the time.

    **Arguments:** deviations and noises are single numbers, or one for each output or cell.

    - `twin`: the twin; or a fit, whose recordings' own values are averaged.
    - `measured`, `preview`, `limits`, `rate_limit`, `temperature_limits`, `excess_deviation`,
      `drift`, `reading_noise`: as in `design_mpc`.
    - `sample_time_s`: the sample time, s. `horizon`: the number of samples that are planned.
      `control_horizon`: the number after which the planned duty is held; None for all of them.
    - `output_deviation`: the accepted deviation of the outputs from their references.
    - `duty_change_deviation`: the accepted change of the duty from sample to sample. A smaller
      value is more cautious.
    - `iterations`: steps of the sequential quadratic programming in each sample.

    **Raises:** `ControlError` as `design_mpc`, and for a horizon that is not longer than the
    driver's delay; `ParameterError` for values with which the twin has no meaning.
    """
    where = "NonlinearMPC"
    twin = nominal_twin(f"{where}: twin", twin, ControlError)
    time = checked_sample_time(where, sample_time_s)
    horizon = whole_number(f"{where}: horizon", horizon, 1, ControlError)
    allowed = checked_limits(where, limits)
    (excess,) = checked_deviations(where, "excess_deviation", excess_deviation, 1)
    limited = checked_temperature_limits(temperature_limits, twin.channels, excess, where)
    stepper = to_numpy(Stepper(twin, time / _steps(time)))
    delay = 0.0 if stepper.system.delay is None else float(stepper.system.delay)
    if horizon * time <= delay:
        raise ControlError(
            f"{where}: horizon: expected more samples than the driver's delay of {delay:g} s "
            f"takes, got {horizon} of {time:g} s"
        )
    # The filter knows no delay and no lag: what it explains is heat, which has neither.
    lowest, highest = bounds_of(limits_of_rig(where, allowed, twin.rig))
    model = replace(
        linearize(twin, duty=np.where(highest >= -lowest, highest, lowest) / 2),
        delay_s=np.zeros(()), lag_s=np.zeros(()), is_delayed=False, is_lagged=False,
    )  # fmt: skip
    groups = checked_measured(where, measured)
    plant, watched = outputs_of(model.discretise(time), groups, [(name,) for name, _ in limited])
    check_plant(where, plant, plant)
    outputs, cells = np.shape(plant.D)
    w, v = (
        checked_deviations(where, name, value, outputs)
        for name, value in (("drift", drift), ("reading_noise", reading_noise))
    )
    kalman = kalman_filter(where, plant, w, v)
    capacitance = np.asarray(stepper.system.capacitance)[:, None]
    return NonlinearMPC(
        stepper=stepper,
        kalman=kalman,
        heat=capacitance * np.asarray(model.B) @ kalman.disturbance_to_duty,
        inverse=np.linalg.pinv(np.asarray(plant.dcgain)),
        readings=np.vstack([plant.C, watched.C]),
        at=np.concatenate([plant.operating_point.outputs, watched.operating_point.outputs]),
        nodes=np.asarray(model.operating_point.nodes),
        output_deviation=checked_deviations(where, "output_deviation", output_deviation, outputs),
        duty_change_deviation=checked_deviations(
            where, "duty_change_deviation", duty_change_deviation, cells
        ),
        error_gain=np.asarray(error_gain(w.mean(), v.mean(), time)),
        excess_deviation=accepted_excesses(limited, excess),
        temperature_limits=limited,
        horizon=horizon,
        control_horizon=checked_control_horizon(control_horizon, horizon, where),
        iterations=whole_number(f"{where}: iterations", iterations, 1, ControlError),
        rate_limit=None if rate_limit is None else checked_rate(rate_limit, where),
        limits=allowed,
        has_own_limits=limits is not None,
        sample_time_s=time,
        preview=true_or_false(f"{where}: preview", preview, ControlError),
        measured=groups,
        designed_for=twin.rig.name,
    )


def _steps(sample_time_s: float) -> int:
    """The steps of the prediction in a sample."""
    return math.ceil(sample_time_s / MAX_STEP * (1 - 1e-9))
