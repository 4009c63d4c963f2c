"""How results show themselves: as a table in a notebook, and as a picture."""

import importlib
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST = 40
"""Rows of a table in a notebook; a last one says how many more there are."""


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for Jupyter.

    **Arguments:**

    - `caption`: one line of plain text, such as the result's `repr`.
    - `head`: of each column. `rows`: of plain text, the first cell being the row's name.
    """
    several = list(rows)
    lines = [
        f"<tr><th>{escape(first)}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        for first, *cells in several[:LONGEST]
    ]
    if len(several) > LONGEST:
        more = f"{len(several) - LONGEST} more rows"
        lines.append(f"<tr><th></th><td colspan={len(head) - 1}>{more}</td></tr>")
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    return (
        f"<table><caption>{escape(caption)}</caption><thead><tr>{names}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table>"
    )


def picture(name: str, *arguments: Any, **options: Any) -> "Figure":
    """What a function of `jaxtwin.plots` draws.

    Pictures stand above all packages and know the results that they show. A result's `plot` asks
    for its picture by name when it is called, as pandas asks its plotting backend, so that no
    package depends on the pictures of itself.

    **Arguments:**

    - `name`: of the function.
    """
    return getattr(importlib.import_module(".plots", __package__), name)(*arguments, **options)
