"""Writes a rig file after one of the bundled examples without a plate, with other numbers."""

import re
from collections.abc import Mapping

from ._bundled import bundled_content, bundled_rigs
from ._fields import Fields
from ._load import load_rig
from ._rig import Rig


def example_rigs() -> tuple[str, ...]:
    """The bundled rigs without a plate."""
    return tuple(name for name in bundled_rigs() if not load_rig(name).has_plate)


def example_rig_text(name: str, example: str, values: Mapping[str, float]) -> str:
    """The text of a bundled rig's file, for a rig with another name and other numbers.

    **Arguments:**

    - `name`: the name of the rig.
    - `example`: one of `example_rigs()`.
    - `values`: values of some of its parameters, in the units of its table, which `check_value`
      accepts.
    """
    content, _ = bundled_content("rigs", example)
    text = content.decode("utf-8").replace("\r\n", "\n")
    text = re.sub(r'(?m)^name = ".*"$', lambda _: f'name = "{name}"', text, count=1)
    for parameter, value in values.items():
        # Digits of the number alone; prior and description stay.
        text = re.sub(
            rf"(?m)^({parameter} = {{ value = )[^,]+", rf"\g<1>{float(value)!r}", text, count=1
        )
    return text


def check_value(rig: Rig, parameter: str, value: float, fields: Fields) -> None:
    """Refuses a parameter that the rig does not have, or a value outside its bounds."""
    fields.check_known("value", "parameter", parameter, rig.parameters)
    row = rig.parameters[parameter]
    if not row.lower <= value <= row.upper:
        fields.refuse(
            f"value.{parameter}",
            f"expected {row.lower:g} to {row.upper:g} {row.unit}, got {value:g}; wider bounds are "
            "for an editor",
        )
