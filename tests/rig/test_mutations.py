"""Whatever is done to a rig file: it loads, or there is one `RigError`."""

import copy
import datetime
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hand_rig import text_of_many_parts
from heated_box import TEXT
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin.data import data_folder
from jaxtwin.errors import RigError
from jaxtwin.rig import Rig, load_rig, rig_from_tables

TEXTS = {
    name: (data_folder() / "rigs" / f"{name}.toml").read_bytes()
    for name in ("paper-2024", "dual-cell")
}
TEXTS["many parts"] = text_of_many_parts("on-off").encode()
TEXTS["without a plate"] = TEXT.encode()
RIGS = {name: tomllib.loads(text.decode()) for name, text in TEXTS.items()}

quantities = st.builds(
    lambda number, unit: f"{number} {unit}",
    st.floats() | st.integers(-10, 10),
    st.sampled_from(
        ["m", "cm", "kg", "K", "degC", "degF", "ohm", "K/W", "J/K", "W/(m^2 K)", "", "1/K", "dB"]
    ),
)
names = st.sampled_from(
    ["R_E", "R_ph", "T_amb", "C_esp", "V11", "V38", "ambient", "P1", "T11", "pipe"]
)
scalars = (
    st.none().map(lambda _: datetime.date(2024, 4, 1))
    | st.booleans()
    | st.integers()
    | st.integers(10**300, 10**320)
    | st.floats()
    | st.text(max_size=8)
    | quantities
    | names
)
anything = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(max_size=4) | names, inner, max_size=3)
    ),
    max_leaves=5,
)


def places(data: Any, path: tuple = ()) -> list[tuple]:
    """The paths of all values in a tree of tables and lists."""
    inner = data.items() if isinstance(data, dict) else enumerate(data)
    found = []
    for key, value in inner:
        found.append((*path, key))
        if isinstance(value, dict | list):
            found += places(value, (*path, key))
    return found


PLACES = {name: places(data) for name, data in RIGS.items()}


def check_loads_or_refuses(load: Callable[[], Rig], source: str) -> None:
    refusal = None
    try:
        rig = load()
    except RigError as error:
        refusal = str(error)
    else:
        assert hash(rig) == hash(copy.deepcopy(rig))
        assert rig.name in str(rig)
    assert refusal is None or (refusal.startswith(f"{source}: ") and refusal.isprintable())


@pytest.mark.slow
@settings(max_examples=200)
@given(st.data())
def test_a_mutated_rig_loads_or_is_refused(data):
    """One to three values are replaced, removed, renamed, doubled or moved."""
    name = data.draw(st.sampled_from(sorted(RIGS)))
    rig = copy.deepcopy(RIGS[name])
    for _ in range(data.draw(st.integers(1, 3))):
        *path, key = data.draw(st.sampled_from(PLACES[name]))
        parent: Any = rig
        try:
            for step in path:
                parent = parent[step]
            value = parent[key]
        except (KeyError, IndexError, TypeError):
            continue  # an earlier mutation took this place away
        if not isinstance(parent, dict | list):
            continue
        kind = data.draw(st.sampled_from(["replace", "remove", "rename", "double", "copy"]))
        if kind == "replace":
            parent[key] = data.draw(anything)
        elif kind == "remove":
            del parent[key]
        elif kind == "rename" and isinstance(parent, dict):
            parent[data.draw(st.text(max_size=4) | names)] = parent.pop(key)
        elif kind == "double" and isinstance(parent, list):
            parent.append(copy.deepcopy(value))
        elif kind == "copy":
            other = data.draw(st.sampled_from(list(parent) if isinstance(parent, dict) else [key]))
            parent[other] = copy.deepcopy(value)
    check_loads_or_refuses(lambda: rig_from_tables(rig, "mutated.toml"), "mutated.toml")


@settings(max_examples=200)
@given(st.dictionaries(st.sampled_from([*RIGS["many parts"], "camera", "limits", "x"]), anything))
def test_tables_with_anything_in_them_load_or_are_refused(data):
    check_loads_or_refuses(lambda: rig_from_tables(data, "mutated.toml"), "mutated.toml")


@settings(max_examples=100)
@given(
    st.sampled_from(sorted(TEXTS)), st.integers(0, 9999), st.binary(max_size=3), st.integers(0, 9)
)
def test_a_damaged_file_loads_or_is_refused(tmp_path_factory, name, place, patch, removed):
    """Some bytes are replaced by others, or the rest of the file is missing."""
    text = TEXTS[name]
    place %= len(text)
    rest = text[place + removed :] if removed < 9 else b""
    path = tmp_path_factory.mktemp("rig") / "damaged.toml"
    path.write_bytes(text[:place] + patch + rest)
    check_loads_or_refuses(lambda: load_rig(path), str(path))


def test_a_file_that_cannot_be_read_is_refused_with_the_systems_reason(tmp_path: Path):
    with pytest.raises(RigError, match="which cannot be read: Is a directory"):
        load_rig(tmp_path)
