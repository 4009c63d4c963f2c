"""Output files of commands: checked before the work, and written as a whole or not at all."""

import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from .._whole_file import write_whole_file
from ..errors import JaxtwinError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STDOUT = Path("-")


def check_output(path: Path | None, *endings: str, option: str = "--out") -> None:
    """Refuses a file that could not be written at the end.

    **Arguments:**

    - `path`: the file, or None if none is wanted.
    - `endings`: the allowed endings; all if none is given.
    - `option`: the option that gave the path.

    **Raises:** `typer.BadParameter` with the reason.
    """
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        allowed = " or ".join(endings)
        raise typer.BadParameter(
            f"{option} {path}: expected a name that ends with {allowed}, got {path.suffix!r}"
        )
    if path.is_dir():
        raise typer.BadParameter(f"{option} {path}: expected a file, got a folder")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise typer.BadParameter(f"{option} {path}: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise typer.BadParameter(f"{option} {path}: the folder {folder} cannot be written to")


def check_new_output(path: Path, overwrite: bool, *endings: str) -> None:
    """Refuses a file that could not be written, or that is there and is not to be replaced.

    **Raises:** `typer.BadParameter` with the reason.
    """
    check_output(path, *endings)
    if path.exists() and not overwrite:
        raise typer.BadParameter(
            f"{path}: expected a new file, got an existing one; name another, or add --overwrite"
        )


def check_folder(path: Path | None) -> None:
    """Refuses a folder for `--out` that is a file.

    **Raises:** `typer.BadParameter`.
    """
    if path is not None and path.exists() and not path.is_dir():
        raise typer.BadParameter(f"--out {path}: expected a folder, got a file")


def make_folder(path: Path) -> None:
    """Makes the folder of `--out` where there is none.

    **Raises:** `typer.BadParameter` with the reason why it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"--out {path}: {error.strerror}") from None


def write_pictures(folder: Path, pictures: "Iterable[tuple[str, Figure | Axes]]") -> None:
    """Writes pictures, each a name without its ending and a figure, as PNG into the folder of
    `--out`. A name that is a path becomes the name of a file."""
    from ..plots import to_png

    make_folder(folder)
    for name, picture in pictures:
        file = folder / f"{name}.png".replace("/", "-")
        write_whole_file(file, to_png(picture), JaxtwinError)


def check_json(path: Path | None) -> None:
    """Checks the file of `--json` in the same way; - is standard output."""
    if path != STDOUT:
        check_output(path, ".json", option="--json")


def write_json(path: Path | None, numbers: object) -> None:
    """Writes numbers as JSON to a file or to standard output; nothing if the path is None. What is
    not finite becomes null."""
    if path is None:
        return
    from .._json_values import json_value  # which loads NumPy, that --help does without

    plain = json_value(numbers)
    text = json.dumps(plain, indent=2, ensure_ascii=False) + "\n"
    if path == STDOUT:
        encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
        is_writable = text.encode(encoding, "replace").decode(encoding) == text
        sys.stdout.write(text if is_writable else json.dumps(plain, indent=2) + "\n")
    else:
        write_whole_file(path, text.encode(), JaxtwinError)


def say(text: str, json_path: Path | None = None) -> None:
    """Prints text for a person: on standard error if standard output holds the JSON."""
    print(printable(text), file=sys.stderr if json_path == STDOUT else sys.stdout, flush=True)


def say_written(*paths: Path | None, json_path: Path | None = None) -> None:
    """Prints where the results are, as `say` does; nothing for files that were not asked for."""
    if written := [str(path) for path in paths if path is not None]:
        say(f"written to {', '.join(written)}", json_path)


def printable(text: str) -> str:
    """Removes control characters, which a terminal would obey, from text of unknown origin."""
    return "".join(letter if letter.isprintable() or letter == "\n" else "�" for letter in text)
