r"""LQI: state feedback with integral action, with states that a Kalman filter estimates.

All quantities are deviations from the operating point; $q$ are the integrated errors and $\hat x$
the estimated states:

$$v_k = b\,N r_k - K_x \hat x_k + K_i q_k, \quad u_k = \mathrm{sat}(v_k), \quad
q_{k+1} = q_k + h (r_k - y_k) + K_i^+ (u_k - v_k),$$

The gains minimise $\sum (y / \Delta y)^2 + (q / \Delta q)^2 + (u / \Delta u)^2$, where each
quantity is divided by the deviation that is accepted of it (Bryson's rule).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from ...errors import ControlError
from ...rig import Kind, Rig
from ..linear._riccati import regulator
from ..linear._state_space import StateSpace, checked_discrete_model
from ._controller import (
    AbstractController,
    DutyLimits,
    Law,
    Numbers,
    accepts_design_arguments,
    bundled_law,
    check_designed_cells,
    check_non_negative,
    checked_deviations,
    checked_measured,
    of_cells,
    parameter_text,
    redesign_weights,
)
from ._controller_fields import (
    REQUIRED_OWN,
    ControllerField,
    FileContents,
    as_matrix,
    check_cells_of_fields,
    matrix,
)
from ._design_model import (
    AbstractModelController,
    check_designed_for,
    check_plant,
    outputs_of,
    with_observer,
)
from ._duty_limits import AbstractDutyLimitedController, GivenLimits, checked_limits
from ._kalman import (
    KalmanFilter,
    TwinEstimator,
    TwinObserver,
    kalman_filter,
    kalman_tables,
    refuse_observed,
)
from ._model_file import (
    MODEL_FIELDS,
    PER_KELVIN,
    PLAIN,
    check_numbers,
    check_stable,
    field_settings,
    model_lines,
    point_lines,
    read_filter,
    read_model,
    read_table,
)
from ._pid import WEIGHT, Parameter, as_parameter

# The gains of an LQI in its file.
GAINS = {
    "Kx": PLAIN,
    "Ki": Kind("a gain", "1/(K s)", "1 1/(K s)", least="any"),
    "Kt": Kind("a gain", "K s", "1 K s", least="any"),
    "N": PER_KELVIN,
}


class LQIWeights(NamedTuple):
    """The weights with which an `LQI` was designed."""

    output_deviation: Float[Array | np.ndarray, " outputs"]
    integral_deviation: Float[Array | np.ndarray, " outputs"]
    duty_deviation: Float[Array | np.ndarray, " cells"]
    drift: Float[Array | np.ndarray, " outputs"]
    reading_noise: Float[Array | np.ndarray, " outputs"]


class LQIState(NamedTuple):
    """The state of an `LQI`: the predicted states (with an observer its estimate), the integrated
    errors (K s), and the part of the initial duty that no integral can hold."""

    states: PyTree
    integral: Float[Array, " outputs"]
    duty_offset: Float[Array, " cells"]


@final
@accepts_design_arguments("design_lqi")
class LQI(AbstractModelController):
    """State feedback with integral action and a Kalman filter, made by `design_lqi`.

    **Arguments:**

    - `Kx`, `Ki`, `Kt`, `N`: the gains. They are parameters like those of a `PID`: they can be
      differentiated and drawn.
    - `setpoint_weight`, `limits`, `measured`: as in `design_lqi`.
    - `model`: the model of the outputs on which it was designed.
    - `kalman`: its filter. `observed`: the filter with what an observer knows, if there is one.
    - `weights`: those of its design; None for gains of a file.
    - `has_own_limits`: whether the limits hold on every rig.
    - `sample_time_s`: that of the model, s. `designed_for`: its rig; empty for that of no rig file.

    **Raises:** `ControlError` if the set-point weight is not a finite number of at least 0.
    """

    kind: ClassVar[str] = "lqi"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        **MODEL_FIELDS,
        "setpoint_weight": replace(WEIGHT, is_required=True),
        "gains": REQUIRED_OWN,
    }

    Kx: Parameter
    Ki: Parameter
    Kt: Parameter
    N: Parameter
    setpoint_weight: Parameter = eqx.field(converter=as_parameter)
    model: StateSpace
    kalman: KalmanFilter
    observed: TwinEstimator | None
    weights: LQIWeights | None
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True, repr=False)
    sample_time_s: float = eqx.field(static=True)
    designed_for: str = eqx.field(static=True, repr=False)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)

    def __check_init__(self) -> None:
        self.check_parameters(setpoint_weight=self.setpoint_weight)

    def for_rig(self, rig: Rig) -> AbstractDutyLimitedController:
        """Returns the controller with the limits of a rig.

        **Raises:** `ControlError` for another rig than that of the model.
        """
        check_designed_for("LQI", self.designed_for, rig)
        return super().for_rig(rig)

    def design_weights(self) -> Mapping[str, Float[np.ndarray, "..."]]:
        """Returns accepted deviations and noises; none for gains of a file, or with an observer."""
        if self.weights is None or self.observed is not None:
            return {}
        return {name: np.asarray(part) for name, part in self.weights._asdict().items()}

    def redesigned(self, weights: Mapping[str, Numbers]) -> AbstractController:
        """Returns the controller that the same model gives with other deviations and noises."""
        named = redesign_weights("LQI", self.design_weights(), weights)
        return _design(
            self.model, named, self.setpoint_weight, self.limits, self.measured, has_limits=True
        )

    @classmethod
    def check_parameters(cls, **values: Any) -> None:
        """Refuses a set-point weight that is not a finite number of at least 0."""
        if "setpoint_weight" in values:
            check_non_negative("LQI", setpoint_weight=values["setpoint_weight"])

    @property
    def is_linear(self) -> bool:
        """True within the limits, without an observer."""
        return self.observed is None

    def reading_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "readings channels"]:
        """Returns the weights of the outputs, and all channels for an observer."""
        outputs = self.output_weights(channels)
        return outputs if self.observed is None else np.vstack([outputs, np.eye(len(channels))])

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file: the model, the filter and the gains."""
        settings, refuse = field_settings(cls, contents), contents.refuse
        plant = read_model(contents, settings["measured"])
        check_cells_of_fields(cls, cls.fields, settings, contents)
        kalman, time = read_filter(contents, plant, plant), contents.common["sample_time_s"]
        (states, cells), outputs = plant.B.shape, len(plant.C)
        table = read_table(contents.data["gains"], "gains", refuse, GAINS)
        shapes = ((cells, states), (cells, outputs), (outputs, cells), (cells, outputs))
        gains = {
            name: matrix(table[name], f"gains.{name}", unit, shape, refuse)
            for (name, unit), shape in zip(GAINS.items(), shapes, strict=True)
        }
        feedback, integral = plant.A - plant.B @ gains["Kx"], plant.B @ gains["Ki"]
        loop = np.block([[feedback, integral], [-time * plant.C, np.eye(outputs)]])
        check_stable(loop, "gains", "gains with which the loop on the model is stable", refuse)
        lqi = cls(
            **gains,
            **settings,
            model=plant,
            kalman=kalman,
            observed=None,
            weights=None,
            sample_time_s=time,
            designed_for=contents.rig.name,
        )
        check_numbers(lqi, refuse)
        return lqi

    def file_lines(self) -> list[str]:
        """Returns the lines of the operating point, the gains, and the model."""
        refuse_observed("save_controller: controller", self.observed)
        gains = [f"{name} = {as_matrix(getattr(self, name), unit)}" for name, unit in GAINS.items()]
        return [
            *point_lines(self.model.operating_point),
            *super().file_lines(),
            *("", "[gains]", *gains),
            *model_lines(self.model, self.kalman),
        ]

    def law(self, cells: int) -> Law:
        """The law, with its Kalman filter."""
        refuse_observed("export_c: model", self.observed)
        Kx, Ki, Kt, N = (np.asarray(getattr(self, name), float) for name in GAINS)
        check_designed_cells(len(Ki), cells)
        states, outputs = np.shape(self.kalman.L)
        b = of_cells("setpoint_weight", self.setpoint_weight, cells)
        tables = {
            **kalman_tables(self.kalman, self.model.operating_point),
            "Kx": (Kx, "duty by the states"),
            "Ki": (Ki, "duty by the integrals, 1/(K s)"),
            "Kt": (Kt, "what the limits cut off, out of the integrals, K s"),
            "bN": (b[:, None] * N, "duty by the references at once, 1/K"),
        }
        parameters = [
            parameter_text("Kx", Kx, "1/K and 1"),
            parameter_text("Ki", Ki, "1/(K s)"),
            parameter_text("set-point weight", self.setpoint_weight, ""),
        ]
        return Law(
            bundled_law("lqi.c"),
            f"state feedback with {outputs} integrals and a Kalman filter",
            tables,
            {"x": states, "duty_offset": cells},
            parameters,
            {"STATES": states, "PLANT_STATES": Kx.shape[1]},
            integrals=outputs,
        )

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " readings"]
    ) -> PyTree:
        """The state with which the duty stays where it is while the reference equals the
        measurement."""
        u, (y, read) = jnp.asarray(duty) - self.duty, self._parts(measurement)
        estimate = self.estimator.init(u, read)
        missing = u - self._feedback(self.estimator.states(estimate), y)
        integral = jnp.asarray(self.Kt) @ missing
        return LQIState(estimate, integral, missing - self.Ki @ integral)

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " readings"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        r, (y, read) = jnp.asarray(reference) - self.outputs, self._parts(measurement)
        estimate = self.estimator.update(state.states, read)
        states = self.estimator.states(estimate)
        asked = self.duty + self._feedback(states, r) + self.Ki @ state.integral + state.duty_offset
        duty = self.limited(asked)
        integral = state.integral + self.sample_time_s * (r - y) + self.Kt @ (duty - asked)
        later = self.estimator.predict(estimate, duty - self.duty)
        return duty, LQIState(later, integral, state.duty_offset)

    def _parts(
        self, measurement: Float[ArrayLike, " readings"]
    ) -> tuple[Float[Array, " outputs"], Float[Array, " read"]]:
        """Computes the deviations of the outputs from the operating point, and what the estimator
        reads: the same, and for an observer all channels and the room."""
        readings, count = jnp.asarray(measurement), len(self.outputs)
        outputs = readings[:count] - self.outputs
        return outputs, jnp.concatenate([outputs, readings[count:]])

    def _feedback(
        self, states: Float[Array, " state"], reference: Float[Array, " outputs"]
    ) -> Float[Array, " cells"]:
        of_plant = states[: self.Kx.shape[1]]
        at_once = jnp.asarray(self.N) @ reference
        return jnp.asarray(self.setpoint_weight) * at_once - jnp.asarray(self.Kx) @ of_plant

    def __repr__(self) -> str:
        cells, outputs = self.Ki.shape
        return (
            f"<LQI: {outputs} outputs, {cells} cells, {self.Kx.shape[1]} states, sample time "
            f"{self.sample_time_s:g} s>"
        )


