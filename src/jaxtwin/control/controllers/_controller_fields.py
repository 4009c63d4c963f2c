"""Reads and writes values of a controller file: numbers with units, lists, matrices."""

import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, NoReturn, TypeAlias, final

import numpy as np
from jaxtyping import Float

from ...rig import Kind, Rig, parse_quantity, range_problem, unit_scale

# A function of a field and a message that raises `ControlError`.
Refuse: TypeAlias = Callable[[str, str], NoReturn]


@final
@dataclass(frozen=True)
class ControllerField:
    """A field of a controller file: a number with a unit, or a list with a number for each cell.

    **Arguments:**

    - `name`: what it is, with its article, for messages: "a gain".
    - `unit`: its SI unit, such as "1/K"; "" for a number without one.
    - `example`: an example of a value, such as "0.1 1/K".
    - `least`: `"positive"`, `"zero"` where 0 is allowed too, or `"any"` number.
    - `is_required`: whether each file has it.
    - `is_single`: whether it is one number for all cells.
    - `is_own`: whether the class reads and writes it by its own `from_file` and `file_lines`,
      because it is no number with a unit.
    """

    name: str = ""
    unit: str = ""
    example: str = ""
    least: Literal["positive", "zero", "any"] = "positive"
    is_required: bool = False
    is_single: bool = False
    is_own: bool = False

    @property
    def quantity(self) -> Kind:
        """The quantity that the field holds."""
        return Kind(self.name, self.unit, self.example, self.least)


OWN = ControllerField(is_own=True)
REQUIRED_OWN = ControllerField(is_own=True, is_required=True)

SAMPLE_TIME = Kind("a time", "s", "1 s")


class FileContents(NamedTuple):
    """The contents of a controller file.

    - `data`: field -> value as in the file; all required fields, and no unknown one.
    - `common`: the arguments `sample_time_s`, `limits` and `measured`, as far as they are given.
    - `rig`: the rig of the controller.
    - `refuse`: raises `ControlError` with the name of the file, from a field and a message.
    """

    data: Mapping[str, Any]
    common: dict[str, Any]
    rig: Rig
    refuse: Refuse

    @property
    def channels(self) -> list[str]:
        """The names of the rig's channels."""
        return [channel.name for channel in self.rig.channels]


def quantity(value: object, name: str, kind: Kind, refuse: Refuse, *, is_list: bool = True) -> Any:
    """Reads a number with its unit, or a list of such numbers, in SI units.

    **Arguments:**

    - `value`: the value in the file.
    - `name`: the name of the field, for messages.
    - `kind`: the quantity that is allowed.
    - `refuse`: raises the error.
    - `is_list`: whether a list, with an entry for each cell or output, is allowed.
    """
    if is_list and isinstance(value, list) and value:
        parts = enumerate(value)
        return np.array(
            [quantity(p, f"{name}[{n}]", kind, refuse, is_list=False) for n, p in parts]
        )
    if not isinstance(value, str):
        refuse(name, f"expected {kind}, got {value!r}")
    try:
        number = parse_quantity(value, kind)
    except ValueError as problem:
        refuse(name, f"expected {kind}, got {value!r}, {problem}")
    problem = range_problem(number, kind)
    if problem:
        refuse(name, f"expected {problem}, got {value!r}")
    return number


def numbers(value: Any, name: str, refuse: Refuse) -> list[float]:
    """Reads a list of numbers without units."""
    is_list = isinstance(value, list)
    if not is_list or any(isinstance(n, bool) or not isinstance(n, int | float) for n in value):
        refuse(name, f"expected a list of numbers, got {value!r}")
    try:
        return [float(number) for number in value]
    except OverflowError:
        refuse(name, f"expected a list of numbers, got {value!r}")


