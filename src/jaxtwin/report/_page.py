"""A report: its parts, the HTML page that they become, which needs no other file, and its folder,
which is written as a whole or not at all.
"""

import base64
import json
import os
import re
import shutil
import struct
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any, final

from ..doctor import examine
from ..errors import JaxtwinError


@final
@dataclass(frozen=True)
class Text:
    """A paragraph. Words between `backticks` are set as code."""

    text: str


@final
@dataclass(frozen=True)
class KeyNumbers:
    """Numbers that stand out: pairs of value and label."""

    entries: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class ReportTable:
    """A table. Cells that begin with ! are marked, without the sign."""

    caption: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@final
@dataclass(frozen=True)
class ReportPicture:
    """A picture: its file name without ending, its content, and its caption."""

    name: str
    png: bytes
    caption: str


Block = Text | KeyNumbers | ReportTable | ReportPicture


@final
@dataclass(frozen=True)
class Section:
    """A section of the page: its title and its contents; `level` 3 is a subsection."""

    title: str
    blocks: tuple[Block, ...]
    level: int = 2


# A line in every page, by which a report of jaxtwin is recognised.
GENERATOR = '<meta name="generator" content="jaxtwin">'

# The largest number of characters of a cell that is not broken into lines.
MAX_UNBROKEN = 16

_NUMBER_TEXT = r"[-+−]?[\d  ]*\.?\d+(e[-+]?\d+)?( ?[%KsW])?"
_NUMBER = re.compile(rf"!?{_NUMBER_TEXT}|{_NUMBER_TEXT} to {_NUMBER_TEXT}|unknown|!?-|")


def page_html(title: str, lead: Sequence[Block], sections: Sequence[Section], foot: str) -> str:
    """Returns the page as HTML.

    **Arguments:**

    - `title`: the title of the page.
    - `lead`: the text above the list of contents.
    - `sections`: the sections in their order.
    - `foot`: the last line.

    **Returns:** HTML with style and pictures inside.
    """
    style = (resources.files("jaxtwin") / "report" / "page.css").read_text(encoding="utf-8")
    contents = "".join(
        f'<li><a href="#{_anchor(section)}">{escape(section.title)}</a></li>'
        for section in sections
        if section.level == 2
    )
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        GENERATOR,
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>",
        f"<style>\n{style}</style></head><body><main>",
        f"<h1>{escape(title)}</h1>",
        *map(_block, lead),
        f"<nav><ul>{contents}</ul></nav>",
        *map(_section, sections),
        f"<footer>{_inline(foot)}</footer></main></body></html>",
    ]
    return "\n".join(parts) + "\n"


def _section(section: Section) -> str:
    heading = f"<h{section.level}>{escape(section.title)}</h{section.level}>"
    blocks = "\n".join(map(_block, section.blocks))
    return f'<section id="{_anchor(section)}">{heading}\n{blocks}</section>'


def _block(block: Block) -> str:
    match block:
        case Text():
            return f"<p>{_inline(block.text)}</p>"
        case KeyNumbers():
            entries = "".join(
                f"<div><dt>{_inline(label)}</dt><dd>{escape(value)}</dd></div>"
                for value, label in block.entries
            )
            return f"<dl>{entries}</dl>"
        case ReportTable():
            return _table(block)
        case ReportPicture():
            return _picture(block)


def _picture(picture: ReportPicture) -> str:
    """A figure that a click shows at its true size over the whole window, and another click hides.

    The style sheet does this by `:target`, so that the page needs no script and contains each
    picture once.
    """
    data = base64.b64encode(picture.png).decode()
    width, height = struct.unpack(">II", picture.png[16:24])  # of the PNG's first chunk
    name, alt = escape(picture.name), escape(picture.caption)
    return (
        f'<div id="at-{name}"><figure id="{name}" style="--pixels: {width}">'
        f'<a class=close href="#at-{name}">close</a>'
        f'<a class=picture href="#{name}" title="enlarge">'
        f'<img src="data:image/png;base64,{data}" alt="{alt}" width={width} height={height}></a>'
        f"<figcaption>{_inline(picture.caption)}</figcaption></figure></div>"
    )


def _table(table: ReportTable) -> str:
    # A column of numbers and its heading are aligned to the right.
    right = [
        all(_NUMBER.fullmatch(row[column]) for row in table.rows)
        for column in range(len(table.head))
    ]
    # An empty cell heads nothing.
    head = "".join(
        _cell("th" if text else "td", text, r) for text, r in zip(table.head, right, strict=True)
    )
    head = f"<thead><tr>{head}</tr></thead>" if any(table.head) else ""
    rows = "".join(
        "<tr>" + "".join(_cell("td", text, r) for text, r in zip(row, right, strict=True)) + "</tr>"
        for row in table.rows
    )
    return (
        f"<div class=table tabindex=0><table><caption>{_inline(table.caption)}</caption>"
        f"{head}<tbody>{rows}</tbody></table></div>"
    )


def _cell(tag: str, text: str, right: bool) -> str:
    style = " class=n" if right else " class=short" if len(text) <= MAX_UNBROKEN else ""
    marked = text.startswith("!")
    content = f"<mark>{_inline(text[1:])}</mark>" if marked else _inline(text)
    return f"<{tag}{style}>{content}</{tag}>"


def _inline(text: str) -> str:
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))


def _anchor(section: Section) -> str:
    return re.sub(r"\W+", "-", section.title.lower()).strip("-")


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


def files_table(files: dict[str, str]) -> ReportTable:
    """The files beside the page.

    **Arguments:**

    - `files`: name -> contents.
    """
    return ReportTable("Files beside this page.", ("file", "what it holds"), list(files.items()))


def environment_section(wall_time: float) -> Section:
    """Versions, devices and settings.

    **Arguments:**

    - `wall_time`: the computing time of the whole report so far, s.
    """
    tables = tuple(
        ReportTable(section[0].upper() + section[1:] + ".", ("", ""), list(entries.items()))
        for section, entries in examine().items()
    )
    return Section(
        "Environment",
        (Text(f"This report took {wall_time:.0f} s. `jaxtwin doctor` prints this list:"), *tables),
    )
