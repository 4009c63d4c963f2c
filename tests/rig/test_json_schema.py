"""The JSON Schema of rig files says yes and no where the reader of rig files does."""

import copy
import json
import tomllib
from collections.abc import Iterable, Iterator
from typing import Any

import jsonschema
import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.cli import run
from jaxtwin.data import data_folder
from jaxtwin.rig import bundled_rigs, json_schema
from jaxtwin.rig._schema import RigTable

VALIDATOR = jsonschema.Draft202012Validator(json_schema())


def tables(name: str) -> dict[str, Any]:
    return tomllib.loads((data_folder() / "rigs" / f"{name}.toml").read_text("utf-8"))


def test_it_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(json_schema())


def test_it_offers_no_null_which_toml_does_not_have():
    """Nor a choice of a single type, which would be one of something and null."""

    def parts(schema: object) -> Iterator[object]:
        yield schema
        inner = schema.values() if isinstance(schema, dict) else schema
        if isinstance(inner, Iterable) and not isinstance(inner, str):
            for part in inner:
                yield from parts(part)

    found = list(parts(json_schema()))
    assert None not in found
    assert "null" not in found
    choices = [part["anyOf"] for part in found if isinstance(part, dict) and "anyOf" in part]
    assert all(len(several) > 1 for several in choices)


@pytest.mark.parametrize("name", bundled_rigs())
def test_every_bundled_rig_passes(name: str):
    VALIDATOR.validate(tables(name))


def broken(path: str, value: Any) -> dict[str, Any]:
    """The single cell with another value at a place, or without any."""
    found: Any = copy.deepcopy(tables("single-cell"))
    at: Any = found
    *way, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    for part in way:
        at = at[part]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return found


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("format", 2),
        ("plate.thickness", None),
        ("plate.thickness", 1.0),
        ("plate.thicknes", "1 mm"),
        ("plate.columns", []),
        ("cells", {}),
        ("cells.0.contacts", {}),
        ("driver.polarity", 0),
        ("driver.averaging", "mean"),
        ("driver.counts", 0),
        ("driver.polarity", True),
        ("format", True),
        ("camera.resolution", [80]),
        ("channels.0.nodes", "V11"),
        ("parameters.R_E.bounds", [1.0]),
        ("parameters.R_E.scope", "day"),
        ("parameters.R_E.prior.spread", 0),
        ("parameter_sets", {"published": {"R_E": "2 ohm"}}),
    ],
)
def test_a_broken_file_fails(path: str, value: Any):
    assert not VALIDATOR.is_valid(broken(path, value))
    assert not is_read(broken(path, value))


def is_read(data: dict[str, Any]) -> bool:
    try:
        RigTable.model_validate(data)
    except pydantic.ValidationError:
        return False
    return True


PLACES = [
    "format", "name", "title", "plate.rows", "plate.material", "plate.film_coefficient",
    "plate.emissivity", "cells.0.module", "cells.0.contacts", "driver.lag", "driver.counts",
    "driver.off_phase", "camera.view.x", "camera.noise", "channels.0.x", "channels.0.nodes",
    "limits.rate", "ambient.drift", "parameters.R_E.value", "parameters.R_E.free",
    "parameters.R_E.prior.value",
]  # fmt: skip

VALUES = st.one_of(
    st.integers(-2, 300),
    st.floats(-1e3, 1e3),
    st.booleans(),
    st.sampled_from(["1 mm", "R_E", "open", "brake"]),
    st.lists(st.sampled_from(["1 cm", "2 cm"]), max_size=3),
    st.lists(st.floats(0, 100), max_size=3),
    st.dictionaries(st.sampled_from(["V11", "x"]), st.sampled_from(["R_E", "1 K/W"]), max_size=2),
)


@given(path=st.sampled_from(PLACES), value=VALUES)
def test_what_the_reader_takes_passes(path: str, value: Any):
    """The converse does not hold: the reader also looks at what a schema cannot say, such as the
    length of a range given as text."""
    data = broken(path, value)
    if is_read(data):
        VALIDATOR.validate(data)


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]):
    assert run(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema()
