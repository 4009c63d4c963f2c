"""A report as a single HTML page that needs no other file."""

import base64
import re
import struct
from collections.abc import Sequence
from html import escape
from importlib import resources

from ._blocks import Block, KeyNumbers, ReportPicture, ReportTable, Section, Text

# A line in every page, by which a report of jaxtwin is recognised.
GENERATOR = '<meta name="generator" content="jaxtwin">'

SHORT = 16  # the most characters of a cell that is not broken into lines

_ONE = r"[-+−]?[\d  ]*\.?\d+(e[-+]?\d+)?( ?[%KsW])?"
_NUMBER = re.compile(rf"!?{_ONE}|{_ONE} to {_ONE}|unknown|!?-|")


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
    head = "".join(_cell("th", text, r) for text, r in zip(table.head, right, strict=True))
    head = f"<thead><tr>{head}</tr></thead>" if any(table.head) else ""
    rows = "".join(
        "<tr>" + "".join(_cell("td", text, r) for text, r in zip(row, right, strict=True)) + "</tr>"
        for row in table.rows
    )
    return (
        f"<div class=table><table><caption>{_inline(table.caption)}</caption>"
        f"{head}<tbody>{rows}</tbody></table></div>"
    )


def _cell(tag: str, text: str, right: bool) -> str:
    style = " class=n" if right else " class=short" if len(text) <= SHORT else ""
    marked = text.startswith("!")
    content = f"<mark>{_inline(text[1:])}</mark>" if marked else _inline(text)
    return f"<{tag}{style}>{content}</{tag}>"


def _inline(text: str) -> str:
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))


def _anchor(section: Section) -> str:
    return re.sub(r"\W+", "-", section.title.lower()).strip("-")
