"""Where lines may break: not between a number and its unit, but inside long code of a table."""

import re

_UNITS = (
    "%|°C|degC|K|mK|K/W|W/K|K/s|J/K|V/K|W|kW|J|kJ|V|A|mA|Ω|ohm|s|ms|µs|min|h|Hz|kHz|mm|cm|m|"
    "kB|MB|MiB|GiB"
)
_NUMBER = re.compile(rf"(?<=\d) (?=(?:{_UNITS})(?![\w/²³^])|\d{{3}}(?!\d))")
_TAG = re.compile(r"(<[^>]+>)")
_VERBATIM = ("pre", "code", "script", "style", "math")

LONG = 32
"""Characters of code that a table's column may be as wide as."""

_CELL = re.compile(r"<td[^>]*>.*?</td>", re.DOTALL)
_CODE = re.compile(r"<code>(?=((?:[^<]|<(?!/code>))*)</code>)")


def set_breaks(page: str) -> str:
    """A page's HTML with no-break spaces in `20 s` and `10 000`, and with the class `long` where
    code in a table's cell has more than `LONG` characters."""
    page = _CELL.sub(lambda cell: _CODE.sub(_of_length, cell[0]), page)
    parts, inside = [], 0
    for part in _TAG.split(page):
        if part.startswith("<"):
            name = part.strip("</> ").split(maxsplit=1)[0].lower()
            if name in _VERBATIM:
                inside += -1 if part.startswith("</") else 1
        elif not inside:
            part = _NUMBER.sub("\N{NO-BREAK SPACE}", part)
        parts.append(part)
    return "".join(parts)


def _of_length(code: re.Match[str]) -> str:
    return '<code class="long">' if len(_TAG.sub("", code[1])) > LONG else code[0]
