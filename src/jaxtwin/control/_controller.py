"""What a controller is: a pure function with a state, sampled at its own interval."""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, PyTree

from .._arguments import check_callable, finite_number
from .._errors import ControlError
from ..rig._problems import unknown

Numbers: TypeAlias = npt.ArrayLike | float | int
"""A parameter: a number or an array."""

ControlFunction: TypeAlias = Callable[[Array, Array, Array], npt.ArrayLike]
"""`(time_s, reference, measurement) -> duty`, the temperatures those of every channel, degC."""


Controller = TypeVar("Controller", bound="AbstractController")


class AbstractController(eqx.Module):
    """A controller: from references and measurements to the duty of the cells, sample by sample.

    It is a PyTree: its parameters can be differentiated, and many controllers side by side are one
    whose parameters have a leading axis. What it remembers is a PyTree of its own, the state, which
    `init` makes and `step` takes and returns.

    References and measurements are those of the temperatures that it sees, its outputs: means over
    channels of the rig, see `output_weights`.
    """

    sample_time_s: eqx.AbstractVar[float]
    """Between two samples, s."""

    @property
    def preview_samples(self) -> int:
        """Of how many samples, from the present one on, `step` gets the references: then they are
        `(preview_samples, outputs)`. With 0 it gets those of the present sample alone."""
        return 0

    @abstractmethod
    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """How much each channel of a rig counts in each output.

        **Raises:** `ControlError` where the rig does not have a channel that it measures.
        """

    @abstractmethod
    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The state from which it goes on without a bump.

        **Arguments:**

        - `duty`: what the cells get now, -1 to 1.
        - `measurement`: of the outputs now, degC.
        """

    @abstractmethod
    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, "*preview outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """The duty of the cells until the next sample, and the state there.

        **Arguments:**

        - `state`: of the sample before, or of `init`.
        - `reference`: of the outputs now, degC; with `preview_samples`, now and in the next
          samples.
        - `measurement`: of the outputs now, degC.
        """


class AbstractChannelGroupController(AbstractController):
    """A controller whose outputs are each the mean over a group of channels."""

    measured: eqx.AbstractVar[tuple[tuple[str, ...], ...] | None]
    """The channels of each output; None: a single output, the mean of all."""

    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Equal weights for the channels of an output."""
        return means_of(self.measured, channels)


