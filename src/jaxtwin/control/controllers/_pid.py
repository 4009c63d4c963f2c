r"""PID, discrete in time.

With the error $e = r - y$ and sample time $h$,

$$P_k = K_p (b\,r_k - y_k), \quad
D_k = \frac{T_f D_{k-1} + K_d (d_k - d_{k-1})}{T_f + h}, \; d = c\,r - y,$$

$$v_k = P_k + I_k + D_k, \quad u_k = \mathrm{sat}(v_k), \quad
I_{k+1} = I_k + K_i h\,e_k + \frac{h}{T_t} (u_k - v_k)$$

(Åström and Hägglund, *Advanced PID Control*, 2006, chapters 3 and 13; the derivative by backward
differences, which is stable for every sample time). With clamping the last term is left out, and
$K_i h e_k$ too where $v_k$ is beyond a limit and it would take it farther (conditional
integration).

Cells and heaters that follow one output have one integral, of the demand, in which each has a share
$w_i = K_{i,i} / \max K_i$: $v_i = P_i + w_i I + D_i + o_i$. If each had its own, those that reached
a limit first would be left with another integral, and at rest a cell would cool against a heater.
The demand is beyond the limits only where it is beyond those of each: while the heaters wait at 0,
the cell still cools. The largest $(v_i - u_i) / w_i$ is taken back then, but no more than leads to
the limit. The offset $o_i$ with which a duty goes on where it was decays with $T_t$, and set-point
weights act through the demand.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._jax_settings import own_settings
from ...errors import ControlError
from ._controller import (
    AbstractController,
    DutyLimits,
    Law,
    Numbers,
    bundled_law,
    check_non_negative,
    checked_measured,
    checked_sample_time,
    of_cells,
    parameter_names,
    parameter_text,
)
from ._controller_fields import OWN, ControllerField, FileContents
from ._duty_limits import AbstractDutyLimitedController, GivenLimits, checked_limits

PROPORTIONAL = ControllerField("a gain", "1/K", "0.1 1/K", "zero", is_required=True)
INTEGRAL = ControllerField("a gain", "1/(K s)", "0.002 1/(K s)", "zero")
WEIGHT = ControllerField("a number without unit", "", "0.7", "zero")

Parameter: TypeAlias = Float[Array | np.ndarray, "..."]
"""A single value, or one for each cell."""


AntiWindup: TypeAlias = Literal["back-calculation", "clamping"]

# What the integral may do at a limit of the duty.
ANTI_WINDUPS = ("back-calculation", "clamping")


class PIDState(NamedTuple):
    """The state of a `PID`: the integral of each output, the offset and the derivative part of each
    cell, and d of each output."""

    integral: Float[Array, " outputs"]
    offset: Float[Array, " cells"]
    derivative: Float[Array, " cells"]
    last: Float[Array, " outputs"]


@final
class PID(AbstractDutyLimitedController):
    """A PID controller for each cell, all with the same output or each with its own.

    ```python
    PID(Kp=0.1, Ki=0.002, measured=[["T11", "T21", "TAM"], ["T16", "T26", "TCM"]])
    ```

    If there is a single output, all cells and heaters follow it. They have one integral, so that
    none works against another: below 0 the cells cool and the heaters are off. With the same gains
    their duty cycles are equal within the limits of each; a difference at the start decays.

    **Arguments:** gains are single numbers or one for each cell.

    - `Kp`: proportional gain, 1/K. `Ki`: integral gain, 1/(K s). `Kd`: derivative gain, s/K.
    - `Tf`: time constant of the derivative's filter, s.
    - `setpoint_weight`: b, the weight of the reference in the proportional part; values below 1
      overshoot less.
    - `derivative_weight`: c, the same for the derivative part: with 0 it is the derivative of the
      measurement alone.
    - `tracking_time_s`: time constant of the anti-windup by back-calculation, s; None for Kp / Ki.
      It is at least the sample time.
    - `anti_windup`: what the integral does at a limit of the duty: `"back-calculation"`, or
      `"clamping"`, with which it stops as long as it would only grow farther beyond the limit.
      Clamping needs no time; back-calculation takes back what has been integrated too far.
    - `limits`: the lowest and the highest duty, within -1 to 1, each a number or one for each cell
      and heater. (0, 1) never cools. None for -1 to 1 of a cell and 0 to 1 of a heater; beside
      cells, a heater's lowest duty is never below 0.
    - `sample_time_s`: the sample time, s.
    - `measured`: the outputs, each a channel or a group of channels that is averaged; None for the
      mean over all channels.

    **Raises:** `ControlError` if a gain is not a finite number of at least 0, the limits are not
    within -1 to 1, or the sample time is not positive.
    """

    kind: ClassVar[str] = "pid"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "Kp": PROPORTIONAL,
        "Ki": INTEGRAL,
        "Kd": ControllerField("a gain", "s/K", "0.5 s/K", "zero"),
        "Tf": ControllerField("a time", "s", "2 s", "zero"),
        "setpoint_weight": WEIGHT,
        "derivative_weight": WEIGHT,
        "tracking_time": ControllerField("a time", "s", "1 s"),
        "anti_windup": OWN,
    }

    Kp: Parameter
    Ki: Parameter
    Kd: Parameter
    Tf: Parameter
    setpoint_weight: Parameter
    derivative_weight: Parameter
    tracking_time_s: Parameter | None
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True, repr=False)
    sample_time_s: float = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)
    anti_windup: AntiWindup = eqx.field(static=True, repr=False)

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
        limits: GivenLimits | None = None,
        sample_time_s: float | int = 1.0,
        measured: Sequence[str | Sequence[str]] | None = None,
        anti_windup: AntiWindup = "back-calculation",
    ):
        self.check_parameters(
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
        self.has_own_limits = limits is not None
        self.sample_time_s = checked_sample_time("PID", sample_time_s)
        self.measured = checked_measured("PID", measured)
        if anti_windup not in ANTI_WINDUPS:
            expected = " or ".join(map(repr, ANTI_WINDUPS))
            raise ControlError(f"PID: anti_windup: expected {expected}, got {anti_windup!r}")
        if anti_windup == "clamping" and tracking_time_s is not None:
            raise ControlError(
                "PID: tracking_time_s: expected None with clamping, which has none, got "
                f"{tracking_time_s!r}"
            )
        self.anti_windup = anti_windup

    @classmethod
    def check_parameters(cls, **values: Any) -> None:
        """Refuses parameters that are not finite numbers of at least 0, or a tracking time of 0."""
        check_non_negative("PID", **values)
        check_tracking_time("PID", values.get("tracking_time_s"))

    @property
    def is_linear(self) -> bool:
        """True within the limits."""
        return True

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a controller from its file, in which the anti-windup is a word."""
        if "anti_windup" in contents.data:
            result = contents.data["anti_windup"]
            if result not in ANTI_WINDUPS:
                expected = " or ".join(map(repr, ANTI_WINDUPS))
                contents.refuse("anti_windup", f"expected {expected}, got {result!r}")
            contents = contents._replace(common={**contents.common, "anti_windup": result})
        return super().from_file(contents)

    def file_lines(self) -> list[str]:
        """Returns the lines of the gains, and of an anti-windup that is not the usual one."""
        lines = super().file_lines()
        usual = self.anti_windup == "back-calculation"
        return lines if usual else [*lines, f"anti_windup = {json.dumps(self.anti_windup)}"]

    @classmethod
    def fits_outputs(cls, outputs: int, cells: int) -> bool:
        """All cells follow one output, or each its own."""
        return outputs in (1, cells)

    def law(self, cells: int) -> Law:
        """The law, with the factors of a sample multiplied beforehand, and without the derivative
        if Kd is 0."""
        h, tracking = self.sample_time_s, self.tracking_time_s
        each = {
            name: of_cells(name, value, cells)
            for name in parameter_names(self)
            if (value := getattr(self, name)) is not None
        }
        Kp, Kd, Tf, c = (each[name] for name in ("Kp", "Kd", "Tf", "derivative_weight"))
        outputs = 1 if self.measured is None else len(self.measured)
        with own_settings():
            numbers = [np.asarray(part, float) for part in self._split(outputs, cells)]
        share, reference_gain, rate, tracking_gain = (
            np.broadcast_to(part, (cells,)) for part in numbers
        )
        constants = {"HAS_DERIVATIVE": 1} if Kd.any() else {}
        if self.anti_windup == "clamping":
            constants["CLAMPS"] = 1
        tables = {
            "Kp": (Kp, "1/K"),
            "reference_gain": (reference_gain, "of the reference, by the set-point weight, 1/K"),
            "Ki_h": (rate * h, "Ki times the sample time, 1/K"),
            "tracking_gain": (tracking_gain, "sample time / tracking time"),
        }
        if outputs < cells:
            tables["share"] = share, "share of each in the demand"
        if Kd.any():
            tables |= {
                "c": (c, "set-point weight of the derivative"),
                "decay": (Tf / (Tf + h), "of the derivative's filter"),
                "Kd_h": (Kd / (Tf + h), "Kd / (Tf + sample time), 1/K"),
            }
        parameters = [
            parameter_text("Kp", self.Kp, "1/K"),
            parameter_text("Ki", self.Ki, "1/(K s)"),
            parameter_text("Kd", self.Kd, "s/K"),
            parameter_text("Tf", self.Tf, "s"),
            parameter_text("set-point weight", self.setpoint_weight, ""),
            parameter_text("set-point weight of the derivative", self.derivative_weight, ""),
            "clamping"
            if self.anti_windup == "clamping"
            else "tracking time: Kp / Ki"
            if tracking is None
            else parameter_text("tracking time", self.tracking_time_s, "s"),
        ]
        state = {"offset": cells} if outputs < cells else {}
        if Kd.any():
            state |= {"derivative": cells, "last": cells}
        return Law(
            bundled_law("pid.c"),
            "a PID for each cell",
            tables,
            state,
            parameters,
            constants,
            integrals=outputs,
        )

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state with which the duty stays where it is while the reference equals the
        measurement and the plate is at rest."""
        duty, y = jnp.asarray(duty), jnp.asarray(measurement)
        parts = self._split(y.size, duty.size)
        rest = duty - parts.reference_gain * y
        offset = jnp.zeros_like(rest)
        integral = rest
        if y.size < duty.size:
            # A heater at 0 says nothing about a demand below 0.
            lowest, highest = self.duty_bounds(duty.dtype)
            is_free = (duty > lowest) & (duty < highest)
            counted = (is_free | ~jnp.any(is_free)) * parts.share
            integral = _projected(rest, counted, parts.share)
            asked = parts.reference_gain * y + parts.share * integral
            # Where the demand gives this duty by the limits, nothing is to decay.
            offset = jnp.where(self.limited(asked) == duty, 0.0, duty - asked)
        last = (jnp.asarray(self.derivative_weight) - 1) * y
        return PIDState(integral, offset, jnp.zeros_like(rest), last + jnp.zeros_like(y))

    def taken_over(
        self, before: "PID", state: PyTree, measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state with which this controller asks for the duty that another one asks for from its
        state, if the reference equals the measurement."""
        y = jnp.asarray(measurement)
        outputs, cells = y.size, state.offset.size
        was, now = before._split(outputs, cells), self._split(outputs, cells)
        rest = (was.reference_gain - now.reference_gain) * y + was.share * state.integral
        if outputs == cells:
            return state._replace(integral=rest)
        integral = _projected(rest, now.share, now.share)
        offset = state.offset + rest - now.share * integral
        return state._replace(integral=integral, offset=offset)

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        r, y, h = jnp.asarray(reference), jnp.asarray(measurement), self.sample_time_s
        outputs, cells = y.size, state.offset.size
        share, reference_gain, rate, tracking_gain = self._split(outputs, cells)
        weighted = jnp.asarray(self.derivative_weight) * r - y
        derivative = (self.Tf * state.derivative + self.Kd * (weighted - state.last)) / (
            self.Tf + h
        )
        proportional = self.Kp * (r - y) + reference_gain * r
        asked = proportional + share * state.integral + state.offset + derivative
        duty = self.limited(asked)
        excess, offset = tracking_gain * (asked - duty), state.offset
        if outputs < cells:
            excess, offset = (
                _excess_of_all(asked - duty, share, tracking_gain),
                offset - tracking_gain * offset,
            )
        change = rate * h * (r - y)
        if self.anti_windup == "clamping":
            change = jnp.where(change * excess > 0, 0.0, change)
        else:
            change = change - excess
        integral = state.integral + change
        return duty, PIDState(integral, offset, derivative, weighted)

    def _split(self, outputs: int, cells: int) -> "_Split":
        """How the cells share the integrals of the outputs."""
        Kp, Ki = jnp.asarray(self.Kp), jnp.asarray(self.Ki)
        reference_gain = Kp * (jnp.asarray(self.setpoint_weight) - 1)
        tracking_gain = tracking_share(Kp, Ki, self.tracking_time_s, self.sample_time_s)
        if outputs == cells:
            return _Split(jnp.ones((), Kp.dtype), reference_gain, Ki, tracking_gain)
        rate = Ki.max()
        share = jnp.where(rate > 0, Ki / jnp.where(rate > 0, rate, 1.0), 1.0)
        share, reference_gain = (
            jnp.broadcast_to(part, (cells,)) for part in (share, reference_gain)
        )
        # Without an integral nothing takes the place of a reference_gain.
        reference_gain = jnp.where(
            rate > 0, share * _projected(reference_gain, share, share), reference_gain
        )
        return _Split(share, reference_gain, rate, tracking_gain.max())


