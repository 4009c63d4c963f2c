"""Validates the tables of a file by a pydantic model. The first mistake is reported in one line."""

import reprlib
from typing import Any, TypeVar

import pydantic

from ._problems import label, refuse

Model = TypeVar("Model", bound=pydantic.BaseModel)


def validate(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """Checks keys and types of a whole file.

    **Arguments:**

    - `model`: the model that the file must match.
    - `data`: the file's tables, as `tomllib` reads them.
    - `source`: the file, for messages.

    **Raises:** `RigError` for the first mistake.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        refuse(source, _path(data, first["loc"]), _message(first))


def _path(data: Any, location: tuple[int | str, ...]) -> str:
    path = ""
    for key in location:
        try:
            data = data[key]
        except (KeyError, TypeError):  # the key is missing, or its parent is not a table
            data = None
        path += f"[{label(data, key)}]" if isinstance(key, int) else f".{key}"
    return path.removeprefix(".")


def _message(error: Any) -> str:
    if error["type"] == "missing":
        return "missing, every file needs it here"
    if error["type"] == "value_error":
        return str(error["ctx"]["error"])
    if error["type"] in ("too_short", "too_long"):
        limits = error["ctx"]
        bound = "at least" if error["type"] == "too_short" else "at most"
        count = limits.get("min_length", limits.get("max_length"))
        return f"expected {bound} {count} entries, got {limits['actual_length']}"
    expected = error["msg"].removeprefix("Input should be ")
    return f"expected {expected}, got {reprlib.repr(error['input'])}"
