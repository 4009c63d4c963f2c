"""Reads and writes controllers as TOML files.

Each class of controllers has its `kind` and its `fields`, and reads and writes them: see
`AbstractController`. `save_controller` writes the file of an `LQI` or an `MPC`; the files of the
others, such as a `PID`, can also be written by hand:

```toml
format = 1
rig = "dual-cell"
kind = "pid"
sample_time = "1 s"
measured = [["T11", "T21"], ["T16", "T26"]]
limits = [0.0, 1.0]
Kp = "0.1 1/K"
Ki = "0.002 1/(K s)"
```
"""

import json
import logging
import os
import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar, final

from scipy.linalg import LinAlgError

from ..._kinds import add_kind
from ..._name_suggestions import did_you_mean, unknown_name
from ..._whole_file import check_ending, write_whole_file
from ...errors import ControlError
from ...rig import Rig, parse_toml, read_toml, refuse
from ._controller import AbstractChannelGroupController, AbstractController
from ._controller_fields import (
    SAMPLE_TIME,
    FileContents,
    Kind,
    Refuse,
    argument_name,
    channel_groups,
    constructor_arguments,
    numbers,
    quantity,
)
from ._decoupled_pi import DecoupledPI
from ._gain_scheduled import GainScheduled
from ._linear_controller import design_summary
from ._lqi import LQI
from ._mpc import MPC
from ._pid import PID
from ._relay import Relay
from ._time_proportional import TimeProportional

DURATION = Kind("a time", "s", "900 s")


@final
class ControllerDesign(NamedTuple):
    """For what a controller was designed, which its file may keep: with these arguments `tune` and
    `retune` find its parameters again on another twin.

    - `references`: as in `simulate_closed_loop`, as text: `"0:30,300:45,600:30"`.
    - `duration`: s.
    - `objective`: measure -> weight, as in `tune`.
    """

    references: str
    duration: float
    objective: Mapping[str, float]

    def file_lines(self) -> list[str]:
        """Returns the lines of a controller's file."""
        weights = ", ".join(
            f"{name} = {float(weight)!r}" for name, weight in self.objective.items()
        )
        return [
            f"design.references = {json.dumps(self.references)}",
            f'design.duration = "{float(self.duration)!r} s"',
            f"design.objective = {{ {weights} }}",
        ]


def design_of(data: Mapping[str, Any], refuse: Refuse) -> ControllerDesign | None:
    """Reads the design of a controller's file; None if there is none.

    **Arguments:**

    - `data`: the contents of the file. `refuse`: raises the error of a field.
    """
    table = data.get("design")
    if table is None:
        return None
    if not isinstance(table, dict) or set(table) != {"references", "duration", "objective"}:
        refuse("design", f"expected a table of references, duration and objective, got {table!r}")
    references, objective = table["references"], table["objective"]
    if not isinstance(references, str) or not references:
        refuse("design.references", f"expected text such as '0:30,300:45', got {references!r}")
    duration = quantity(table["duration"], "design.duration", DURATION, refuse, is_list=False)
    if not isinstance(objective, dict) or not objective:
        refuse("design.objective", f"expected measure = weight, got {objective!r}")
    weights = {}
    for name, weight in objective.items():
        is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
        # NaN is not below infinity.
        if not is_number or not 0 <= weight < float("inf"):
            refuse(f"design.objective.{name}", f"expected a number of at least 0, got {weight!r}")
        weights[name] = float(weight)
    return ControllerDesign(references, duration, weights)


log = logging.getLogger("jaxtwin")

FORMAT = 1

_COMMON = ("format", "rig", "kind", "sample_time", "limits", "design")

# Kind of controller -> its class.
_KINDS: dict[str, type[AbstractController]] = {}

Registered = TypeVar("Registered")


def register_controller(controller: Registered) -> Registered:
    """Makes `read_controller` and `save_controller` know a class of controllers, by its `kind`.
    Returns the class, so that it can be a decorator.

    **Raises:** `ControlError` for something else, a class without a `kind`, the `kind` of another
    class, and a field that is no argument of the class.
    """
    _register(controller)
    return controller