class _Split(NamedTuple):
    """How cells share the integrals of the outputs.

    - `share`: the share of each in the integral of its output.
    - `reference_gain`: the part of the duty that is proportional to the reference because of the
      set-point weights, 1/K.
    - `rate`: the integral gain of each integral, 1/(K s).
    - `tracking_gain`: the part of what is beyond the limits that is taken back in a sample, and of
      an offset that decays.
    """

    share: Float[Array, "*cells"]
    reference_gain: Float[Array, "*cells"]
    rate: Float[Array, "*outputs"]
    tracking_gain: Float[Array, "*outputs"]


def _projected(
    duty: Float[Array, " cells"], counted: Float[Array, " cells"], share: Float[Array, " cells"]
) -> Float[Array, " 1"]:
    """The demand whose shares are nearest to some duty, by least squares over those counted."""
    size = (counted * share).sum()
    return ((counted * duty).sum() / jnp.where(size > 0, size, 1.0))[None]


def _excess_of_all(
    beyond: Float[Array, " cells"], share: Float[Array, " cells"], tracking_gain: Float[Array, ""]
) -> Float[Array, " 1"]:
    """What a sample takes back from the demand that cells share.

    It is nothing while one of them follows the demand: the integral of a cell that cools would
    otherwise be pulled towards the heaters' 0, with a lasting error. Where none follows, the excess
    of the one that is farthest beyond its limit counts, but never more than leads back to the limit
    of the nearest.
    """
    counted = share > 0
    excess = beyond / jnp.where(counted, share, 1.0)
    smallest = jnp.where(counted, excess, jnp.inf).min()
    largest = jnp.where(counted, excess, -jnp.inf).max()
    above = jnp.maximum(jnp.minimum(tracking_gain * largest, smallest), 0.0)
    below = jnp.minimum(jnp.maximum(tracking_gain * smallest, largest), 0.0)
    return (above + below)[None]


