"""Tables 1 to 4 of the paper as data (Electronics 2024, 13, 1419).

The numbers are those that are printed. If a number disagrees with another number of the paper, or
with the authors' model file, the note of its row says so.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass

from .._data_folder import data_folder
from ..errors import JaxtwinError

_numbers = (1, 2, 3, 4)


@dataclass(frozen=True)
class Table:
    """One table of the paper.

    `rows` map column names to text or numbers, in the order in which the paper prints them. Every
    row has a `unit` and a `note`, which may be empty.
    """

    number: int
    title: str
    condition: str
    rows: tuple[Mapping[str, str | float], ...]

    def column(self, name: str, *, by: str = "symbol") -> dict[str, str | float]:
        """One column of the table.

        **Arguments:**

        - `name`: the name of the column, such as `"value"` (Tables 1 to 3) or `"final"` (Table 4).
        - `by`: the column that labels the rows. Table 1 has no symbols: use `"property"`.

        **Returns:**

        A dictionary from label to entry; numbers are in the row's unit.
        """
        return {str(row[by]): row[name] for row in self.rows}


def table(number: int) -> Table:
    """Reads a table of the paper.

    **Arguments:**

    - `number`: 1 (the rig's documentation), 2 and 3 (module datasheet and the constants that the
        paper derives from it) or 4 (matched parameters).

    **Returns:**

    The table, with the numbers as printed.

    **Raises:**

    `JaxtwinError` if the paper has no such table.
    """
    if number not in _numbers:
        raise JaxtwinError(f"table: expected 1, 2, 3 or 4, got {number}")
    file = data_folder() / "tables" / f"table{number}.toml"
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    rows = tuple({**_plain(row), "note": row.get("note", "")} for row in content["rows"])
    return Table(number, content["title"], content["condition"], rows)


def _plain(row: Mapping[str, str | int | float]) -> dict[str, str | float]:
    return {key: entry if isinstance(entry, str) else float(entry) for key, entry in row.items()}
