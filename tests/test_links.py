"""The links of the project's Markdown lead somewhere, as GitHub shows it.

`make docs` checks those of the site.
"""

import re
from pathlib import Path
from urllib.parse import urlparse

import pytest

CHECKOUT = Path(__file__).parent.parent
PAGES = [
    *CHECKOUT.glob("*.md"),
    *(CHECKOUT / "docs").rglob("*.md"),
    *(CHECKOUT / "benchmarks").rglob("*.md"),
    *(CHECKOUT / "notebooks").glob("*.md"),
]
CODE = re.compile(r"^(`{3,}|~{3,}).*?^\1 *$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^()\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Of the headings: in lower case, with hyphens for blanks and without punctuation."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = [LINK.sub("]", title).lower() for title in titles]
    return {re.sub(r"[^\w\- ]", "", title).replace(" ", "-") for title in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(CHECKOUT)))
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    for link in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if urlparse(link).scheme:
            continue
        path, _, anchor = link.partition("#")
        there = page.parent / path if path else page
        assert there.exists(), link
        if anchor:
            assert anchor in anchors(there), link
