"""Where lines may break: not between a number and its unit, after the hyphens of `--out` or before
the comma behind an equation, but inside long code of a table and after the dots of a long name, and
how narrow a column of a table may become."""

import re

_UNITS = (
    "%|°C|degC|K|mK|K/W|W/K|K/s|J/K|V/K|W|kW|J|kJ|V|A|mA|Ω|ohm|s|ms|µs|min|h|Hz|kHz|mm|cm|m|"
    "kB|MB|MiB|GiB"
)
_NUMBER = re.compile(rf"(?<=\d) (?=(?:{_UNITS})(?![\w/²³^])|\d{{3}}(?!\d))")
_WHOLE = r'<span class="whole">\g<0></span>'
_TAG = re.compile(r"(<[^>]+>)")
_VERBATIM = ("pre", "code", "script", "style", "math", "title")
_UNBROKEN = re.compile(
    r"\d[\d.]*e-\d+"  # 1e-6
    r"|(?<![\w-])\w*[A-Za-z]\w*-\d[\w-]*(?:\.\d[\w-]*)*"  # TEC1-12706
    r"|(?<![\w-])--[a-z][\w-]*|-(?:>|&gt;)"  # --out, ->
)
_EQUATION = re.compile(
    r'([(\[]?)(<span class="equation-inline">(?:[^<]|<(?!/math>))*</math></span>)([.,;:)\]]*)'
)
_HYPHENATED = re.compile(r"(?<![\w.-])(?=[\w.-]{2,24}(?![\w.-]))[\w.]*-[\w.-]*\w")

LONG = 32
"""Characters of code that a table's column may be as wide as, and which fit a phone."""

NAME = 20
"""Characters of a name in a heading, from which it may break after its dots."""

PROSE = 40
"""Characters of a cell's text from which its column explains something, and is not squeezed."""

_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_ROW = re.compile(r"<tr[^>]*>.*?</tr>", re.DOTALL)
_ENTRY = re.compile(r"<(t[hd])([^>]*)>(.*?)</\1>", re.DOTALL)
_CELL = re.compile(r"<td[^>]*>.*?</td>", re.DOTALL)
_HEADING = re.compile(r"<h[1-6][ >].*?</h[1-6]>", re.DOTALL)
_NAME = re.compile(rf"[A-Za-z][\w.]{{{NAME - 1},}}")
_LONG = re.compile(rf"\S{{{LONG + 1},}}")
_WITHIN = re.compile(r"(?:(?<=[,(=])|(?<=[A-Za-z_][./]))(?=[^\s.,/()=]{4})")
_CODE = re.compile(r"<code>(?=((?:[^<]|<(?!/code>))*)</code>)")


def set_breaks(page: str) -> str:
    """A page's HTML with no-break spaces in `20 s` and `10 000`, and the class `whole` around what
    would break after a hyphen: `1e-6` or `TEC1-12706` in text, `--out` or `dual-cell` in inline
    code; also around an equation with its comma. Long names may break after their dots, which
    `<wbr>` says. Code in a table's cell with more than `LONG` characters gets the class `long`,
    cells of columns with more than `PROSE` characters in one of them the class `prose`."""
    page = _EQUATION.sub(_with_its_marks, page)
    page = _HEADING.sub(_with_names, page)
    page = _TABLE.sub(_of_columns, page)
    page = _CELL.sub(lambda cell: _CODE.sub(_of_length, cell[0]), page)
    parts: list[str] = []
    inside: list[str] = []
    for part in _TAG.split(page):
        if part.startswith("<"):
            name = part.strip("</> ").split(maxsplit=1)[0].lower()
            if name in _VERBATIM and part.startswith("</"):
                inside.pop()
            elif name in _VERBATIM:
                inside.append(name)
        elif inside == ["code"]:
            part = _LONG.sub(lambda long: _WITHIN.sub("<wbr>", long[0]), part)
            part = _HYPHENATED.sub(_WHOLE, part)
        elif not inside:
            part = _NUMBER.sub("\N{NO-BREAK SPACE}", part)
            part = _UNBROKEN.sub(_WHOLE, part)
        parts.append(part)
    return "".join(parts)


def _with_its_marks(equation: re.Match[str]) -> str:
    marked = equation[1] or equation[3]
    return f'<span class="whole">{equation[0]}</span>' if marked else equation[0]


def _with_names(heading: re.Match[str]) -> str:
    parts = _TAG.split(heading[0])
    return "".join(p if p.startswith("<") else _NAME.sub(_with_breaks, p) for p in parts)


def _with_breaks(name: re.Match[str]) -> str:
    """`<wbr>` after each dot, and after the underscores of a part that fills a line."""
    parts = [p.replace("_", "_<wbr>") if len(p) > 26 else p for p in name[0].split(".")]
    return ".<wbr>".join(parts)


def _of_length(code: re.Match[str]) -> str:
    return '<code class="long">' if len(_TAG.sub("", code[1])) > LONG else code[0]


def _of_columns(table: re.Match[str]) -> str:
    rows = [_ENTRY.findall(row) for row in _ROW.findall(table[0])]
    prose = {
        column
        for row in rows
        for column, (tag, _, content) in enumerate(row)
        if tag == "td" and len(_TAG.sub("", content)) > PROSE
    }

    def marked(row: re.Match[str]) -> str:
        columns = iter(range(len(rows[0]) + 1))

        def entry(found: re.Match[str]) -> str:
            is_prose = next(columns, None) in prose and found[1] == "td"
            kind = ' class="prose"' if is_prose else ""
            return f"<{found[1]}{found[2]}{kind}>{found[3]}</{found[1]}>"

        return _ENTRY.sub(entry, row[0])

    return _ROW.sub(marked, table[0])
