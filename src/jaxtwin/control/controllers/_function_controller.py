"""A controller made from a plain function."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._arguments import check_callable
from ...errors import ControlError
from ...rig import Rig
from ._controller import AbstractController, checked_sample_time

# `(time_s, reference, measurement) -> duty`, with the temperatures of all channels, degC.
ControlFunction: TypeAlias = Callable[[Array, Array, Array], npt.ArrayLike]


@final
class FunctionController(AbstractController):
    """A controller made from a plain function.

    Each channel of the rig is an output. The state consists of the time and the last duty. A
    function may command every duty, so its `limits` are -1 and 1.

    **Arguments:**

    - `function`: a function in `jax.numpy` of the time, s, and of references and measurements,
      `(channels,)`, degC. It returns the duty of the cells, -1 to 1.
    - `sample_time_s`: the sample time, s.

    **Raises:** `ControlError` if the function is not callable, or the sample time is not positive.
    """

    function: ControlFunction = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)
    limits: tuple[float, float] = eqx.field(static=True)

    def __init__(self, function: ControlFunction, sample_time_s: float | int = 1.0):
        check_callable("FunctionController: function", function, ControlError)
        self.function = function
        self.sample_time_s = checked_sample_time("FunctionController", sample_time_s)
        self.limits = (-1.0, 1.0)

    @property
    def is_linear(self) -> bool:
        """False: a function may be anything."""
        return False

    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Returns the unit matrix: each channel is an output."""
        return np.eye(len(channels))

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """Returns time 0 and the present duty."""
        duty = jnp.asarray(duty)
        return jnp.zeros((), duty.dtype), duty

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Calls the function."""
        time, last = state
        returned = self.function(time, jnp.asarray(reference), jnp.asarray(measurement))
        if returned is None:
            raise ControlError(
                f"FunctionController: expected a function that returns a duty, or {last.size} of "
                "them, one for each cell, got None; does it end without a return?"
            )
        asked = jnp.asarray(returned)
        if asked.shape not in ((), (1,), last.shape):
            raise ControlError(
                f"FunctionController: expected a function that returns a duty, or {last.size} of "
                f"them, one for each cell, got an array of shape {asked.shape}"
            )
        duty = jnp.broadcast_to(asked.astype(last.dtype), last.shape)
        return duty, (time + self.sample_time_s, duty)


def as_controller(
    where: str, controller: Any, rig: Rig, sample_time_s: float | int | None = None
) -> AbstractController:
    """Returns a controller as it commands a rig, and makes one from a plain function.

    **Arguments:**

    - `where`: the name of function and argument, for error messages.
    - `sample_time_s`: the sample time of a plain function, s; None for 1 s.

    **Raises:** `ControlError` if it is neither, or if another sample time is given beside a
    controller.
    """
    if isinstance(controller, AbstractController):
        if sample_time_s is not None and sample_time_s != controller.sample_time_s:
            raise ControlError(
                f"{where}: expected a sample time only beside a plain function, got "
                f"{sample_time_s!r} s beside a controller with {controller.sample_time_s:g} s"
            )
        return controller.for_rig(rig)
    if controller is None:
        raise ControlError(f"{where}: expected a controller or a function, got None")
    check_callable(where, controller, ControlError)
    interval = 1.0 if sample_time_s is None else sample_time_s
    return FunctionController(controller, checked_sample_time(where, interval))
