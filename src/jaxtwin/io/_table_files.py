"""Tables of spreadsheets (.xlsx), of data frames (Parquet) and of LabVIEW (.tdms), as text that
`_csv` reads: with the same titles, units, time stamps and words for a missing sample as in a .csv
file.

openpyxl, pyarrow and npTDMS read them, the libraries that pandas and polars use as well.
"""

import csv
import io
from collections.abc import Iterable
from datetime import datetime
from itertools import zip_longest
from typing import Any

from .._name_suggestions import did_you_mean
from ..errors import RecordingError

# What installs the libraries, for messages.
EXTRA = "pip install 'jaxtwin[tables]', in a checkout pip install -e '.[tables]'"


def csv_of_workbook(content: bytes, sheet: str | None = None) -> bytes:
    """A sheet of a workbook, the first if none is named; formulas count as the values that Excel
    has saved.

    **Raises:** `RecordingError` if the file is damaged, openpyxl is not installed, there is no such
    sheet, or the first of several holds no table.
    """
    try:
        import openpyxl
    except ImportError:
        raise RecordingError(f"is an Excel workbook; reading it needs {EXTRA}") from None
    try:
        workbook = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        names = [worksheet.title for worksheet in workbook.worksheets]
        chosen = names.index(sheet) if sheet in names else 0
        rows = [list(row) for row in workbook.worksheets[chosen].iter_rows(values_only=True)]
    except Exception as error:  # the library raises whatever the damaged bytes lead to
        raise RecordingError(f"is a damaged Excel workbook ({type(error).__name__})") from None
    if sheet is not None and sheet not in names:
        raise RecordingError(
            f"sheet: expected one of {', '.join(names)}, got {sheet!r}"
            f"{did_you_mean([sheet], names)}"
        )
    width = max((len(row) for row in rows), default=0)
    if sheet is None and len(names) > 1 and (width < 2 or len(rows) < 3):
        raise RecordingError(
            f"expected a table in the first sheet, {names[0]!r}, got {len(rows)} rows of {width} "
            f"columns; sheet= names another, in a command --sheet: {', '.join(names[1:])}"
        )
    return csv_of_rows(row + [None] * (width - len(row)) for row in rows)


def csv_of_parquet(content: bytes) -> bytes:
    """The columns of a Parquet file, and the index of a data frame of pandas if it has one.

    **Raises:** `RecordingError` if the file is damaged, or pyarrow is not installed.
    """
    try:
        from pyarrow import parquet
    except ImportError:
        raise RecordingError(f"is a Parquet file; reading it needs {EXTRA}") from None
    try:
        # Not `read_table`, whose threads may abort a process that ends right after the reading.
        table = parquet.ParquetFile(io.BytesIO(content), pre_buffer=False).read(use_threads=False)
        columns = {name: table.column(name).to_pylist() for name in table.column_names}
    except Exception as error:
        raise RecordingError(f"is a damaged Parquet file ({type(error).__name__})") from None
    # An index without a name can only be the times, as in `Experiment.from_dataframe`.
    titles = ["time" if name.startswith("__index_level_") else name for name in columns]
    return csv_of_rows([titles, *zip(*columns.values(), strict=True)])


def csv_of_tdms(content: bytes) -> bytes:
    """The channels of a .tdms file of LabVIEW: those of the largest group, with the times of their
    waveform where no channel holds them.

    **Raises:** `RecordingError` if the file is damaged, or npTDMS is not installed.
    """
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise RecordingError(f"is a .tdms file of LabVIEW; reading it needs {EXTRA}") from None
    try:
        groups = TdmsFile.read(io.BytesIO(content)).groups()
        channels = max((group.channels() for group in groups), key=len, default=[])
        columns: dict[str, list[Any]] = {}
        for channel in channels:
            unit = str(channel.properties.get("unit_string", "")).strip()
            values = channel[:]
            times = values.dtype.kind == "M"
            columns[f"{channel.name} ({unit})" if unit else channel.name] = (
                values.astype("datetime64[us]").tolist() if times else values.tolist()
            )
            if "wf_increment" in channel.properties:
                columns.setdefault("time_s", channel.time_track().tolist())
    except Exception as error:
        raise RecordingError(f"is a damaged .tdms file ({type(error).__name__})") from None
    return csv_of_rows([[*columns], *zip_longest(*columns.values())])


def csv_of_rows(rows: Iterable[Iterable[Any]]) -> bytes:
    """Rows of cells as the text of a .csv file, the first of titles."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([_text(cell) for cell in row] for row in rows)
    return text.getvalue().encode()


def _text(cell: Any) -> str:
    """A cell as a .csv file has it. Numbers keep all their digits."""
    if cell is None:
        return ""
    return cell.isoformat(" ") if isinstance(cell, datetime) else str(cell)
