"""The display of results: as a table of text or in a notebook, as a picture, and as a report."""

import importlib
import os
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

# The largest number of rows of a table in a notebook; a last row says how many more there are.
MAX_ROWS = 40


def aligned(rows: Sequence[Sequence[str]], right: slice = slice(0)) -> str:
    """Formats rows of text in columns, each as wide as its widest entry, to the left or, those of
    `right`, to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    justified = [str.ljust] * len(widths)
    justified[right] = [str.rjust] * len(widths[right])
    return "\n".join(
        "  ".join(
            put(cell, width) for put, cell, width in zip(justified, row, widths, strict=True)
        ).rstrip()
        for row in rows
    )


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for Jupyter.

    **Arguments:**

    - `caption`: one line of plain text, such as the result's `repr`.
    - `head`: the heading of each column. `rows`: rows of plain text, each of which begins with its
      name.
    """
    several = list(rows)
    lines = [
        f"<tr><th>{escape(first)}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        for first, *cells in several[:MAX_ROWS]
    ]
    if len(several) > MAX_ROWS:
        more = f"{len(several) - MAX_ROWS} more rows"
        lines.append(f"<tr><th></th><td colspan={len(head) - 1}>{more}</td></tr>")
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    return (
        f"<table><caption>{escape(caption)}</caption><thead><tr>{names}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table>"
    )


def picture(name: str, *arguments: Any, **options: Any) -> Any:
    """Draws with a function of `jaxtwin.plots`, which is looked up by its name when it is called.

    `jaxtwin.plots` imports the packages whose results it draws. A result's `plot` method therefore
    cannot import its plot function. It calls this function instead, as pandas calls its plotting
    backend, so that imports between packages go in one direction.

    **Arguments:**

    - `name`: the name of the function, such as `"plot_bands"`.
    - `arguments`, `options`: passed on to the function.

    **Returns:** what the function returns, a matplotlib figure or axes.
    """
    return getattr(importlib.import_module(".plots", __package__), name)(*arguments, **options)


def report(result: object, path: str | os.PathLike[str], **options: Any) -> Path:
    """Writes a result as a page by `jaxtwin.report.write_report`, looked up as in `picture`."""
    return importlib.import_module(".report", __package__).write_report(result, path, **options)
