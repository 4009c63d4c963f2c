"""The parameter table of a rig file and its named sets of values."""

import math
from collections.abc import Mapping

from .._name_suggestions import unknown_name
from ._parameter import Parameter
from ._problems import refuse
from ._schema import ParameterTable, RigTable
from ._units import unit_scale


def build_parameters(table: RigTable, source: str) -> dict[str, Parameter]:
    """The parameters of a rig file, in its order.

    **Raises:** `RigError` if a name is no identifier, a unit is unknown or the bounds exclude
    the value.
    """
    return {name: _parameter(name, row, source) for name, row in table.parameters.items()}


def build_parameter_sets(
    table: RigTable, parameters: Mapping[str, Parameter], source: str
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


def _parameter(name: str, row: ParameterTable, source: str) -> Parameter:
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
