"""The parameter table of a rig file with its named sets of values, and its inputs `[[inputs]]`."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from .._name_suggestions import unknown_name
from ._toml import refuse
from ._units import unit_scale
from ._value import Input, Parameter

if TYPE_CHECKING:
    from ._schema import InputTable, ParameterTable, RigTable


def build_parameters(table: "RigTable", source: str) -> dict[str, Parameter]:
    """The parameters of a rig file, in its order.

    **Raises:** `RigError` if a name is no identifier, a unit is unknown or the bounds exclude
    the value.
    """
    return {name: _parameter(name, row, source) for name, row in table.parameters.items()}


def build_parameter_sets(
    table: "RigTable", parameters: Mapping[str, Parameter], source: str
) -> dict[str, dict[str, float]]:
    """The named sets of values of a rig file.

    **Raises:** `RigError` if a name is unknown or a value is out of its parameter's bounds.
    """
    for set_name, values in table.parameter_sets.items():
        for name, value in values.items():
            field = f"parameter_sets.{set_name}.{name}"
            if name not in parameters:
                refuse(source, field, unknown_name("parameter", name, parameters))
            lower, upper = parameters[name].lower, parameters[name].upper
            if not lower <= value <= upper:
                refuse(
                    source,
                    field,
                    f"expected a value within its bounds, {lower:g} to {upper:g}, got {value:.10g}",
                )
    return {name: dict(values) for name, values in table.parameter_sets.items()}


def _parameter(name: str, row: "ParameterTable", source: str) -> Parameter:
    field = f"parameters.{name}"
    if not (name.isidentifier() and name.isascii()):
        refuse(
            source,
            field,
            "expected a name of letters, digits and _ that does not start with a digit",
        )
    try:
        scale, offset = unit_scale(row.unit)
    except ValueError as problem:
        refuse(
            source, f"{field}.unit", f'expected a unit such as "K/W", got {row.unit!r}, {problem}'
        )
    lower, upper = row.bounds or (-math.inf, math.inf)
    if not lower < upper:
        refuse(
            source,
            f"{field}.bounds",
            f"expected [lower, upper] with lower below upper, got [{lower:.10g}, {upper:.10g}]",
        )
    if not lower <= row.value <= upper:
        refuse(
            source,
            f"{field}.value",
            f"expected a value within its bounds, {lower:g} to {upper:.10g}, got {row.value:.10g}",
        )
    prior_spread = prior_value = group_spread = None
    if row.prior is not None:
        prior_spread, group_spread = row.prior.spread, row.prior.between_groups
        prior_value = row.value if row.prior.value is None else row.prior.value
        if not lower <= prior_value <= upper:
            refuse(
                source,
                f"{field}.prior.value",
                f"expected a value within its bounds, {lower:g} to {upper:g}, got {prior_value:g}",
            )
    if (row.scope == "group") != (group_spread is not None):
        result = "none" if group_spread is None else f"{group_spread:g}"
        refuse(
            source,
            f"{field}.prior.between_groups",
            'expected a spread between groups with scope = "group", and none with any other, got '
            f"{result} with scope = {row.scope!r}",
        )
    return Parameter(
        name=name,
        value=row.value,
        lower=lower,
        upper=upper,
        unit=row.unit,
        free=row.free,
        scope=row.scope,
        description=row.description,
        scale=scale,
        offset=offset,
        prior_spread=prior_spread,
        prior_value=prior_value,
        group_spread=group_spread,
    )


# Names that mean something else in a recording or in a rig file.
RESERVED_NAMES = ("time", "timestamp", "date", "ambient", "by")


def build_inputs(
    tables: "Sequence[InputTable]", parameters: Collection[str], source: str
) -> tuple[Input, ...]:
    """The inputs of a file.

    **Raises:** `RigError` if a name is no identifier or occurs twice, a unit is unknown, a state
    occurs twice, or the value is missing or none of the states.
    """
    names = [table.name for table in tables]
    built = []
    for table in tables:
        at = f"inputs[{table.name}]"
        if not table.name.isidentifier() or table.name in (*parameters, *RESERVED_NAMES):
            refuse(
                source,
                f"{at}.name",
                "expected letters, digits and _, and neither the name of a parameter nor one of "
                f"{', '.join(RESERVED_NAMES)}, got {table.name!r}",
            )
        if names.count(table.name) > 1:
            refuse(source, f"{at}.name", f"expected each name once, got {table.name!r} twice")
        built.append(
            _with_states(table, at, source) if table.states else _number(table, at, source)
        )
    return tuple(built)


def _with_states(table: "InputTable", at: str, source: str) -> Input:
    states = tuple(table.states or ())
    for state in states:
        if not state.isidentifier() or states.count(state) > 1 or state == "by":
            refuse(
                source,
                f"{at}.states",
                f"expected different names of letters, digits and _, got {', '.join(states)}",
            )
    if len(states) == 1:
        refuse(source, f"{at}.states", f"expected at least two states, got {states[0]!r} alone")
    if table.unit is not None:
        refuse(source, f"{at}.unit", "expected none beside states; remove one of them")
    value = states[0] if table.value is None else table.value
    if value not in states:
        refuse(source, f"{at}.value", f"expected one of {', '.join(states)}, got {value!r}")
    return Input(
        table.name, float(states.index(str(value))), states=states, description=table.description
    )


def _number(table: "InputTable", at: str, source: str) -> Input:
    if isinstance(table.value, str) or table.value is None:
        result = "none" if table.value is None else repr(table.value)
        refuse(
            source,
            f"{at}.value",
            "expected a number, which applies where none is stated, or states such as "
            f'["closed", "open"] beside it, got {result}',
        )
    unit = table.unit or ""
    try:
        scale, offset = unit_scale(unit)
    except ValueError as problem:
        refuse(source, f"{at}.unit", f"expected a unit, got {unit!r}, {problem}")
    return Input(
        table.name,
        float(table.value),
        unit=unit,
        description=table.description,
        scale=scale,
        offset=offset,
    )
