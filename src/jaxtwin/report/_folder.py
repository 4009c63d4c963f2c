"""The folder of a report, which is written as a whole or not at all."""

import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import JaxtwinError
from ._blocks import ReportPicture, Section
from ._page import GENERATOR

PAGE = "index.html"


def check_folder(folder: Path) -> None:
    """Refuses a folder that a report must not replace, or that cannot be made.

    **Raises:** `JaxtwinError` if the folder contains something else, or its parent cannot be
    written to.
    """
    if folder.exists() and not _replaceable(folder):
        raise JaxtwinError(
            f"{folder}: expected a new or empty folder, or an older report of jaxtwin, got "
            "something else; choose another folder"
        )
    parent = folder.absolute().parent
    if not (parent.is_dir() and os.access(parent, os.W_OK)):
        raise JaxtwinError(
            f"{folder}: expected a folder {parent} that can be written to, got none; make it, or "
            "choose another"
        )


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yields a temporary folder, which becomes `folder` when the block ends without an error.

    **Arguments:**

    - `folder`: the folder of the report. An older report there is replaced.

    **Raises:** the errors of `check_folder`.
    """
    check_folder(folder)
    place = folder.absolute()
    part = place.with_name(f".{place.name}.{uuid.uuid4().hex}.part")
    old = part.with_suffix(".old")
    try:
        part.mkdir()
        yield part
        check_folder(folder)  # it may have changed in the meantime
        if place.exists():
            place.rename(old)
        part.rename(place)
    except OSError as error:
        raise JaxtwinError(f"{folder}: cannot be written: {error.strerror}") from None
    finally:
        if old.exists() and not place.exists():
            old.rename(place)
        for left in (part, old):
            shutil.rmtree(left, ignore_errors=True)


def write_page(
    folder: Path, page: str, sections: Sequence[Section], numbers: Mapping[str, Any]
) -> None:
    """Writes the page, its numbers as `numbers.json`, and each of its pictures as a file.

    **Arguments:**

    - `folder`: an existing folder.
    - `page`: the page as HTML.
    - `sections`: the sections of the page.
    - `numbers`: the numbers in plain types; infinite and missing numbers are None.
    """
    (folder / PAGE).write_text(page, encoding="utf-8")
    text = json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "numbers.json").write_text(text + "\n", encoding="utf-8")
    for section in sections:
        for block in section.blocks:
            if isinstance(block, ReportPicture):
                (folder / f"{block.name}.png").write_bytes(block.png)


def _replaceable(folder: Path) -> bool:
    if folder.is_symlink() or not folder.is_dir():
        return False
    if not any(folder.iterdir()):
        return True
    try:
        with (folder / PAGE).open(encoding="utf-8") as page:
            return GENERATOR in page.read(2000)
    except (OSError, UnicodeDecodeError):
        return False
