"""Values as TOML writes them on one line."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np


def toml_inline(value: Any) -> str:
    """A table, list, text, number or truth value on one line; entries that are None are left
    out."""
    if isinstance(value, Mapping):
        kept = {key: entry for key, entry in value.items() if entry is not None}
        return f"{{ {', '.join(f'{toml_key(k)} = {toml_inline(v)}' for k, v in kept.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_inline, value))}]"
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    # TOML writes numbers that are not finite as Python does: inf, nan.
    return repr(float(value)) if isinstance(value, float) else repr(int(value))


def toml_key(name: str) -> str:
    """A key, in quotes where it needs them."""
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else toml_string(name)


def toml_string(text: str) -> str:
    """A text in quotes."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