def _register(controller: object) -> None:
    where = "register_controller"
    if not (isinstance(controller, type) and issubclass(controller, AbstractController)):
        raise ControlError(f"{where}: expected a class of controllers, got {controller!r}")
    arguments = constructor_arguments(controller)
    for name, field in controller.fields.items():
        if not field.is_own and argument_name(controller, name) not in arguments:
            raise ControlError(
                f"{where}: {controller.__name__}.fields: expected names of arguments of its "
                f"constructor, or with _s at their end, got {name!r}"
            )
    add_kind(_KINDS, controller, where, "files, such as 'pid'", ControlError)


for _controller_class in (
    PID,
    DecoupledPI,
    GainScheduled,
    LQI,
    MPC,
    Relay,
    TimeProportional,
):
    register_controller(_controller_class)


def read_controller(path: str | os.PathLike[str], rig: Rig) -> AbstractController:
    """Reads a controller for a rig.

    **Arguments:**

    - `path`: the .toml file.
    - `rig`: the rig that the file must name.

    **Returns:** a `PID`, a `DecoupledPI`, a `GainScheduled`, an `LQI`, an `MPC`, a `Relay`, a
    `TimeProportional`, or a controller of a class that `register_controller` has added.

    **Raises:** `ControlError` if the file cannot be read, is for another rig, or has a field or a
    value that is not allowed. The message names the file and the field.
    """
    return _controller(*read_toml(path, ControlError), rig)


def read_design(path: str | os.PathLike[str], rig: Rig) -> ControllerDesign | None:
    """Reads for what the controller of a file was designed; None if the file does not say it.

    **Arguments:** those of `read_controller`.

    **Raises:** the errors of `read_controller`.
    """
    data, source = read_toml(path, ControlError)
    _controller(data, source, rig)
    return design_of(data, partial(_refuse_in, source))


def controller_of_text(
    text: str, source: str, rig: Rig
) -> tuple[AbstractController, ControllerDesign | None]:
    """Reads the text of a controller's file.

    **Raises:** the errors of `read_controller`.
    """
    data = parse_toml(text.encode(), source, ControlError)
    return _controller(data, source, rig), design_of(data, partial(_refuse_in, source))


def save_controller(
    path: str | os.PathLike[str],
    controller: AbstractController,
    rig: Rig,
    *,
    design: ControllerDesign | None = None,
) -> None:
    """Writes a controller for a rig to a .toml file. If writing fails, the file is left as it was.

    The file of an `LQI` or an `MPC` states in a comment how far from instability their loop is on
    their own model; if the loop is fragile, the logger `jaxtwin` warns.

    **Arguments:**

    - `path`: the .toml file.
    - `controller`: a controller whose class has a file, as in `read_controller`.
    - `rig`: the rig that the controller is for.
    - `design`: for what it was designed, so that it can be tuned again.

    **Raises:** `ControlError` for another kind of controller, for a controller that does not fit
    the rig, for another ending than .toml, and if the file cannot be written.
    """
    if isinstance(path, AbstractController) or not isinstance(rig, Rig):
        order = (type(given).__name__ for given in (path, controller, rig))
        raise ControlError(
            "save_controller: expected save_controller(path, controller, rig), in this order, got "
            f"save_controller({', '.join(order)})"
        )
    check_ending(path, [".toml"], ControlError)
    content = controller_file(controller, rig, f"save_controller: {path}", design)
    write_whole_file(Path(path), content.encode(), ControlError)


