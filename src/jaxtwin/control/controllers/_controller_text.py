"""A controller in words: its parameters as numbers with their units."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from ..._number_text import short_number

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
