"""Builds inputs from the tables `[[inputs]]` of a rig file."""

from collections.abc import Collection, Sequence

from ._input import Input
from ._problems import refuse
from ._schema import InputTable
from ._units import unit_scale

# Names that mean something else in a recording or in a rig file.
RESERVED_NAMES = ("time", "timestamp", "date", "ambient", "by")


def build_inputs(
    tables: Sequence[InputTable], parameters: Collection[str], source: str
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


def _with_states(table: InputTable, at: str, source: str) -> Input:
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


def _number(table: InputTable, at: str, source: str) -> Input:
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
