"""Reads a matrix of real numbers from a MATLAB 5 file (MATLAB 5 to 7, saved with `-v6` or `-v7`).

The file is a header of 128 bytes and then elements, each a tag (type, size in bytes) and its data.
An element is either compressed, and holds another one, or it is a variable, which holds its flags,
dimensions, name and numbers as separate elements.
Source: MathWorks, "MAT-File Format", level 5.

`scipy.io.loadmat` reads the same, and the tests compare with it. It is not used here because
damaged bytes crash it together with the whole process (a segmentation fault, scipy 1.17), and
because it stops at the variable asked for, so that it misses a file that is cut off.
"""

import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError

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
