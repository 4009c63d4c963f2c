"""Reads a recording from a file of any known format."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from .._arguments import of_kind, path_of, whole_number
from .._errors import RecordingError
from ..rig import Rig
from ._csv import parse_csv
from ._delimited import CELL, names_of_columns
from ._duty_of_rig import check_heats_only
from ._experiment import Experiment
from ._mat import parse_mat
from ._matlab5 import is_matlab5
from ._netcdf import parse_netcdf
from ._session import Session
from ._session_file import is_session
from ._table_files import csv_of_parquet, csv_of_workbook

AUTHORS_COUNTS = 255
"""The PWM counts of full duty in the .mat files of the paper's authors."""

HDF5 = b"\x89HDF\r\n\x1a\n"

TABLES: dict[str, Callable[[bytes], bytes]] = {
    "csv": bytes,
    "xlsx": csv_of_workbook,
    "parquet": csv_of_parquet,
}
"""Formats of tables with titles of their own, and what makes the text of a .csv file of them."""


def read_recording(
    path: str | Path,
    *,
    rig: Rig | None = None,
    columns: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    zone: str | None = None,
    counts: int | None = None,
    polarity: int | None = None,
) -> Experiment:
    """Reads a recording: the authors' .mat files, .csv, a spreadsheet, Parquet, or netCDF.

    The format is recognised by the first bytes. If they are those of no other format, the file is
    read as text, .csv.

    - .mat (MATLAB 5 to 7): the variable `simout` with 11 columns (two cells, five channels of one
        zone) or with 4 (one cell, one channel `T`). Nothing else in the file is read.
    - .csv: a line of column names with units, `time_s,duty_P1,duty_P2,T11_degC,ambient_degC`;
      `pwm_P1` are counts, `_K` is kelvin. If all channels are blank, no temperatures were recorded.
      Semicolons or tabs may separate columns, numbers may have a decimal comma beside them, and a
      unit may stand in brackets: `T11 [degC]`. `columns` and `ignore` read the files of loggers.
    - .xlsx (the first sheet) and .parquet: as .csv, with time stamps and truth values of their own;
        `pip install 'jaxtwin[tables]'`.
    - .db: a live session, as `jaxtwin record` writes it, on a grid of 1 s; `jaxtwin.io.Session`
        gives other grids and parts of it.
    - netCDF: `duty` (time, cell), `temperature` (time, channel) and `ambient`, with units, as
        `Experiment.to_xarray` gives them.

    A temperature that is NaN, a fill value, or in text an empty field, `nan`, `NA` or `null`, is a
    missing sample. Time and duty must be complete; a missing ambient is interpolated.

    **Arguments:**

    - `path`: the file. Its name without the ending becomes the name of the experiment.
    - `rig`: the rig, whose driver says how many PWM counts full duty has and their polarity, and
      whose inputs may be columns of their own names, without `input_`.
    - `columns`: names for columns of a .csv, .xlsx or .parquet file that are called otherwise:
      `{"heater_on": "duty_P1", "Temperatur 1": "T1", "t_out": "ambient", "clock": "time"}`. A
      temperature without a unit in both names is in degC. `"time"` may be a time stamp or a number
      since 1970, in s, ms, us or ns, and `"T1_time"` is the time at which `T1` was read, if that
      is another: `T1` is then interpolated.
    - `ignore`: titles of columns that are left out, of which `*` and `?` stand for any characters.
    - `zone`: `"A"`, `"B"` or `"C"`, the zone of the two-cell plate in a .mat file; needed if the
      name of the file does not contain it (`...SecA...`).
    - `counts`: the PWM counts of full duty, if there is no rig; of the authors' .mat files 255.
    - `polarity`: 1 if positive PWM counts heat the plate, -1 if they cool it; None: that of the
      rig, otherwise 1.

    **Returns:**

    An `Experiment` at the file's own times. If samples were lost, `gaps` says where and `parts`
    are the parts between them, which `match` takes as recordings of their own.

    **Raises:**

    `RecordingError` that names the file, the problem, and what was expected.
    """
    file = path_of("read_recording: path", path, RecordingError)
    if rig is not None:
        of_kind("read_recording: rig", rig, Rig, "a Rig, as load_rig makes it", RecordingError)
        counts = rig.driver.counts if counts is None else counts
        polarity = rig.driver.polarity if polarity is None else polarity
    if counts is not None:
        whole_number("counts", counts, 1, RecordingError)
    polarity = 1 if polarity is None else polarity
    if polarity not in (1, -1):
        raise RecordingError(f"polarity: expected 1 or -1, got {polarity!r}")
    if is_session(file):
        return _session_experiment(file, zone)
    content = _content(file)
    kind = _kind(file, content)
    try:
        if zone is not None and kind != "mat":
            raise RecordingError(
                f"zone: expected none, as only two-cell .mat recordings have one, got {zone!r}"
            )
        if kind not in TABLES and (columns or ignore):
            raise RecordingError(
                "columns, ignore: expected a .csv, .xlsx or .parquet file, got another format"
            )
        if kind == "mat":
            full = AUTHORS_COUNTS if counts is None else counts
            experiment = parse_mat(
                content, name=file.stem, zone=zone, counts=full, polarity=polarity
            )
        elif kind == "netcdf":
            experiment = parse_netcdf(content, name=file.stem)
        else:
            experiment = parse_csv(
                TABLES[kind](content),
                name=file.stem,
                counts=counts,
                polarity=polarity,
                names=columns,
                ignore=ignore,
                own=None if rig is None else _own_titles(rig),
            )
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None
    if rig is not None:
        check_heats_only(experiment, rig, str(file), RecordingError)
    return experiment


def _own_titles(rig: Rig) -> dict[str, str]:
    """The titles of columns to which a rig gives a meaning: its inputs by their names, and the
    duty and counts of its cells and heaters."""
    own = {one.name: f"input_{one.name}" for one in rig.inputs}
    for number, name in enumerate(rig.driven, start=1):
        for kind in ("duty", "pwm"):
            if CELL.fullmatch(f"{kind}_{name}") is None:  # P2 is the second, whatever its name
                own[f"{kind}_{name}"] = f"{kind}_P{number}"
    return own


def column_names(
    path: str | Path, *, columns: Mapping[str, str] | None = None, ignore: Sequence[str] = ()
) -> dict[str, str | None]:
    """What `read_recording` takes each column of a .csv, .xlsx or .parquet file for.

    **Arguments:**

    - `path`: the file. `columns`, `ignore`: as in `read_recording`.

    **Returns:**

    Title in the file -> name, such as `T1_degC`; None for a column that is left out. A name may be
    one that `read_recording` refuses.

    **Raises:** `RecordingError` if the file cannot be read or is of another format, or for a title
    that it does not have.
    """
    file = path_of("column_names: path", path, RecordingError)
    content = _content(file)
    kind = _kind(file, content)
    if kind not in TABLES:
        raise RecordingError(f"{file}: expected a .csv, .xlsx or .parquet file, got .{kind}")
    try:
        return names_of_columns(TABLES[kind](content), columns, ignore)
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None


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
        raise RecordingError(
            f"{file}: expected a MATLAB 5 to 7 file, got MATLAB 7.3 (HDF5); save it in MATLAB with "
            "'-v7'"
        )
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
