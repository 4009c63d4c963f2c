"""Draws the confusion matrix of `benchmarks.faults` from its page of results.

A row is a fault of the virtual rig, a column what the diagnosis called it; rows are of all sizes.

    python -m benchmarks.confusion
"""

from pathlib import Path

from ._pictures import confusion_picture

RESULTS = Path(__file__).parent / "results"

HEADING = "What the likeliest explanation was"
"""The line above the table."""


def main() -> None:
    columns, rows = confusion_of((RESULTS / "faults.md").read_text(encoding="utf-8"))
    (RESULTS / "confusion.png").write_bytes(confusion_picture(columns, rows))


def confusion_of(page: str) -> tuple[list[str], dict[str, list[int]]]:
    """The names of the columns, and the counts of each row, of the table of a page."""
    lines = page[page.index(HEADING) :].splitlines()[2:]
    table = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines[: lines.index("")]
        if set(line) - set("|-: ")
    ]
    (_, *columns), *rows = table
    return columns, {name: [int(cell or 0) for cell in cells] for name, *cells in rows}


if __name__ == "__main__":
    main()
