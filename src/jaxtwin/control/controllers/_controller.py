"""The interface of controllers: pure functions with a state, sampled at a fixed interval, whose law
may have a form in C."""

import dataclasses
import functools
import re
import sys
import warnings
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import numpy as np
import numpy.typing as npt
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..._arguments import finite_number, is_ordered
from ..._name_suggestions import unknown_name
from ..._number_text import short_number
from ..._pint_quantities import is_pint
from ...errors import ControlError
from ...rig import Rig
from ._controller_fields import (
    ControllerField,
    FileContents,
    check_cells_of_fields,
    field_arguments,
    field_lines,
)

# The law of a controller in C: its code, its numbers, and the fields of its state.

LAWS = Path(__file__).with_name("laws")

LawTable: TypeAlias = tuple[np.ndarray, str]
"""Values of one or two dimensions, and a comment with their meaning and unit."""


class Law(NamedTuple):
    """The law of a controller in C, which `export_c` completes to the controller.

    All names in the code begin with `model_` or `MODEL_`; `export_c` puts the name of the files in
    place of `model`. The code has the functions

    ```c
    static void model_law_init(model_state *state, const model_real *duty,
                               const model_real *measurement);
    static void model_law(model_state *state, const model_real *reference, int samples,
                          model_real *duty);
    ```

    The first sets the state such that the duty goes on where it is. The second computes the duty of
    a sample from the references and the last measurements, `state->seen`; `samples` is the number
    of samples whose references are given, 1 without a horizon. The code may use `MODEL_CELLS`,
    `MODEL_OUTPUTS`, `MODEL_READINGS` (outputs and what is only watched), `MODEL_SAMPLE_TIME_S`,
    `model_lowest_duty[cell]` and `model_highest_duty[cell]`, `model_limited(cell, duty)`, and, with
    `integrals`, `model_integrate(state, i, change)`, which adds to `state->integral[i]` without a
    loss of small changes in `float`.

    - `code`: the code.
    - `title`: what the controller is, for the header. `parameters`: its parameters with units, a
      line for each.
    - `tables`: name -> values and comment of the arrays `model_NAME`.
    - `constants`: name -> number of the macros `MODEL_NAME`; a name that is missing is not defined.
    - `state`: name -> length of the fields of the state that the law needs.
    - `integrals`: the number of integrals; 0 for none.
    - `horizon`: the number of samples whose references the law can use; 0 for a single one.
    """

    code: str
    title: str
    tables: Mapping[str, LawTable]
    state: Mapping[str, int] = {}
    parameters: Sequence[str] = ()
    constants: Mapping[str, int | float] = {}
    integrals: int = 0
    horizon: int = 0


def bundled_law(file: str) -> str:
    """Reads the C of a law of this package, with the files that it includes."""
    text = (LAWS / file).read_text(encoding="ascii")
    return re.sub(r'#include "(.*)"\n', lambda match: bundled_law(match[1]), text)


def of_cells(name: str, value: object, cells: int) -> Float[np.ndarray, " cells"]:
    """Returns a parameter as an array with a value for each cell.

    **Raises:** `ControlError` if the number of values is neither 1 nor that of the cells.
    """
    result = np.asarray(value, float)
    if result.shape not in ((), (cells,)):
        raise ControlError(
            f"export_c: {name}: expected one value, or one for each of the {cells} cells, got "
            f"{result.tolist()}"
        )
    return np.broadcast_to(result, (cells,)).copy()


def check_designed_cells(designed: int, cells: int) -> None:
    """Refuses a controller that was designed for another number of cells.

    **Raises:** `ControlError`.
    """
    if designed != cells:
        raise ControlError(
            f"export_c: model: expected a controller of the rig's {cells} cells, got one of "
            f"{designed}"
        )


def parameter_text(name: str, value: object, unit: str) -> str:
    """The name, the value or values, and the unit of a parameter as text."""
    return f"{name}: {np.asarray(value, float).tolist()!r} {unit}".rstrip()


