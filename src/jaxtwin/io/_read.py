"""Reads a recording from a file of any known format."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from .._arguments import finite_number, path_of, whole_number
from ..errors import RecordingError
from ..rig import Rig, load_rig
from ._column_meaning import Choices
from ._csv import parse_csv
from ._delimited import names_of_columns
from ._duty_of_rig import check_heats_only, of_rig
from ._experiment import Experiment
from ._mat import csv_of_mat, is_matlab5, is_of_the_authors, parse_mat
from ._netcdf import parse_netcdf
from ._recorded_columns import RecordedDrive
from ._session import Session
from ._session_file import is_session
from ._table_files import csv_of_parquet, csv_of_tdms, csv_of_workbook

# The PWM counts of full duty in the .mat files of the paper's authors.
AUTHORS_COUNTS = 255

HDF5 = b"\x89HDF\r\n\x1a\n"

# Formats of tables with titles of their own, which `columns` may name otherwise.
TABLES = ("csv", "xlsx", "parquet", "mat", "tdms")


def read_recording(
    path: str | Path,
    *,
    rig: Rig | str | os.PathLike[str] | None = None,
    columns: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    scale: Mapping[str, str] | None = None,
    duty: float | int | None = None,
    header: int | None = None,
    sheet: str | None = None,
    spread: bool = False,
    zone: str | None = None,
    counts: int | None = None,
    polarity: int | None = None,
) -> Experiment:
    """Reads a recording: text of loggers, a spreadsheet, Parquet, MATLAB, LabVIEW, or netCDF.

    The format is recognised by the first bytes. If they are those of no other format, the file is
    read as text, .csv.

    - .csv: a line of column names with units, `time_s,duty_P1,duty_P2,T11_degC,ambient_degC`;
      `pwm_P1` are counts. If all channels are blank, no temperatures were recorded. Semicolons or
      tabs may separate columns, numbers may have a decimal comma beside them. `columns` and
      `ignore` read the files of loggers, whose titles may stand below a preamble.
    - .xlsx, .parquet and .tdms: as .csv, with time stamps and truth values of their own;
      `pip install 'jaxtwin[tables]'`.
    - .mat: variables of one length are columns, those of a matrix `data_1`, `data_2`. The paper's
      authors have a variable `simout` with 11 columns (two cells, five channels of one zone) or
      with 4 (one cell, one channel `T`), which is read without names.
    - .db: a live session, as `jaxtwin record` writes it, on a grid of 1 s; `jaxtwin.io.Session`
        gives other grids and parts of it.
    - netCDF: `duty` (time, cell), `temperature` (time, channel) and `ambient`, with units, as
        `Experiment.to_xarray` gives them.

    A title's unit is kept under any name: `columns={"bed (F)": "T1"}` is converted. A temperature
    that is NaN, a fill value, an empty field, or a word or number for a failed reading (`nan`,
    `unavailable`, 9.9e37, -127) is a missing sample. A missing duty or input is the last one, a
    missing ambient is interpolated. `Experiment.notes` says what was done.

    **Arguments:**

    - `path`: the file. Its name without the ending becomes the name of the experiment.
    - `rig`: the rig, its name or its file. Its driver says how many PWM counts full duty has and
      their polarity, and its inputs may be columns of their own names, without `input_`. Columns of
      duty belong to its cells and heaters by their names, `duty_foil`; `duty_P2` is the second,
      unless cells of the rig are called by such numbers themselves. The experiment has them in the
      rig's order.
    - `columns`: names for columns that are called otherwise, by their titles or their numbers from
      1 on: `{"heater_on": "duty_P1", "Temperatur 1": "T1", "4": "ambient", "clock": "time"}`. A
      temperature without a unit in both names is in degC. `"time"` may be a time stamp, hh:mm:ss or
      a number since 1970, in s, ms, us or ns, and `"T1_time"` is the time at which `T1` was read,
      if that is another: `T1` is then interpolated.
    - `ignore`: titles of columns that are left out, of which `*` and `?` stand for any characters.
      `"*"` alone leaves out all that would be refused.
    - `scale`: what a column in another quantity means, name -> factor and unit of the column:
      `{"duty_P1": "1/2220 W"}` of a heater of 2220 W, `{"T1": "0.1"}` of tenths of a degree.
    - `duty`: the constant duty of the cells and heaters without a column.
    - `header`: the number of the line of titles, 0 for a file without any; None: it is searched.
    - `sheet`: the name of the sheet of a workbook; None: the first.
    - `spread`: whether several samples of one time, as of a clock of whole seconds, are spread
      evenly up to the next time.
    - `zone`: `"A"`, `"B"` or `"C"`, the zone of the two-cell plate in a .mat file; needed if the
      name of the file does not contain it (`...SecA...`).
    - `counts`: the PWM counts of full duty, if there is no rig; of the authors' .mat files 255.
    - `polarity`: 1 if positive PWM counts heat the plate, -1 if they cool it; None: that of the
      rig, otherwise 1.

    **Returns:**

    An `Experiment` at the file's own times. If samples were lost, `gaps` says where and `parts`
    are the parts between them, which `match` takes as recordings of their own.

    **Raises:**

    `RecordingError` that names the file, the problem, and what was expected; `RigError` for a rig
    that cannot be read.
    """
    file = path_of("read_recording: path", path, RecordingError)
    if rig is not None:
        rig = load_rig(rig)
        of_driver = rig.driver.counts if rig.driver.states_counts else None
        counts = of_driver if counts is None else counts
        polarity = rig.driver.polarity if polarity is None else polarity
    if counts is not None:
        whole_number("counts", counts, 1, RecordingError)
    polarity = 1 if polarity is None else polarity
    if polarity not in (1, -1):
        raise RecordingError(f"polarity: expected 1 or -1, got {polarity!r}")
    if is_session(file):
        experiment = _session_experiment(file, zone)
        return experiment if rig is None else of_rig(experiment, rig, str(file), RecordingError)
    choices = Choices(columns or {}, ignore, scale or {}, rig)
    content = _content(file)
    kind = _kind(file, content)
    try:
        if zone is not None and kind != "mat":
            raise RecordingError(
                f"zone: expected none, as only two-cell .mat recordings have one, got {zone!r}"
            )
        of_table = columns or ignore or scale or spread or (duty, header) != (None, None)
        if kind not in TABLES and of_table:
            raise RecordingError(
                "columns, ignore, scale, duty, header, spread: expected a .csv, .xlsx, .parquet, "
                ".mat or .tdms file, got another format"
            )
        if kind == "mat" and not columns and is_of_the_authors(content):
            full = AUTHORS_COUNTS if counts is None else counts
            experiment = parse_mat(
                content, name=file.stem, zone=zone, counts=full, polarity=polarity
            )
        elif kind == "netcdf":
            experiment = parse_netcdf(content, name=file.stem)
        else:
            constant = None if duty is None else finite_number("duty", duty, RecordingError)
            names = None if rig is None else rig.driven
            experiment = parse_csv(
                _text(kind, content, sheet),
                name=file.stem,
                drive=RecordedDrive(counts, polarity, constant, names, spread),
                choices=choices,
                header=header,
            )
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None
    if rig is not None:
        experiment = of_rig(experiment, rig, str(file), RecordingError)
        check_heats_only(experiment, rig, str(file), RecordingError)
    return experiment


def _text(kind: str, content: bytes, sheet: str | None) -> bytes:
    """The text of a .csv file with the same table."""
    if sheet is not None and kind != "xlsx":
        raise RecordingError(f"sheet: expected none, as only .xlsx files have some, got {sheet!r}")
    if kind == "xlsx":
        return csv_of_workbook(content, sheet)
    return {"parquet": csv_of_parquet, "mat": csv_of_mat, "tdms": csv_of_tdms}.get(kind, bytes)(
        content
    )


def column_names(
    path: str | Path,
    *,
    rig: Rig | None = None,
    columns: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    scale: Mapping[str, str] | None = None,
    header: int | None = None,
    sheet: str | None = None,
) -> dict[str, str | None]:
    """What `read_recording` takes each column of a table for.

    **Arguments:**

    - `path`: the file. The others are as in `read_recording`.

    **Returns:**

    Title in the file -> name, such as `T1_degC`; None for a column that is left out. A name may be
    one that `read_recording` refuses.

    **Raises:** `RecordingError` if the file cannot be read or is of another format, or for a title
    that it does not have.
    """
    file = path_of("column_names: path", path, RecordingError)
    try:
        text = table_content(file, sheet)
        choices = Choices(columns or {}, ignore, scale or {}, rig)
        return names_of_columns(text, choices, header)
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None


def table_content(file: Path, sheet: str | None = None) -> bytes:
    """The table of a file, as the text of a .csv file.

    **Raises:** `RecordingError` if the file cannot be read, or holds no table with titles.
    """
    content = _content(file)
    kind = _kind(file, content)
    if kind not in TABLES:
        raise RecordingError(f"expected a .csv, .xlsx, .parquet, .mat or .tdms file, got .{kind}")
    return _text(kind, content, sheet)


def _session_experiment(file: Path, zone: str | None) -> Experiment:
    if zone is not None:
        raise RecordingError(
            f"{file}: zone: expected none, as only two-cell .mat recordings have one, got {zone!r}"
        )
    with Session(file) as session:
        return session.experiment()


def _content(file: Path) -> bytes:
    try:
        content = file.read_bytes()
    except OSError as error:
        raise RecordingError(f"{file}: cannot be read: {error.strerror}") from None
    if not content:
        raise RecordingError(
            f"{file}: expected a .mat, .csv or .nc recording, got an empty file (0 bytes)"
        )
    return content


def _kind(file: Path, content: bytes) -> str:
    """Recognises the format by the content. The ending only determines the message about a broken
    file."""
    ending = file.suffix.lower()
    if is_matlab5(content):
        return "mat"
    if content.startswith(b"MATLAB 7.3") or (ending == ".mat" and HDF5 in content[:1024]):
        return "mat"
    if content.startswith(b"TDSm"):
        return "tdms"
    if content.startswith((HDF5, b"CDF\x01", b"CDF\x02")):
        return "netcdf"
    if content.startswith(b"PAR1"):
        return "parquet"
    if content.startswith(b"PK\x03\x04") and ending != ".mat":
        return "xlsx"
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise RecordingError(
            f"{file}: expected an Excel workbook .xlsx, got the older .xls; save it as .xlsx"
        )
    if ending == ".mat":
        raise RecordingError(
            f"{file}: expected a MATLAB 5 to 7 file, got a missing or damaged header"
        )
    if ending == ".nc":
        raise RecordingError(f"{file}: expected a netCDF file, got the first bytes {content[:8]!r}")
    return "csv"