def design_lqi(
    model: StateSpace,
    *,
    measured: Sequence[str | Sequence[str]] | None = None,
    output_deviation: Numbers = 1.0,
    integral_deviation: Numbers = 30.0,
    duty_deviation: Numbers = 0.5,
    drift: Numbers = 0.1,
    reading_noise: Numbers = 1.0,
    setpoint_weight: Numbers = 0.0,
    limits: GivenLimits | None = None,
    observer: TwinObserver | None = None,
) -> LQI:
    """Designs state feedback with integral action and a Kalman filter on a linear model.

    ```python
    model = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(1.0)
    lqi = design_lqi(model, measured=["TAM", "TCM"], limits=(0, 1))
    ```

    **Arguments:** deviations and noises are single numbers, or one for each output or cell.

    - `model`: a discrete model of the rig near its operating point, from `discretise`; delay and
      lag are states. The sample time is that of the model.
    - `measured`: the outputs, at most as many as cells, each a channel or a group of channels that
      is averaged; None for the mean over all channels.
    - `output_deviation`, K, `integral_deviation`, K s, `duty_deviation`: the accepted deviation of
      each. A smaller value keeps that quantity smaller; a smaller integral deviation shortens
      errors.
    - `drift`: the rate at which unknown heat moves the outputs at rest, K per square root of a
      second.
    - `reading_noise`: the standard deviation of a reading of each output, K. The ratio of drift and
      reading noise determines how much the filter trusts the model.
    - `setpoint_weight`: b, the part of the duty for a new reference that is applied at once. With 0
      the integral provides all of it, which overshoots least.
    - `limits`: limits of the duty, as in `PID`. At a limit the integral is set back by
      back-calculation, and the filter uses the duty that the cells get.
    - `observer`: an observer of the twin, as in `design_mpc`.

    **Raises:** `ControlError` if the model is not a discrete model or has no stable design, a
    deviation or a noise is not a finite positive number, or the limits are not within -1 to 1.
    """
    groups = checked_measured("LQI", measured)
    (plant,) = outputs_of(checked_discrete_model("LQI: model", model), groups)
    weights = {
        "output_deviation": output_deviation,
        "integral_deviation": integral_deviation,
        "duty_deviation": duty_deviation,
        "drift": drift,
        "reading_noise": reading_noise,
    }
    cells = plant.B.shape[1]
    if np.shape(setpoint_weight) not in ((), (cells,)):
        raise ControlError(
            f"LQI: setpoint_weight: expected one number, or one for each of the {cells} cells, got "
            f"{setpoint_weight!r}"
        )
    allowed, has_limits = checked_limits("LQI", limits), limits is not None
    lqi = _design(plant, weights, setpoint_weight, allowed, groups, has_limits=has_limits)
    return with_observer(lqi, observer, model, plant)