# The largest number of elements of an array that is written out.
MAX_WRITTEN_ARRAY = 16


def controller_text(controller: Any) -> str:
    """The text `PID(Kp=0.1 1/K, ..., sample_time=1 s)`, without fields that are None.

    Traced and large arrays are given by type and shape.
    """
    values = {field.name: getattr(controller, field.name) for field in _fields(controller)}
    units = {name: field.unit for name, field in controller.fields.items()}
    parts = [
        _named(name, value, units.get(name, ""))
        for name, value in values.items()
        if value is not None
    ]
    return f"{type(controller).__name__}({', '.join(parts)})"


def _fields(controller: Any) -> list[Any]:
    fields = dataclasses.fields(controller)
    return [field for field in fields if field.repr and hasattr(controller, field.name)]


def _named(name: str, value: Any, unit: str) -> str:
    unit = "s" if name.endswith("_s") else unit
    return f"{name.removesuffix('_s')}={_value(value)} {unit}".rstrip()


def _value(value: Any) -> str:
    if isinstance(value, Tracer) or np.size(value) > MAX_WRITTEN_ARRAY:
        return eqx.tree_pformat(value)
    if isinstance(value, float | np.ndarray | jax.Array):
        return _numbers(np.asarray(value).tolist())
    return eqx.tree_pformat(value, width=10**6)


def _numbers(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_numbers, value))}]"
    return short_number(value) if isinstance(value, float) else str(value)


# A parameter: a number or an array.
Numbers: TypeAlias = npt.ArrayLike | float | int

# The lowest and the highest duty: each a number, or one for each cell and heater.
DutyLimits: TypeAlias = tuple[float | tuple[float, ...], float | tuple[float, ...]]

Controller = TypeVar("Controller", bound="AbstractController")


class TemperatureLimit(NamedTuple):
    """The limits of the temperature of a channel, degC, and the excess that a controller accepts,
    K. Where limits exclude each other, the one with the smallest accepted excess has priority."""

    lowest: float
    highest: float
    accepted_excess: float


