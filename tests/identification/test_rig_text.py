"""Tables written as TOML are read back the same."""

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.identification._identified import rig_text

TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=20)
VALUES = st.one_of(TEXTS, st.booleans(), st.integers(-(2**40), 2**40), st.lists(TEXTS, max_size=3))
NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,10}", fullmatch=True)
TABLES = st.dictionaries(NAMES, VALUES, min_size=1, max_size=4)


@given(TABLES, st.lists(TABLES, max_size=3), TABLES)
def test_any_tables_come_back(table, several, row):
    tables = {"first": table, "several": several, "parameters": {"a": row}}
    assert tomllib.loads(rig_text(tables, "a comment\nin two lines")) == tables


def test_numbers_keep_six_digits():
    text = rig_text({"parameters": {"C": {"value": 1234.56789, "unit": "J/K"}}}, "")
    assert tomllib.loads(text)["parameters"]["C"]["value"] == 1234.57
