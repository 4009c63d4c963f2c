"""Tables of a rig file as the text of one."""

import json
from collections.abc import Mapping
from typing import Any


def rig_text(tables: Mapping[str, Any], comment: str) -> str:
    """The text of a rig file, with a comment at its top."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()] + [""]
    parameters = tables["parameters"]
    for key, value in tables.items():
        if key == "parameters":
            continue
        if isinstance(value, list):
            lines += ["", f"{key} = [", *(f"    {_inline(item)}," for item in value), "]"]
        else:
            lines.append(f"{key} = {_inline(value)}")
    lines += ["", "[parameters]", *(f"{name} = {_inline(row)}" for name, row in parameters.items())]
    return "\n".join(lines) + "\n"


def _inline(value: Any) -> str:
    """A value as TOML writes it on one line: as JSON does, except tables."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    return json.dumps(value, ensure_ascii=False)
