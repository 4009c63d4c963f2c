"""A fit as a table for papers: a column of the layout for each column of the rows."""

import re

import pytest
from small_results import fit


def test_a_table_in_markdown_aligns_its_seven_numbers_to_the_right():
    heading, rule, *rows = [
        line for line in fit().summary("markdown").splitlines() if line.startswith("|")
    ]
    cells = rule.strip("| ").split(" | ")
    assert cells == ["---", *["---:"] * 7, "---", "---"]
    assert {line.count(" |") for line in (heading, *rows)} == {len(cells)}


def test_a_table_in_latex_has_a_column_for_each_cell():
    lines = fit().summary("latex").splitlines()
    (layout,) = re.findall(r"\\begin\{tabular\}\{(\w+)\}", "\n".join(lines))
    assert layout == "l" + 7 * "r" + "ll"
    rows = [line for line in lines if line.endswith(r"\\")]
    assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(layout) - 1}


@pytest.mark.parametrize("style", ["text", "markdown", "latex"])
def test_every_matched_parameter_has_a_row(style):
    text = fit().summary(style)
    for name in ("R_E", "R_pc", "T_amb"):
        assert name in text.replace("\\", "")
