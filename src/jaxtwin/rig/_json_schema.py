"""The format of rig files as a JSON Schema, for editors that complete and check TOML."""

from typing import Any

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a rig file.

    It describes tables, keys and types. Units, the names of parameters, nodes and modules, and
    conditions on several fields are checked only by `load_rig`.
    """
    from ._schema import RigTable  # with pydantic, which only readers of a rig should pay for

    result: dict[str, Any] = {"$schema": DIALECT, **_without_null(RigTable.model_json_schema())}
    result["title"] = "jaxtwin rig file"
    result["description"] = (
        "A thermal rig: plate or bodies, cells, heaters, driver, camera or sensors, channels and "
        "parameters."
    )
    return result


def _without_null(part: object) -> Any:
    """The schema without the value null, which TOML does not have."""
    if isinstance(part, list):
        return [_without_null(item) for item in part if item != {"type": "null"}]
    if not isinstance(part, dict):
        return part
    kept = {
        key: _without_null(item)
        for key, item in part.items()
        if not (key == "default" and item is None)
    }
    choices = kept.get("anyOf")
    if isinstance(choices, list) and len(choices) == 1:
        del kept["anyOf"]
        kept = choices[0] | kept
    return kept