def tracking_share(
    Kp: Parameter,
    Ki: Parameter,
    tracking_time_s: Parameter | None,
    sample_time_s: float,
) -> Float[Array, "*cells"]:
    """The part of the excess (the duty asked for, less the limited one) that a sample takes back
    from the integral: h / Tt, at most 1.

    Without an integral gain there is no windup.
    """
    Kp, Ki = jnp.asarray(Kp), jnp.asarray(Ki)
    # Both branches stay finite, and so do their derivatives.
    time = tracking_time_s
    if time is None:
        time = Kp / jnp.where(Ki > 0, Ki, 1.0)
    share = sample_time_s / jnp.maximum(jnp.asarray(time), sample_time_s)
    return jnp.where(Ki > 0, share, 0.0)


def check_tracking_time(where: str, tracking_time_s: Any) -> None:
    """Refuses a tracking time of 0, with which no anti-windup can be meant.

    **Raises:** `ControlError`.
    """
    checked = isinstance(tracking_time_s, float | int | list | tuple | np.ndarray)
    if checked and not np.all(tracking_time_s):
        raise ControlError(
            f"{where}: tracking_time_s: expected a time above 0 s, or None for Kp / Ki, got "
            f"{tracking_time_s!r}"
        )


def as_parameter(value: Numbers) -> Parameter:
    """A parameter as an array whose precision JAX chooses."""
    if isinstance(value, int | float | list | tuple | np.generic):
        return np.asarray(value, np.float64)
    if isinstance(value, np.ndarray):
        return value.astype(np.float64)
    return value  # pyright: ignore[reportReturnType]
