"""Every command line of the README and of docs/ is one that jaxtwin understands.

None of them is run: command, options, the number of arguments and the kinds of their values are
checked, as typer does it before a command begins.
"""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from jaxtwin.cli import UsageProblem, app

CHECKOUT = Path(__file__).parent.parent
BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
START = re.compile(r"^ *(ExecStart=/\S*/)?jaxtwin ")
ROOT: Any = typer.main.get_command(app)


def command_lines(page: Path) -> Iterator[str]:
    """What follows `jaxtwin` on the lines of shell blocks, or of a service's file."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".md":
        text = "\n".join(block for kind, block in BLOCK.findall(text) if kind in ("", "bash", "sh"))
    for line in text.replace("\\\n", " ").splitlines():
        if START.match(line):
            yield START.sub("", line)


PAGES = [
    page
    for page in (
        *CHECKOUT.glob("*.md"),
        *(CHECKOUT / "docs").rglob("*.md"),
        *(CHECKOUT / "docs/operations").iterdir(),
        *(CHECKOUT / "notebooks").glob("*.md"),
    )
    if any(command_lines(page))
]


def parse(line: str) -> None:
    """Reads a command line up to where the command would begin."""
    words = [word for word in shlex.split(line, comments=True) if word != "&"]
    name, command, context = "jaxtwin", ROOT, None
    while hasattr(command, "commands"):
        context = command.context_class(command, parent=context, info_name=name)
        name, command, words = command.resolve_command(context, words)
    command.make_context(name, words, parent=context)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(CHECKOUT)))
def test_command_lines_of_a_page_are_understood(page: Path) -> None:
    for line in command_lines(page):
        parse(line)


@pytest.mark.parametrize(
    "line",
    [
        "mach paper-2024 synthetic-A --out fit.toml",
        "match paper-2024 synthetic-A --outt fit.toml",
        "data fetch --too recordings",
        "sensitivity paper-2024 synthetic-A --draws many",
        "dc-sweep",
        "rigs paper-2024",
    ],
)
def test_a_command_line_that_jaxtwin_refuses_is_not_understood(line: str) -> None:
    with pytest.raises(UsageProblem):
        parse(line)
