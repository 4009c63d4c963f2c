"""The authors' MATLAB files: a matrix `simout` with a row for each second.

Columns of the two-cell rig: 1 an unused controller output, 2 a copy of 7, 3 time, 4 set point, 5
and 6 the upper zones (second, first), 7 the centre tap, 8 and 9 the lower zones (second, first), 10
and 11 the PWM counts of the cells. Columns of the one-cell rig: PWM counts, temperature, time, set
point. Times in s, temperatures in degC. The files also hold variables of the controller, including
objects that only MATLAB can read; only `simout` is read.

Other files hold vectors of one length, and matrices with as many rows: their variables are columns,
`t`, `u`, `y`, and those of a matrix `data_1`, `data_2`, ... Files of MATLAB 7.3 are HDF5, and
fields of a structure are `log.t`.
"""

import io
import math
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError
from ._checks import duty_from_counts
from ._experiment import Experiment
from ._table_files import csv_of_rows

# Reads a matrix of real numbers from a MATLAB 5 file (MATLAB 5 to 7, saved with `-v6` or
# `-v7`).
#
# The file is a header of 128 bytes and then elements, each a tag (type, size in bytes) and its
# data. An element is either compressed, and holds another one, or it is a variable, which holds
# its flags, dimensions, name and numbers as separate elements. Source: MathWorks, "MAT-File
# Format", level 5.
#
# `scipy.io.loadmat` reads the same, and the tests compare with it. It is not used here because
# damaged bytes crash it together with the whole process (a segmentation fault, scipy 1.17), and
# because it stops at the variable asked for, so that it misses a file that is cut off.


HEADER_SIZE = 128
VARIABLE, COMPRESSED = 14, 15
NUMBERS = dict(
    zip(
        (1, 2, 3, 4, 5, 6, 7, 9, 12, 13),
        ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8", "i8", "u8"),
        strict=True,
    )
)
# The largest size of a matrix, bytes: a week of eleven columns at ten samples a second is larger,
# and nobody has one as .mat.
MAX_MATRIX = 256 << 20

# The part of a compressed variable that holds its name, and the size of the pieces in which the
# rest is unpacked, bytes.
BEGINNING, PIECE = 4096, 1 << 20

NUMERIC_CLASSES = range(6, 16)  # double, single and the integers
NAMED_CLASSES = range(1, 16)  # those, cell, struct, object, char and sparse
COMPLEX, LOGICAL = 0x0800, 0x0200


def is_matlab5(content: bytes) -> bool:
    """Whether this is the header of a MATLAB 5 file, in either byte order."""
    return content[124:HEADER_SIZE] in (b"\x00\x01IM", b"\x01\x00MI")


def read_matrix(content: bytes, name: str, logical: bool = False) -> Float[np.ndarray, "..."]:
    """Reads the matrix called `name`, with the dimensions that it has in the file.

    **Arguments:**

    - `content`: the whole file. Its other variables are skipped, whatever they contain.
    - `name`: the name of the variable.
    - `logical`: whether truth values are numbers, 1 and 0.

    **Returns:**

    Its numbers as float64.

    **Raises:**

    `RecordingError` if the file is damaged or cut off anywhere, if there is no variable of
    this name, or if it holds no real numbers.
    """
    order = "<" if content.endswith(b"IM", 0, HEADER_SIZE) else ">"
    result = None
    try:
        for kind, data in _elements(content[HEADER_SIZE:], order):
            if kind == COMPRESSED:
                kind, data = _decompressed(data, order, name)
            if kind == VARIABLE and _begins_with(data, order, name):
                result = data
        matrix = None if result is None else _matrix(result, order, logical)
    except (ValueError, struct.error, zlib.error):
        raise RecordingError("is a MATLAB file that is damaged or cut off") from None
    if result is None:
        raise RecordingError(f"expected a variable {name!r}, got none")
    if matrix is None:
        raise RecordingError(
            f"variable {name!r}: expected a matrix of real numbers, got something else"
        )
    return matrix