class AbstractController(eqx.Module):
    """A controller computes the duty of the cells from references and measurements, sample by
    sample.

    A controller is a PyTree. Its parameters can be differentiated, and parameters with a leading
    axis describe many controllers. Its state is a separate PyTree, which `init` creates and `step`
    takes and returns.

    References are temperatures of the controller's outputs. Each output is a weighted sum of
    channels of the rig, see `output_weights`. The measurement holds the outputs and, after them,
    what a controller only watches, see `reading_weights`, and at its end the room for one that
    reads it, see `reads_room`.

    A class with a name (`kind`) can have a file: `register_controller` makes `read_controller`
    know it.
    """

    kind: ClassVar[str] = ""
    """The name of the class in controller files; empty for a class without a file."""

    fields: ClassVar[Mapping[str, ControllerField]] = {}
    """The fields of its files beside those of all controllers. A field is the argument of the
    constructor of the same name, or with `_s` at its end for one in seconds."""

    sample_time_s: eqx.AbstractVar[float]
    """The time between two samples, s."""

    # DutyLimits; a class of a user's may have the narrower type of two numbers.
    limits: eqx.AbstractVar[Any]
    """The lowest and the highest duty that the controller commands, -1 to 1. A reference that no
    duty between them can hold is refused before a loop runs, simulated or on a rig."""

    @property
    @abstractmethod
    def is_linear(self) -> bool:
        """Whether `step` is linear about a steady state within the limits. `control` refuses a
        linear controller whose loop with the twin is not stable; of others, such as a relay, it
        cannot tell."""

    @property
    def averaged(self) -> "AbstractController":
        """The controller whose duty this one commands in the mean over time, by which a loop is
        checked; itself unless it switches between other duties."""
        return self

    @property
    def preview_samples(self) -> int:
        """The number of samples, from the present one on, whose references `step` takes:
        `(preview_samples, outputs)`. With 0 it takes only those of the present sample."""
        return 0

    @property
    def needs_one_thread(self) -> bool:
        """Whether many simulated loops are computed in one thread."""
        return False

    @property
    def reads_room(self) -> bool:
        """Whether the measurement ends with the temperature of the room, degC, NaN where nothing
        measures it. With the default of False it does not."""
        return False

    def channel_limits(self) -> Mapping[str, TemperatureLimit]:
        """Returns the channels whose temperatures the controller keeps within limits. By default
        there are none."""
        return {}

    @classmethod
    def check_parameters(cls, **values: Any) -> None:
        """Refuses values of parameters with which the controller has no meaning, in its constructor
        and in draws. By default a controller accepts all values.

        **Arguments:**

        - `values`: parameter -> value, of some or all parameters. Values that JAX traces are not
          checked.

        **Raises:** `ControlError` that names the parameter.
        """

    @classmethod
    def fits_outputs(cls, outputs: int, cells: int) -> bool:
        """Whether a controller of this class can have this number of outputs on a rig with this
        number of cells. By default it can."""
        return True

    @classmethod
    def from_file(cls, contents: FileContents) -> "AbstractController":
        """Makes a controller from the contents of its file. By default all fields are numbers with
        units.

        **Arguments:**

        - `contents`: the fields of the file, of which the names are checked.

        **Raises:** `ControlError` that names the file and the field.
        """
        arguments = field_arguments(cls, cls.fields, contents)
        cells = len(contents.rig.driven)
        try:
            controller = cls(**contents.common, **arguments)
            outputs = len(controller.output_weights(contents.channels))
        except ControlError as error:
            contents.refuse("", str(error))
        if not cls.fits_outputs(outputs, cells):
            contents.refuse(
                "measured", f"expected an output for each of the {cells} cells, got {outputs}"
            )
        check_cells_of_fields(cls, cls.fields, arguments, contents)
        return controller

    def file_lines(self) -> list[str]:
        """Returns the lines of the controller's file, without those of all controllers."""
        return field_lines(self, self.fields)

    def for_rig(self, rig: Rig) -> "AbstractController":
        """Returns the controller as it commands a rig, in a loop, in its file and in C. By default
        it is the same for all rigs."""
        return self

    def design_weights(self) -> Mapping[str, Float[np.ndarray, "..."]]:
        """Returns the weights of the controller's design, such as accepted deviations, by the names
        with which `redesigned` takes them; all are above 0. By default there are none."""
        return {}

    def redesigned(self, weights: Mapping[str, Numbers]) -> "AbstractController":
        """Returns the controller that the same design gives with other weights.

        **Raises:** `ControlError` if there is no such design.
        """
        raise ControlError(
            f"redesigned: expected a designed controller, got a {type(self).__name__}"
        )

    def law(self, cells: int) -> Law:
        """Returns the controller's law in C for a rig with `cells` cells. By default there is none.

        **Raises:** `ControlError` if there is no law, or the controller does not fit the cells.
        """
        raise ControlError(
            f"export_c: model: expected a controller whose class has a law in C, got a "
            f"{type(self).__name__}; give the class a method law, see jaxtwin.control.Law"
        )

    def __repr__(self) -> str:
        return controller_text(self)

    @abstractmethod
    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Returns the weight of each channel of a rig in each output.

        **Raises:** `ControlError` if the rig does not have a channel that the controller measures.
        """

    def output_names(self, channels: Sequence[str]) -> tuple[str, ...]:
        """Returns the name of each output: those of the channels of the rig whose mean it is."""
        names = []
        for row in np.asarray(self.output_weights(channels)):
            counted = [channel for channel, weight in zip(channels, row, strict=True) if weight]
            everything = len(counted) == len(channels) > 1
            names.append("mean of all" if everything else " ".join(counted))
        return tuple(names)

    def reading_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "readings channels"]:
        """Returns the weight of each channel of a rig in each number of the measurement: the
        outputs, and then what the controller watches without a reference. By default it watches
        nothing.

        **Raises:** `ControlError` as `output_weights`.
        """
        return self.output_weights(channels)

    @abstractmethod
    def init(
        self, duty: Float[ArrayLike, " cells"], measurement: Float[ArrayLike, " readings"]
    ) -> PyTree:
        """Returns the state with which the controller takes over without a jump of the duty.

        **Arguments:**

        - `duty`: the present duty of the cells, -1 to 1.
        - `measurement`: the present readings, degC: the outputs, and what it watches.
        """

    @abstractmethod
    def step(
        self,
        state: PyTree,
        reference: Float[ArrayLike, "*preview outputs"],
        measurement: Float[ArrayLike, " readings"],
    ) -> tuple[Float[Array, " cells"], PyTree]:
        """Computes the duty of the cells until the next sample, -1 to 1, and the next state.

        **Arguments:**

        - `state`: the state that the previous `step`, or `init`, returned.
        - `reference`: the references of the outputs at this sample, degC; with `preview_samples`,
          those of this and of the next samples.
        - `measurement`: the readings at this sample, degC: the outputs, and what it watches.
        """


def redesign_weights(
    controller: str, designed: Mapping[str, Any], given: Mapping[str, Numbers]
) -> dict[str, Any]:
    """The weights of another design: those of a design, of which some are replaced.

    **Arguments:**

    - `controller`: the name of the class, for messages.
    - `designed`: the weights of its own design.

    **Raises:** `ControlError` if it has none, such as a controller of a file, or for another name.
    """
    if not designed:
        raise ControlError(
            f"redesigned: expected an {controller} with the weights of its design, got one of a "
            "file, with an observer, or with points that are to be even"
        )
    for name in given:
        if name not in designed:
            raise ControlError(f"redesigned: {unknown_name('weight', name, designed)}")
    return {**designed, **given}


def accepts_design_arguments(design: str) -> Callable[[type[Controller]], type[Controller]]:
    """Lets the constructor of a class take the arguments of its design, as it did up to version
    0.2, with a warning. It is removed in version 0.4.

    **Arguments:**

    - `design`: the name of the function of the design, in the module of the class.
    """

    def decorate(controller: type[Controller]) -> type[Controller]:
        store = controller.__init__

        @functools.wraps(store)
        def init(self: Controller, *given: Any, **named: Any) -> None:
            if given or "kalman" not in named:
                message = f"{controller.__name__}(...) is now {design}(...)"
                warnings.warn(message, DeprecationWarning, stacklevel=_caller_level())
                designed = getattr(sys.modules[controller.__module__], design)(*given, **named)
                fields = dataclasses.fields(designed)
                named = {field.name: getattr(designed, field.name) for field in fields}
            store(self, **named)

        controller.__init__ = init
        return controller

    return decorate


def _caller_level() -> int:
    """The `stacklevel` of a warning in a constructor, which equinox calls, for its caller."""
    frame, level = sys._getframe(2), 2
    while frame is not None and "equinox" in frame.f_code.co_filename:
        frame, level = frame.f_back, level + 1
    return level


class AbstractChannelGroupController(AbstractController):
    """A controller whose outputs are each the mean over a group of channels."""

    measured: eqx.AbstractVar[tuple[tuple[str, ...], ...] | None]
    """The channels of each output; None for a single output, the mean of all channels."""

    def output_weights(self, channels: Sequence[str]) -> Float[np.ndarray, "outputs channels"]:
        """Returns equal weights for the channels of each output."""
        return means_of(self.measured, channels)


def parameter_names(controller: AbstractController) -> tuple[str, ...]:
    """Returns the names of the fields that are numbers, which can be drawn and tuned."""
    return tuple(
        field.name
        for field in dataclasses.fields(controller)
        if not field.metadata.get("static", False)
        and isinstance(getattr(controller, field.name), np.ndarray | jax.Array | float)
    )


def with_values(controller: Controller, values: Mapping[str, Any]) -> Controller:
    """Returns the controller with other values of some parameters."""
    for name, value in values.items():
        controller = eqx.tree_at(lambda c, name=name: getattr(c, name), controller, value)
    return controller


def is_same(one: AbstractController, other: AbstractController) -> bool:
    """Whether two controllers are equal in all numbers and settings."""
    return one is other or bool(eqx.tree_equal(one, other))


def is_same_kind(one: AbstractController | None, other: AbstractController | None) -> bool:
    """Whether two controllers differ in numbers alone, not in limits, sample time or outputs."""
    (a, tree), (b, other_tree) = (jax.tree.flatten(each) for each in (one, other))
    return tree == other_tree and [np.shape(leaf) for leaf in a] == [np.shape(leaf) for leaf in b]


def checked_sample_time(where: str, sample_time_s: object) -> float:
    """Returns a sample time as a float.

    **Raises:** `ControlError` if it is not a number above 0.
    """
    return finite_number(f"{where}: sample_time_s", sample_time_s, ControlError, above=0, unit="s")


def means_of(
    measured: Sequence[Sequence[str]] | None, channels: Sequence[str]
) -> Float[np.ndarray, "outputs channels"]:
    """Returns the weights of outputs that are means of channels; None for the mean of all channels.

    **Raises:** `ControlError` if the rig does not have one of the channels.
    """
    if measured is None:
        return np.full((1, len(channels)), 1 / len(channels))
    weights = np.zeros((len(measured), len(channels)))
    for output, names in enumerate(measured):
        for name in names:
            if name not in channels:
                raise ControlError(f"measured: {unknown_name('channel', name, channels)}")
            weights[output, list(channels).index(name)] += 1 / len(names)
    return weights


def checked_measured(where: str, measured: Any) -> tuple[tuple[str, ...], ...] | None:
    """Returns the outputs as tuples of channels. A single name is an output of one channel.

    **Raises:** `ControlError` if there is no output, an output without a channel, or a set, which
    has no order of its own.
    """
    if measured is None:
        return None
    parts = _in_order(measured)
    groups = tuple((part,) if isinstance(part, str) else _in_order(part) for part in parts)
    names = [name for group in groups for name in group]
    if not groups or not all(groups) or not all(isinstance(name, str) for name in names):
        raise ControlError(
            f"{where}: measured: expected channels, or groups of channels, such as "
            f"[['T11', 'T12'], ['T15', 'T16']], got {measured!r}"
        )
    return groups


def check_non_negative(where: str, **values: Any) -> None:
    """Refuses parameters that are not finite numbers of at least 0. Parameters that JAX traces have
    no values yet and are not checked.

    **Raises:** `ControlError` that names the first invalid parameter.
    """
    for name, value in values.items():
        if isinstance(value, Tracer) or not _is_array(value):
            continue  # tree transformations put other objects into the leaves of a module
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or not np.all(np.isfinite(array) & (array >= 0)):
            raise ControlError(
                f"{where}: {name}: expected finite numbers of at least 0, got {value!r}"
            )


def checked_deviations(
    where: str, name: str, value: Numbers, size: int
) -> Float[np.ndarray, " size"]:
    """Returns the accepted deviation, or the noise, of each output or cell as an array.

    **Raises:** `ControlError` if the value is neither one number nor one for each, or is not finite
    and above 0.
    """
    try:
        if is_pint(value) or np.asarray(value).dtype.kind not in "iuf":
            raise TypeError
        numbers = np.broadcast_to(np.asarray(value, float), (size,)).copy()
        if not np.all(np.isfinite(numbers) & (numbers > 0)):
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: {name}: expected a finite number above 0, or {size} of them, got {value!r}"
        ) from None
    return numbers


def _in_order(parts: Any) -> tuple[Any, ...]:
    """Returns the parts of an ordered value; no parts of any other value."""
    if not is_ordered(parts):
        return ()
    # Names of NumPy and pandas are subclasses of text, and are converted.
    return tuple(str(part) if isinstance(part, str) else part for part in parts)


def _is_array(value: object) -> bool:
    number = int | float | complex | str | bool | np.generic
    return isinstance(value, number | np.ndarray | jax.Array | list | tuple)