def controller_file(
    controller: AbstractController, rig: Rig, where: str, design: ControllerDesign | None = None
) -> str:
    """Returns the text of a controller's file.

    **Arguments:**

    - `where`: the name of the file in messages.

    **Raises:** the errors of `save_controller`.
    """
    if _KINDS.get(getattr(controller, "kind", "")) is not type(controller):
        known = ", ".join(sorted(known.__name__ for known in _KINDS.values()))
        raise ControlError(
            f"save_controller: controller: expected one whose class has a file ({known}; "
            f"register_controller adds a class), got {controller!r}"
        )
    controller = controller.for_rig(rig)
    lines = [f"format = {FORMAT}"]
    if (result := design_summary(controller)) is not None:
        text, is_fragile = result
        lines.append(f"# on its own model: {text}")
        if is_fragile:
            log.warning("%s: on its own model: %s", where, text)
    lines += [
        f"rig = {json.dumps(rig.name)}",
        f"kind = {json.dumps(controller.kind)}",
        f'sample_time = "{controller.sample_time_s!r} s"',
    ]
    measured = getattr(controller, "measured", None)
    if measured is not None:
        lines.append(f"measured = {json.dumps(measured)}")
    lines.append(f"limits = {json.dumps(controller.limits)}")
    if design is not None:
        # Dotted keys, because tables of the controller may follow.
        lines += design.file_lines()
    lines += controller.file_lines()
    content = "\n".join(lines) + "\n"
    controller_of_text(content, where, rig)
    return content


def _limits(value: Any, refuse: Refuse) -> list[float | list[float]]:
    """Reads the lowest and the highest duty, each a number or a list of them."""
    if not isinstance(value, list) or not any(isinstance(bound, list) for bound in value):
        return [*numbers(value, "limits", refuse)]
    return [
        numbers(bound, "limits", refuse)
        if isinstance(bound, list)
        else numbers([bound], "limits", refuse)[0]
        for bound in value
    ]


def _controller(data: Mapping[str, Any], source: str, rig: Rig) -> AbstractController:
    """Makes a controller from the contents of a file.

    **Arguments:**

    - `source`: the name of the file in messages.
    """

    refuse_field = partial(_refuse_in, source)
    if data.get("format") != FORMAT:
        refuse_field("format", f"expected {FORMAT}, got {data.get('format')!r}")
    if data.get("rig") != rig.name:
        refuse_field(
            "rig", f"expected a controller for {rig.name!r}, got one for {data.get('rig')!r}"
        )
    return controller_of_tables(data, rig, refuse_field)


def _refuse_in(source: str, field: str, message: str) -> NoReturn:
    refuse(source, field, message, ControlError)


def controller_of_tables(
    data: Mapping[str, Any], rig: Rig, refuse_field: Refuse
) -> AbstractController:
    """Makes a controller from the tables of a file.

    **Arguments:**

    - `refuse_field`: raises the error of a field.
    """
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        hint = did_you_mean([str(kind)], _KINDS)
        refuse_field("kind", f"expected one of {', '.join(_KINDS)}, got {kind!r}{hint}")
    controller = _KINDS[kind]
    known = [*_COMMON, *controller.fields]
    if issubclass(controller, AbstractChannelGroupController) and "measured" not in known:
        known.append("measured")
    for name in data:
        if name not in known:
            refuse_field(name, unknown_name("field", name, known))
    design_of(data, refuse_field)
    required = [name for name, field in controller.fields.items() if field.is_required]
    for name in ("sample_time", *required):
        if name not in data:
            refuse_field(name, "expected this field, got none")
    common: dict[str, Any] = {
        "sample_time_s": quantity(
            data["sample_time"], "sample_time", SAMPLE_TIME, refuse_field, is_list=False
        )
    }
    if "limits" in data:
        common["limits"] = _limits(data["limits"], refuse_field)
    if "measured" in data:
        common["measured"] = channel_groups(data["measured"], refuse_field)
    try:
        # Overflows warn here; they are refused at the end as numbers that are not finite.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # includes LinAlgWarning
            contents = FileContents(data, common, rig, refuse_field)
            return controller.from_file(contents).for_rig(rig)
    except (ArithmeticError, LinAlgError, TypeError, ValueError) as error:
        refuse_field("", str(error))
