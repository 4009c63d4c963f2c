"""Tables of spreadsheets (.xlsx) and of data frames (Parquet), as text that `_csv` reads: with the
same titles, units, time stamps and words for a missing sample as in a .csv file.

openpyxl and pyarrow read them, the libraries that pandas and polars use as well.
"""

import csv
import io
from collections.abc import Iterable
from datetime import datetime
from typing import Any

from .._errors import RecordingError

EXTRA = "pip install 'jaxtwin[tables]', in a checkout pip install -e '.[tables]'"
"""What installs the libraries, for messages."""


def csv_of_workbook(content: bytes) -> bytes:
    """The first sheet of a workbook; formulas count as the values that Excel has saved.

    **Raises:** `RecordingError` if the file is damaged, or openpyxl is not installed.
    """
    try:
        import openpyxl
    except ImportError:
        raise RecordingError(f"is an Excel workbook; reading it needs {EXTRA}") from None
    try:
        workbook = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        rows = [list(row) for row in workbook.worksheets[0].iter_rows(values_only=True)]
    except Exception as error:  # the library raises whatever the damaged bytes lead to
        raise RecordingError(f"is a damaged Excel workbook ({type(error).__name__})") from None
    width = max((len(row) for row in rows), default=0)
    return _csv(row + [None] * (width - len(row)) for row in rows)


def csv_of_parquet(content: bytes) -> bytes:
    """The columns of a Parquet file, and the index of a data frame of pandas if it has one.

    **Raises:** `RecordingError` if the file is damaged, or pyarrow is not installed.
    """
    try:
        from pyarrow import parquet
    except ImportError:
        raise RecordingError(f"is a Parquet file; reading it needs {EXTRA}") from None
    try:
        table = parquet.read_table(io.BytesIO(content))
        columns = {name: table.column(name).to_pylist() for name in table.column_names}
    except Exception as error:
        raise RecordingError(f"is a damaged Parquet file ({type(error).__name__})") from None
    # An index without a name can only be the times, as in `Experiment.from_dataframe`.
    titles = ["time" if name.startswith("__index_level_") else name for name in columns]
    return _csv([titles, *zip(*columns.values(), strict=True)])


def _csv(rows: Iterable[Iterable[Any]]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([_text(cell) for cell in row] for row in rows)
    return text.getvalue().encode()


def _text(cell: Any) -> str:
    """A cell as a .csv file has it. Numbers keep all their digits."""
    if cell is None:
        return ""
    return cell.isoformat(" ") if isinstance(cell, datetime) else str(cell)
