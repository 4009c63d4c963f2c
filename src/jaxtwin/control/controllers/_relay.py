r"""Relay feedback: the plate oscillates about a reference at the critical frequency of the loop.

The relay commands a bias plus or minus an amplitude, and switches when the output leaves a band of
hysteresis about the reference. The loop oscillates at the frequency at which the phase of the plant
is about -180 degrees. Period and amplitude of the oscillation give the gain at this frequency, and
from both follows a controller
(Åström and Hägglund, *Automatica* 20 (1984) 645-651).
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from ..._arguments import finite_number
from ...errors import ControlError
from ._controller import (
    AbstractController,
    DutyLimits,
    Numbers,
    check_non_negative,
    checked_measured,
    checked_sample_time,
)
from ._controller_fields import ControllerField, FileContents
from ._duty_limits import AbstractDutyLimitedController, GivenLimits, checked_limits
from ._pid import Parameter, as_parameter


class RelayState(NamedTuple):
    """The state of a `Relay`.

    - `is_up`: whether the relay is up.
    - `half_s`: the time since it last switched, s. `up_s`: the duration of the last half in which
      it was up, s.
    - `shift`: the shift of the bias of each cell, in amplitudes.
    - `switches`: the number of times that it has switched.
    - `is_over`: whether the time-out has passed.
    """

    is_up: Bool[Array, ""]
    half_s: Float[Array, ""]
    up_s: Float[Array, ""]
    shift: Float[Array, " cells"]
    switches: Float[Array, ""]
    is_over: Bool[Array, ""]


@final
class Relay(AbstractDutyLimitedController):
    """A relay with hysteresis, for finding the gain and the period of a critical oscillation.

    ```python
    relay = Relay(amplitude=0.1, bias=0.4, hysteresis=0.1, limits=(0, 1))
    run = jt.simulate_closed_loop(twin, relay, 40, duration=900)
    point = ultimate_point(run)
    pid = point.pid(limits=(0, 1))
    ```

    If the bias does not hold the reference, the two halves of a cycle differ in length. After each
    cycle, the bias moves such that they become equal.

    **Arguments:**

    - `amplitude`: the amplitude of the duty, one number for all cells or one for each; 0 for a cell
      that does not switch.
    - `bias`: the duty about which the relay switches, -1 to 1, one number for all cells or one for
      each.
    - `hysteresis`: half the width of the band, K; several times the noise of the output.
    - `timeout_s`: the relay switches the cells off for good after this time without a switch, s.
      The way to the reference is included.
    - `measured`: the output, a channel or a group of channels that is averaged; None for the mean
      over all channels.
    - `limits`, `sample_time_s`: as in `PID`.

    **Raises:** `ControlError` if the amplitude or the time-out is not above 0, if the hysteresis is
    negative, if the bias is not within -1 to 1, or if there are several outputs.
    """

    kind: ClassVar[str] = "relay"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "amplitude": ControllerField("a duty", "", "0.1", "zero", is_required=True),
        "bias": ControllerField("a duty", "", "0.4", "any", is_required=True),
        "hysteresis": ControllerField(
            "a temperature difference", "K", "0.1 K", "zero", is_required=True, is_single=True
        ),
        "timeout": ControllerField("a time", "s", "1 s", is_single=True),
    }

    amplitude: Parameter
    bias: Parameter
    hysteresis: Parameter
    timeout_s: float = eqx.field(static=True)
    limits: DutyLimits = eqx.field(static=True)
    has_own_limits: bool = eqx.field(static=True, repr=False)
    sample_time_s: float = eqx.field(static=True)
    measured: tuple[tuple[str, ...], ...] | None = eqx.field(static=True)

    def __init__(
        self,
        amplitude: Numbers,
        bias: Numbers,
        hysteresis: Numbers,
        *,
        timeout_s: float | int = 600.0,
        measured: str | Sequence[str] | None = None,
        limits: GivenLimits | None = None,
        sample_time_s: float | int = 1.0,
    ):
        self.check_parameters(amplitude=amplitude, bias=bias, hysteresis=hysteresis)
        self.amplitude, self.bias = as_parameter(amplitude), as_parameter(bias)
        self.hysteresis = as_parameter(hysteresis)
        self.timeout_s = finite_number("Relay: timeout_s", timeout_s, ControlError, above=0)
        group = None if measured is None else [measured]
        self.measured = checked_measured("Relay", group)
        self.limits = checked_limits("Relay", limits)
        self.has_own_limits = limits is not None
        self.sample_time_s = checked_sample_time("Relay", sample_time_s)

    @classmethod
    def check_parameters(cls, **values: Any) -> None:
        """Refuses an amplitude that is nowhere above 0, a negative amplitude or hysteresis, and a
        bias outside of -1 to 1."""
        bias = values.pop("bias", 0.0)
        check_non_negative("Relay", **values)
        amplitude = as_parameter(values.get("amplitude", 1.0))
        if isinstance(amplitude, np.ndarray) and not np.any(amplitude > 0):
            raise ControlError(
                f"Relay: amplitude: expected a number above 0, got {values['amplitude']!r}"
            )
        array = as_parameter(bias)
        if isinstance(array, np.ndarray) and not np.all(np.abs(array) <= 1):
            raise ControlError(f"Relay: bias: expected a duty from -1 to 1, got {bias!r}")

    @property
    def is_linear(self) -> bool:
        """False: a relay switches."""
        return False

    @classmethod
    def from_file(cls, contents: FileContents) -> AbstractController:
        """Makes a relay from its file, in which the output is a list with a single group."""
        measured = contents.common.get("measured")
        if measured is None:
            return super().from_file(contents)
        if len(measured) != 1:
            contents.refuse(
                "measured",
                f"expected one output, got {len(measured)}; channels that are averaged have "
                'brackets of their own, such as [["T11", "T16"]]',
            )
        common = {**contents.common, "measured": measured[0]}
        return super().from_file(contents._replace(common=common))

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """Returns the state of a relay that has just switched up."""
        shift = jnp.zeros_like(jnp.asarray(duty))
        zero = jnp.zeros((), shift.dtype)
        return RelayState(jnp.asarray(True), zero, zero, shift, zero, jnp.asarray(False))

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of a sample and the next state."""
        error = (jnp.asarray(reference) - jnp.asarray(measurement))[0]
        goes_up = ~state.is_up & (error > self.hysteresis)
        goes_down = state.is_up & (error < -jnp.asarray(self.hysteresis))
        has_switched = goes_up | goes_down
        # The way to the reference is not a half of a cycle.
        up_s = jnp.where(goes_down & (state.switches > 0), state.half_s, state.up_s)
        is_cycle = goes_up & (state.up_s > 0)
        both = jnp.where(is_cycle, state.up_s + state.half_s, 1.0)
        shift = state.shift + jnp.where(is_cycle, (state.up_s - state.half_s) / both, 0.0)
        shift = shift.astype(state.shift.dtype)
        half_s = jnp.where(has_switched, 0.0, state.half_s)
        is_over = state.is_over | (half_s >= self.timeout_s)
        is_up = jnp.where(has_switched, goes_up, state.is_up)
        aim = jnp.where(is_up, 1.0, -1.0).astype(half_s.dtype) + shift
        duty = self.limited(self.bias + self.amplitude * aim)
        later = RelayState(
            is_up,
            half_s + self.sample_time_s,
            up_s,
            shift,
            state.switches + has_switched,
            is_over,
        )
        return jnp.where(is_over, 0.0, duty), later
