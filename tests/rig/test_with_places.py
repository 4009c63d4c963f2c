"""Rig files whose cells and heaters get other places: the rest of the text stays."""

import re
import tomllib
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from placed_rig import AT, MOVING, placed_text

from jaxtwin.errors import RigError
from jaxtwin.rig import Rig
from jaxtwin.rig._build import parse_rig
from jaxtwin.rig._variants import _tables, with_places

HEATER = """
# A mat that was glued on.
[[heaters]]   # the only one
power = "4 W"
capacitance = "5 J/K"
at = [
    "12 cm",
    "4 cm",
]
size = "2 cm"
contact_resistance = "1 K/W"
name = 'mat'

[[links]]
between = ["mat-ambient"]
resistance = "20 K/W"
"""

PLACES = st.tuples(st.floats(0.02, 0.14), st.floats(0.02, 0.06))
COMMENTS = st.lists(
    st.text("abc [[cells]] name = at", max_size=20).map(lambda text: f"# {text}\n") | st.just("\n"),
    max_size=6,
)


def rig_of(text: str) -> Rig:
    return parse_rig(text.encode(), "placed.toml")


def place_of(rig: Rig, name: str) -> list[float]:
    placement = next(one for one in rig.placements if one.name == name)
    assert placement.is_fixed
    return [float(placement.x.evaluate({})), float(placement.y.evaluate({}))]


@pytest.mark.slow
@given(cell=PLACES, mat=PLACES, comments=COMMENTS)
def test_places_are_those_asked_for_and_the_rest_of_the_file_is_as_it_was(
    cell: tuple[float, float], mat: tuple[float, float], comments: Sequence[str]
):
    """Whatever comments stand between the tables."""
    lines = placed_text(parts=HEATER).splitlines(keepends=True)
    for number, comment in enumerate(comments):
        starts = [at for at, line in enumerate(lines) if line.startswith("[[")]
        lines.insert(starts[number % len(starts)], comment)
    before = rig_of("".join(lines))
    after = with_places(before, {"P1": cell, "mat": mat}, {})
    for name, place in (("P1", cell), ("mat", mat)):
        assert place_of(after, name) == pytest.approx(place, abs=1e-9)
    assert without_places(after.text) == without_places(before.text)


def without_places(text: str) -> str:
    return re.sub(r"^at = \[[^]]*\]", "", text, flags=re.MULTILINE)


def test_a_copy_has_all_that_its_original_has_but_its_name_and_place():
    before = rig_of(placed_text(parts=HEATER))
    after = with_places(before, {"P2": (0.12, 0.06), "P1": (0.04, 0.03)}, {"P2": "P1"})
    first, second = tomllib.loads(after.text)["cells"]
    assert first["at"] == ["4 cm", "3 cm"]
    assert second == first | {"name": "P2", "at": ["12 cm", "6 cm"]}
    assert [heater.name for heater in after.heaters] == ["mat"]


def test_a_place_that_was_a_parameter_leaves_no_parameter_behind():
    text = placed_text(MOVING)
    after = with_places(rig_of(text), {"P1": (0.05, 0.04)}, {})
    assert set(rig_of(text).parameters) - set(after.parameters) == {"x_1", "y_1"}
    # One that the heater needs too stays.
    shared = placed_text(
        MOVING, parts=HEATER.replace('"12 cm"', '"x_1"').replace('"4 cm"', '"7 cm"')
    )
    after = with_places(rig_of(shared), {"P1": (0.05, 0.04)}, {})
    assert set(rig_of(shared).parameters) - set(after.parameters) == {"y_1"}


def test_a_file_without_a_table_of_that_name_is_refused():
    with pytest.raises(RigError, match=r"placed.toml: P9: expected a table \[\[cells\]\]"):
        with_places(rig_of(placed_text(AT)), {"P9": (0.05, 0.04)}, {})
    table = re.search(r"\[\[cells\]\]\n(.*?)\n\n", placed_text(), re.DOTALL)
    assert table is not None
    inline = f"cells = [{{ {', '.join(table[1].splitlines())} }}]\n\n[plate]"
    text = placed_text().replace(table[0], "").replace("[plate]", inline)
    with pytest.raises(RigError, match=r"placed.toml: P1: expected a table \[\[cells\]\]"):
        with_places(rig_of(text), {"P1": (0.05, 0.04)}, {})


def test_a_file_without_headers_has_no_tables_of_cells():
    assert _tables('name = "inline"\ncells = [{ name = "P1" }]\n') == []