def matrix(
    value: object, name: str, kind: Kind, shape: tuple[int | None, int | None], refuse: Refuse
) -> Float[np.ndarray, "rows columns"]:
    """Reads a matrix: a list of rows, or a table of `unit` and `rows` if the numbers have a unit.

    **Arguments:**

    - `kind`: the quantity of the numbers; a matrix of the unit "" is a list of rows.
    - `shape`: the required numbers of rows and columns; None for any number.
    """
    scale, rows = 1.0, value
    if kind.unit:
        example = f'{{ unit = "{kind.unit}", rows = [[1.0, 2.0]] }}'
        if not isinstance(value, dict) or set(value) != {"unit", "rows"}:
            refuse(name, f"expected unit and rows, such as {example}, got {value!r}")
        try:
            scale, _ = unit_scale(str(value["unit"]), kind)
        except ValueError as problem:
            refuse(
                f"{name}.unit", f"expected {kind.unit} or alike, got {value['unit']!r}, {problem}"
            )
        rows = value["rows"]
    rows = rows if isinstance(rows, list) else [rows]
    lists = [numbers(row, name, refuse) for row in rows]
    lengths = sorted({len(row) for row in lists})
    array = scale * np.array(lists) if len(lengths) == 1 else np.zeros((0, 0))
    fits = all(size in (None, has) for size, has in zip(shape, array.shape, strict=True))
    if not (fits and array.size and np.isfinite(array).all()):
        expected = " x ".join("any" if size is None else str(size) for size in shape)
        refuse(
            name, f"expected {expected} finite numbers, got {len(lists)} rows of {lengths} numbers"
        )
    return array


def channel_groups(value: object, refuse: Refuse) -> list[Any]:
    """Reads the outputs of a controller: a list of channels, or of lists of channels."""

    def is_names(part: object) -> bool:
        return isinstance(part, list) and bool(part) and all(isinstance(n, str) for n in part)

    if not (
        isinstance(value, list) and value and all(isinstance(p, str) or is_names(p) for p in value)
    ):
        refuse("measured", f"expected channels, or lists of channels, got {value!r}")
    return value


def as_quantity(value: Any, kind: Kind) -> str:
    """Returns the text of a number, or of a list of numbers, with its SI unit."""
    texts = [f"{number!r} {kind.unit}".strip() for number in np.ravel(value).tolist()]
    return json.dumps(texts[0] if np.ndim(value) == 0 else texts)


def as_matrix(value: object, kind: Kind) -> str:
    """Returns the text of a matrix with one row on each line."""
    rows = ",\n    ".join(json.dumps(row) for row in np.asarray(value, float).tolist())
    text = f"[\n    {rows},\n]"
    return f'{{ unit = "{kind.unit}", rows = {text} }}' if kind.unit else text


def argument_name(controller: type, field: str) -> str:
    """Returns the argument of a field: its name, with `_s` where the argument is one in seconds."""
    known = constructor_arguments(controller)
    return f"{field}_s" if field not in known and f"{field}_s" in known else field


def constructor_arguments(controller: type) -> frozenset[str]:
    """Returns the names of the arguments of a class."""
    return frozenset(inspect.signature(controller.__init__).parameters) - {"self"}


def field_arguments(
    controller: type, fields: Mapping[str, ControllerField], contents: FileContents
) -> dict[str, Any]:
    """Reads the numbers with units of a file, as arguments of the controller's class.

    **Raises:** `ControlError` for a value that is not allowed, or a list that is not one for each
    cell.
    """
    result = {}
    for name, field in fields.items():
        if field.is_own or name not in contents.data:
            continue
        value = quantity(
            contents.data[name],
            name,
            field.quantity,
            contents.refuse,
            is_list=not field.is_single,
        )
        result[argument_name(controller, name)] = value
    return result


def check_cells_of_fields(
    controller: type,
    fields: Mapping[str, ControllerField],
    arguments: Mapping[str, Any],
    contents: FileContents,
) -> None:
    """Refuses lists that have not a value for each cell.

    **Raises:** `ControlError`.
    """
    cells = len(contents.rig.driven)
    for name in fields:
        value = arguments.get(argument_name(controller, name))
        if value is not None and np.ndim(value) and np.shape(value) != (cells,):
            contents.refuse(
                name, f"expected one value, or one for each of the {cells} cells, got {len(value)}"
            )


def field_lines(controller: Any, fields: Mapping[str, ControllerField]) -> list[str]:
    """Returns the lines of the numbers with units, without those that are None."""
    values = {
        name: getattr(controller, argument_name(type(controller), name))
        for name, field in fields.items()
        if not field.is_own
    }
    return [
        f"{name} = {as_quantity(value, fields[name].quantity)}"
        for name, value in values.items()
        if value is not None
    ]
