"""Tables of a rig file as the text of one."""

from collections.abc import Mapping
from typing import Any

from .._toml_text import toml_inline, toml_key


def rig_text(tables: Mapping[str, Any], comment: str) -> str:
    """The text of a rig file, with a comment at its top."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()] + [""]
    rounded = _rounded(tables)
    for key, value in rounded.items():
        if key == "parameters":
            continue
        if isinstance(value, list):
            lines += ["", f"{key} = [", *(f"    {toml_inline(item)}," for item in value), "]"]
        else:
            lines.append(f"{key} = {toml_inline(value)}")
    lines += [
        "",
        "[parameters]",
        *(f"{toml_key(name)} = {toml_inline(row)}" for name, row in rounded["parameters"].items()),
    ]
    return "\n".join(lines) + "\n"


def _rounded(value: Any) -> Any:
    """A value with numbers of six digits, for people to read."""
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value