@final
class FunctionController(AbstractController):
    """A plain function as a controller.

    It sees every channel as an output of its own, and its state is the time.

    **Arguments:**

    - `function`: of time (s), references and measurements `(channels,)`, degC, in `jax.numpy`;
      returns the duty of the cells, -1 to 1.
    - `sample_time_s`: s.
    """

    function: ControlFunction = eqx.field(static=True)
    sample_time_s: float = eqx.field(static=True)

    def __init__(self, function: ControlFunction, sample_time_s: float | int = 1.0):
        check_callable("FunctionController: function", function, ControlError)
        self.function = function
        self.sample_time_s = checked_sample_time("FunctionController", sample_time_s)

    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Each channel is an output."""
        return np.eye(len(channels))

    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " outputs"]
    ) -> PyTree:
        """The time, and what the cells get."""
        duty = jnp.asarray(duty)
        return jnp.zeros((), duty.dtype), duty

    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, " outputs"],
        measurement: Float[ArrayLike, " outputs"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """What the function says."""
        time, last = state
        asked = self.function(time, jnp.asarray(reference), jnp.asarray(measurement))
        duty = jnp.broadcast_to(jnp.asarray(asked, last.dtype), last.shape)
        return duty, (time + self.sample_time_s, duty)


def as_controller(
    where: str, controller: Any, sample_time_s: float | int | None = None
) -> AbstractController:
    """A controller, or a plain function made one.

    **Arguments:**

    - `where`: function and argument, for the message.
    - `sample_time_s`: of a plain function; None: 1 s.

    **Raises:** `ControlError` where it is neither, or a controller that has a sample time is
    given another.
    """
    if isinstance(controller, AbstractController):
        if sample_time_s is not None and sample_time_s != controller.sample_time_s:
            raise ControlError(
                f"{where}: expected a sample time only beside a plain function, got "
                f"{sample_time_s!r} s beside a controller with {controller.sample_time_s:g} s"
            )
        return controller
    if controller is None:
        raise ControlError(f"{where}: expected a controller or a function, got None")
    check_callable(where, controller, ControlError)
    interval = 1.0 if sample_time_s is None else sample_time_s
    return FunctionController(controller, checked_sample_time(where, interval))


def parameter_names(controller: AbstractController) -> tuple[str, ...]:
    """Those of its fields that are numbers: what can be drawn and tuned."""
    return tuple(
        field.name
        for field in dataclasses.fields(controller)
        if not field.metadata.get("static", False)
        and isinstance(getattr(controller, field.name), np.ndarray | jax.Array | float)
    )


def with_parameters(controller: Controller, values: Mapping[str, Any]) -> Controller:
    """The same controller with other values of some parameters."""
    for name, value in values.items():
        controller = eqx.tree_at(lambda c, name=name: getattr(c, name), controller, value)
    return controller


def checked_sample_time(where: str, sample_time_s: object) -> float:
    """**Raises:** `ControlError` where it is no number above 0."""
    number = finite_number(f"{where}: sample_time_s", sample_time_s, ControlError)
    if number <= 0:
        raise ControlError(
            f"{where}: sample_time_s: expected a number above 0, in s, got {sample_time_s!r}"
        )
    return number


def means_of(
    measured: Sequence[Sequence[str]] | None, channels: Sequence[str]
) -> Float[np.ndarray, "outputs channels"]:
    """Weights of outputs that are each the mean of some channels; None: one mean over all.

    **Raises:** `ControlError` where the rig does not have one of them.
    """
    if measured is None:
        return np.full((1, len(channels)), 1 / len(channels))
    weights = np.zeros((len(measured), len(channels)))
    for output, names in enumerate(measured):
        for name in names:
            if name not in channels:
                raise ControlError(f"measured: {unknown('channel', name, channels)}")
            weights[output, list(channels).index(name)] += 1 / len(names)
    return weights


def checked_measured(
    where: str, measured: Sequence[str | Sequence[str]] | None
) -> tuple[tuple[str, ...], ...] | None:
    """Outputs as tuples of channels; a single name is an output of one channel.

    **Raises:** `ControlError` where there is none, or one without a channel.
    """
    if measured is None:
        return None
    groups = tuple((part,) if isinstance(part, str) else tuple(part) for part in measured)
    if not groups or not all(groups) or isinstance(measured, str):
        raise ControlError(
            f"{where}: measured: expected channels, or groups of channels, such as "
            f"[['T11', 'T12'], ['T15', 'T16']], got {measured!r}"
        )
    return groups


def checked_limits(where: str, limits: Sequence[float | int]) -> tuple[float, float]:
    """Lowest and highest duty.

    **Raises:** `ControlError` where they are not from -1 to 1, or not in this order.
    """
    try:
        lowest, highest = (float(limit) for limit in limits)
        if not -1 <= lowest < highest <= 1:
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: limits: expected the lowest and the highest duty, from -1 to 1, got "
            f"{limits!r}"
        ) from None
    return lowest, highest


def check_parameters(where: str, **parameters: Any) -> None:
    """Refuses parameters that are no finite numbers of at least 0; traced ones have none yet.

    **Raises:** `ControlError` that names the first.
    """
    for name, value in parameters.items():
        if isinstance(value, Tracer) or not _is_array(value):
            continue  # tree transformations put other things into the leaves of a module
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or not np.all(np.isfinite(array) & (array >= 0)):
            raise ControlError(
                f"{where}: {name}: expected finite numbers of at least 0, got {value!r}"
            )


def checked_deviations(
    where: str, name: str, value: Numbers, size: int
) -> Float[np.ndarray, " size"]:
    """A deviation, or one for each output or cell, at which a design is aimed.

    **Raises:** `ControlError` where it is neither, or not finite and above 0.
    """
    try:
        numbers = np.broadcast_to(np.asarray(value, float), (size,)).copy()
        if not np.all(np.isfinite(numbers) & (numbers > 0)):
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: {name}: expected a finite number above 0, or {size} of them, got {value!r}"
        ) from None
    return numbers


def _is_array(value: object) -> bool:
    return isinstance(value, int | float | str | bool | np.ndarray | np.generic | jax.Array | list)