def _design(
    plant: StateSpace,
    weights: Mapping[str, Numbers],
    setpoint_weight: Numbers,
    limits: DutyLimits,
    measured: tuple[tuple[str, ...], ...] | None,
    *,
    has_limits: bool,
) -> LQI:
    """Designs the gains and the filter on the model of the outputs.

    **Arguments:**

    - `has_limits`: whether the limits hold on every rig.
    - the others: as in `LQI`.
    """
    check_plant("LQI", plant, plant)
    (states, cells), outputs, h = plant.B.shape, len(plant.C), plant.sample_time_s
    assert h is not None
    y, q, u, w, v = (
        checked_deviations("LQI", name, weights[name], size)
        for name, size in (
            ("output_deviation", outputs),
            ("integral_deviation", outputs),
            ("duty_deviation", cells),
            ("drift", outputs),
            ("reading_noise", outputs),
        )
    )
    A = np.block([[plant.A, np.zeros((states, outputs))], [-h * plant.C, np.eye(outputs)]])
    B = np.vstack([plant.B, np.zeros((outputs, cells))])
    Q = np.zeros_like(A)
    Q[:states, :states] = plant.C.T @ np.diag(y**-2.0) @ plant.C
    Q[states:, states:] = np.diag(q**-2.0)
    K, _ = regulator("LQI", A, B, Q, np.diag(u**-2.0))
    Kx, Ki, steady = K[:, :states], -K[:, states:], np.asarray(plant.steady_states)
    return LQI(
        Kx=Kx,
        Ki=Ki,
        Kt=np.linalg.pinv(Ki),
        N=(np.eye(cells) + Kx @ steady) @ np.linalg.pinv(plant.C @ steady),
        model=plant,
        kalman=kalman_filter("LQI", plant, w, v),
        observed=None,
        weights=LQIWeights(y, q, u, w, v),
        sample_time_s=h,
        designed_for=plant.operating_point.rig,
        setpoint_weight=setpoint_weight,
        limits=limits,
        has_own_limits=has_limits,
        measured=measured,
    )
