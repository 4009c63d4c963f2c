"""The parts of a report, before they become a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final


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
