"""Modules of the page joined to one, as a notebook loads it."""

import re
from collections import Counter

import pytest

from jaxtwin.widgets._notebook_widget import one_module

DECLARED = re.compile(r"^(?:async )?(?:const|let|function|class) (\w+|\[[^\]]*\])", re.MULTILINE)


@pytest.mark.parametrize("name", ["sliders", "rig_view"])
def test_it_imports_nothing_and_exports_one_thing(name: str) -> None:
    text = one_module(name)
    assert not re.search(r"^import ", text, re.MULTILINE)
    assert re.findall(r"^export .*", text, re.MULTILINE) == ["export default { render };"]
    # VS Code loads it from a blob, which has no files beside it.
    assert "import.meta" not in text
    assert not re.search(r"\bimport\(|\brequire\(", text)


@pytest.mark.parametrize("name", ["sliders", "rig_view"])
def test_no_name_is_declared_twice(name: str) -> None:
    # Modules that stand one behind the other share their names.
    counts = Counter(DECLARED.findall(one_module(name)))
    assert {name: count for name, count in counts.items() if count > 1} == {}
    assert "Charts" in counts
