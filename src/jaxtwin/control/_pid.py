r"""PID, discrete in time.

With the error $e = r - y$ and sample time $h$,

$$P_k = K_p (b\,r_k - y_k), \quad
D_k = \frac{T_f D_{k-1} + K_d (d_k - d_{k-1})}{T_f + h}, \; d = c\,r - y,$$

$$v_k = P_k + I_k + D_k, \quad u_k = \mathrm{sat}(v_k), \quad
I_{k+1} = I_k + K_i h\,e_k + \frac{h}{T_t} (u_k - v_k)$$

(Åström and Hägglund, *Advanced PID Control*, 2006, chapters 3 and 13; the derivative by backward
differences, which is stable for every sample time).
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpy.typing import ArrayLike

from ._controller import (
    AbstractChannelGroupController,
    Numbers,
    check_parameters,
    checked_limits,
    checked_measured,
    checked_sample_time,
)

Parameter: TypeAlias = Float[Array | np.ndarray, "..."]
"""A single value, or one for each cell."""


class PIDState(NamedTuple):
    """What a PID remembers: integral and derivative part of each cell, and d of each output."""

    integral: Float[Array, " cells"]
    derivative: Float[Array, " cells"]
    last: Float[Array, " outputs"]


@final
class PID(AbstractChannelGroupController):
    """A PID for each cell: of the same output for all cells, or of one output each.

    ```python
    PID(Kp=0.1, Ki=0.002, measured=[["T11", "T21", "TAM"], ["T16", "T26", "TCM"]])
    ```

    Where only one output is measured, all cells follow it with the same gains; they get equal duty
    unless they had different ones at the start.

    **Arguments:** gains are single numbers or one for each cell.

    - `Kp`: 1/K. `Ki`: 1/(K s). `Kd`: s/K, on the measurement.
    - `Tf`: time constant of the derivative's filter, s.
    - `setpoint_weight`: b, how much of the reference the proportional part sees; less than 1
      overshoots less.
    - `derivative_weight`: c, the same for the derivative part: 0 is a derivative of the measurement
      alone.
    - `tracking_time_s`: of the anti-windup by back-calculation, s; None: Kp / Ki. Shorter ones than
      the sample time count as the sample time.
    - `limits`: of the duty, within -1 to 1. (0, 1) never cools.
    - `sample_time_s`: s.
    - `measured`: the outputs, each a channel or a group of channels whose mean counts; None: the
      mean over all channels.

    **Raises:** `ControlError` where a gain is no finite number of at least 0, the limits are
    not from -1 to 1, or the sample time is not above 0.
    """

    Kp: Parameter
    Ki: Parameter
    Kd: Parameter
    Tf: Parameter
    setpoint_weight: Parameter
    derivative_weight: Parameter
    tracking_time_s: Parameter | None
    limits: tuple[float, float] = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)

    def __init__(
        self,
        Kp: Numbers,
        Ki: Numbers = 0.0,
        Kd: Numbers = 0.0,
        Tf: Numbers = 0.0,
        *,
        setpoint_weight: Numbers = 1.0,
        derivative_weight: Numbers = 0.0,
        tracking_time_s: Numbers | None = None,
        limits: Sequence[float | int] = (-1.0, 1.0),
        sample_time_s: float | int = 1.0,
        measured: Sequence[str | Sequence[str]] | None = None,
    ):
        check_parameters(
            "PID",
            Kp=Kp,
            Ki=Ki,
            Kd=Kd,
            Tf=Tf,
            setpoint_weight=setpoint_weight,
            derivative_weight=derivative_weight,
            tracking_time_s=tracking_time_s,
        )
        self.Kp, self.Ki, self.Kd, self.Tf = (as_parameter(value) for value in (Kp, Ki, Kd, Tf))
        self.setpoint_weight = as_parameter(setpoint_weight)
        self.derivative_weight = as_parameter(derivative_weight)
        self.tracking_time_s = None if tracking_time_s is None else as_parameter(tracking_time_s)
        self.limits = checked_limits("PID", limits)
        self.sample_time_s = checked_sample_time("PID", sample_time_s)
        self.measured = checked_measured("PID", measured)

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state from which the duty goes on where it is, with the reference at the measurement
        and the plate at rest."""
        duty, y = jnp.asarray(duty), jnp.asarray(measurement)
        integral = duty - self.Kp * (self.setpoint_weight - 1) * y
        last = (jnp.asarray(self.derivative_weight) - 1) * y
        return PIDState(integral, jnp.zeros_like(integral), last + jnp.zeros_like(y))

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """One sample."""
        r, y, h = jnp.asarray(reference), jnp.asarray(measurement), self.sample_time_s
        weighted = jnp.asarray(self.derivative_weight) * r - y
        derivative = (self.Tf * state.derivative + self.Kd * (weighted - state.last)) / (
            self.Tf + h
        )
        asked = self.Kp * (self.setpoint_weight * r - y) + state.integral + derivative
        duty = jnp.clip(asked, *self.limits)
        back = tracking_share(self.Kp, self.Ki, self.tracking_time_s, h)
        integral = state.integral + self.Ki * h * (r - y) + back * (duty - asked)
        return duty, PIDState(integral, derivative, weighted)


def tracking_share(
    Kp: Parameter,
    Ki: Parameter,
    tracking_time_s: Parameter | None,
    sample_time_s: float,
) -> Float[Array, "*cells"]:
    """Which part of what the limits cut off leaves the integral in a sample: h / Tt, at most 1.

    Without an integral gain there is nothing to wind up.
    """
    Kp, Ki = jnp.asarray(Kp), jnp.asarray(Ki)
    # Both branches stay finite, and so do their derivatives.
    time = tracking_time_s
    if time is None:
        time = Kp / jnp.where(Ki > 0, Ki, 1.0)
    share = sample_time_s / jnp.maximum(jnp.asarray(time), sample_time_s)
    return jnp.where(Ki > 0, share, 0.0)


def as_parameter(value: Numbers) -> Parameter:
    """A parameter as an array that leaves the choice of precision to JAX."""
    if isinstance(value, int | float | list | tuple | np.generic):
        return np.asarray(value, np.float64)
    if isinstance(value, np.ndarray):
        return value.astype(np.float64)
    return value  # pyright: ignore[reportReturnType]