def matrix_names(content: bytes) -> list[str]:
    """The names of the variables of a file, of whatever kind.

    **Raises:** `RecordingError` if the file is damaged or cut off.
    """
    order = "<" if content.endswith(b"IM", 0, HEADER_SIZE) else ">"
    names = []
    try:
        for kind, data in _elements(content[HEADER_SIZE:], order):
            begin = data
            if kind == COMPRESSED:
                begin = zlib.decompressobj().decompress(data, BEGINNING)
                kind, begin = struct.unpack_from(order + "I", begin)[0], begin[8:]
            name = _name(begin, order) if kind == VARIABLE else None
            names += [] if name is None else [name]
    except (ValueError, struct.error, zlib.error):
        raise RecordingError("is a MATLAB file that is damaged or cut off") from None
    return names


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yields the type and the data of each element, each of which must be complete."""
    position = 0
    while position < len(data):
        kind, size = struct.unpack_from(order + "II", data, position)
        start = position + 8
        if kind >> 16:  # up to four bytes of data stand in the tag itself
            kind, size = kind & 0xFFFF, kind >> 16
            start = position + 4
        end = start + size
        if end > len(data) or (start < position + 8 and size > 4):
            raise ValueError("an element reaches beyond the end")
        yield kind, data[start:end]
        position = end if kind == COMPRESSED else position + math.ceil((end - position) / 8) * 8


def _decompressed(packed: bytes, order: str, name: str) -> tuple[int, bytes]:
    """The element in a compressed one. Only its beginning is kept if it is not the variable `name`:
    a megabyte may hold a gigabyte of another one."""
    unpacker = zlib.decompressobj()
    begin = unpacker.decompress(packed, BEGINNING)
    kind, size = struct.unpack_from(order + "II", begin)
    wanted = kind == VARIABLE and _begins_with(begin[8:], order, name)
    if wanted and size > MAX_MATRIX:
        raise RecordingError(
            f"variable {name!r}: expected at most {MAX_MATRIX >> 20} MiB, got {size >> 20} MiB"
        )
    parts, length = [begin], len(begin)
    while not unpacker.eof and length <= size + 8:
        part = unpacker.decompress(unpacker.unconsumed_tail, PIECE)
        if not part and not unpacker.unconsumed_tail:
            break
        length += len(part)
        if wanted:
            parts.append(part)
    if not unpacker.eof or length != size + 8:
        raise ValueError("a compressed element that is cut off or too long")
    return kind, b"".join(parts)[8:] if wanted else begin[8:]


def _begins_with(variable: bytes, order: str, name: str) -> bool:
    """Whether the beginning of a variable has the name."""
    try:
        return _name(variable, order) == name
    except (ValueError, struct.error):
        return False


def _name(variable: bytes, order: str) -> str | None:
    parts = _elements(variable, order)
    _, flags = next(parts, (0, b""))
    if len(flags) != 8 or _class(flags, order) not in NAMED_CLASSES:
        return None  # of another form: an object, a function, or nothing at all
    next(parts, None)
    _, name = next(parts, (0, b""))
    return name.decode("latin-1")


def _matrix(variable: bytes, order: str, logical: bool) -> np.ndarray | None:
    (_, flags), (_, dimensions), _, *numbers = _elements(variable, order)
    (bits,) = struct.unpack_from(order + "I", flags)
    if _class(flags, order) not in NUMERIC_CLASSES or bits & (
        COMPLEX | (0 if logical else LOGICAL)
    ):
        return None
    ((kind, data),) = numbers
    if kind not in NUMBERS:
        raise ValueError("numbers of no known type")
    shape = tuple(np.frombuffer(dimensions, order + "i4").tolist())
    if min(shape) < 0:
        raise ValueError("a negative dimension")
    values = np.frombuffer(data, order + NUMBERS[kind])
    return values.astype(np.float64).reshape(shape, order="F")


def _class(flags: bytes, order: str) -> int:
    (bits,) = struct.unpack_from(order + "I", flags)
    return bits & 0xFF


TWO_CELL_COLUMNS = 11
ONE_CELL_COLUMNS = 4
ZONES = {
    "A": ("T12", "T11", "TAM", "T22", "T21"),
    "B": ("T14", "T13", "TBM", "T24", "T23"),
    "C": ("T16", "T15", "TCM", "T26", "T25"),
}
ONE_CELL_CHANNELS = ("T",)


def parse_mat(
    content: bytes, *, name: str, zone: str | None, counts: int, polarity: int
) -> Experiment:
    """The experiment in a MATLAB 5 file; for the arguments see `read_recording`."""
    simout = _simout(content)
    if simout.shape[1] == ONE_CELL_COLUMNS:
        if zone is not None:
            raise RecordingError(
                "zone: expected none for a recording of one cell ('simout' has 4 columns), got "
                f"{zone!r}"
            )
        time, pwm, temperatures = simout[:, 2], simout[:, :1], simout[:, 1:2]
        channels = ONE_CELL_CHANNELS
    else:
        time, pwm, temperatures = simout[:, 2], simout[:, 9:11], simout[:, 4:9]
        channels = ZONES[_zone(name, zone)]
    _check_range(temperatures)
    return Experiment(
        time,
        duty_from_counts(pwm, counts, polarity),
        cells=[f"P{number + 1}" for number in range(pwm.shape[1])],
        channels=channels,
        temperatures=temperatures,
        name=name,
    )


def is_of_the_authors(content: bytes) -> bool:
    """Whether a MATLAB 5 file has their variable."""
    return is_matlab5(content) and "simout" in matrix_names(content)


def csv_of_mat(content: bytes) -> bytes:
    """The variables of a MATLAB file as the columns of a .csv file.

    **Raises:** `RecordingError` if the file is damaged, or no variables have a length in common.
    """
    matrices = _matrices_of_hdf5(content) if not is_matlab5(content) else _matrices(content)
    vectors = {
        name: matrix.reshape(-1, 1) if 1 in matrix.shape or matrix.ndim == 1 else matrix
        for name, matrix in matrices.items()
        if matrix.size > 1 and matrix.ndim <= 2
    }
    lengths = Counter(len(vector) for vector in vectors.values())
    if not lengths:
        known = ", ".join(matrices) or "none"
        raise RecordingError(f"expected variables that are vectors of numbers, got {known}")
    length = max(lengths, key=lambda length: (lengths[length], length))
    columns: dict[str, list[float]] = {}
    for name, vector in vectors.items():
        if len(vector) == length:
            names = (
                [name]
                if vector.shape[1] == 1
                else [f"{name}_{number + 1}" for number in range(vector.shape[1])]
            )
            columns |= dict(zip(names, vector.T.tolist(), strict=True))
    return csv_of_rows([[*columns], *zip(*columns.values(), strict=True)])


def _matrices(content: bytes) -> dict[str, Float[np.ndarray, "..."]]:
    matrices = {}
    for name in matrix_names(content):
        with suppress(RecordingError):  # text, structures, cells
            matrices[name] = read_matrix(content, name, logical=True)
    return matrices


def _matrices_of_hdf5(content: bytes) -> dict[str, Float[np.ndarray, "..."]]:
    """The numeric variables of a file of MATLAB 7.3, whose matrices are transposed in HDF5."""
    try:
        import h5py
    except ImportError:
        raise RecordingError(
            "is a file of MATLAB 7.3 (HDF5); reading it needs pip install 'jaxtwin[storage]', or "
            "save it in MATLAB with '-v7'"
        ) from None
    matrices: dict[str, Float[np.ndarray, ...]] = {}

    def add(name: str, item: object) -> None:
        is_number = isinstance(item, h5py.Dataset) and item.dtype.kind in "iufb"
        if is_number and not name.startswith("#"):
            matrices[name.replace("/", ".")] = np.asarray(item, np.float64).T

    try:
        with h5py.File(io.BytesIO(content)) as file:
            file.visititems(add)
    except Exception as error:  # the library raises whatever the damaged bytes lead to
        raise RecordingError(f"is a damaged file of MATLAB 7.3 ({type(error).__name__})") from None
    return matrices


def _simout(content: bytes) -> Float[np.ndarray, "times columns"]:
    simout = read_matrix(content, "simout")
    if simout.ndim != 2 or simout.shape[1] not in (TWO_CELL_COLUMNS, ONE_CELL_COLUMNS):
        raise RecordingError(
            f"variable 'simout': expected {TWO_CELL_COLUMNS} columns (two cells) or "
            f"{ONE_CELL_COLUMNS} (one cell), with a row for each time, got shape {simout.shape}"
        )
    return simout


def _zone(name: str, zone: str | None) -> str:
    if zone is None:
        pattern = r"(?:sec|section|zone)[ _-]?([abc])(?![a-z])"
        result = {letter.upper() for letter in re.findall(pattern, name, re.IGNORECASE)}
        if len(result) != 1:
            raise RecordingError(
                "zone: expected a file name with the zone of the plate ('...SecA...'), got none; "
                "pass zone='A', 'B' or 'C'"
            )
        return result.pop()
    if zone.upper() not in ZONES:
        raise RecordingError(f"zone: expected 'A', 'B' or 'C', got {zone!r}")
    return zone.upper()


def _check_range(temperatures: np.ndarray) -> None:
    """Refuses temperatures that the camera cannot read, such as those of a file in kelvin or with
    other columns."""
    low, high = -60.0, 250.0
    wrong = np.argwhere((temperatures < low) | (temperatures > high))
    if wrong.size:
        k, column = wrong[0]
        raise RecordingError(
            f"temperature: expected {low:g} to {high:g} degC, got {temperatures[k, column]:g} "
            f"degC in row {k + 1} of 'simout'"
        )
