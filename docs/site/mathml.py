r"""Equations as MathML, which browsers draw themselves: no script runs, and none is loaded.

Markdown's `$...$` and `$$...$$` arrive in the HTML between `\(...\)` and `\[...\]`.
"""

import html
import re
import shutil
from pathlib import Path

import ziamath
from latex2mathml.converter import convert

_EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\(?P<kind>[(\[])(?P<latex>.*?)\\[)\]]</(?P=tag)>',
    re.DOTALL,
)


# Bars that latex2mathml leaves to the browser, which would take each for the end of a norm.
_BAR = re.compile(r'<mo(?: stretchy="false")?>(&#x02016;|&#x0007C;)</mo>')

# Names of functions, which latex2mathml sets as operators with space on both sides.
_NAME = re.compile(r"<mo>([a-z]{2,})</mo>")

# Signs with space on both sides, which latex2mathml sets as names without any.
_SIGN = {"<mi>&#x000B1;</mi>": "<mo>&#x000B1;</mo>", "<mi>&#x0007E;</mi>": "<mo>&#x0223C;</mo>"}

# A prime is raised already, and too small to be seen as an exponent.
_PRIME_SIGN = '<mo form="postfix" lspace="0" rspace="0">&#x02032;</mo>'
_PRIME = re.compile(r"<msup>(<mi>[^<]*</mi>)<mi>&#x02032;</mi></msup>")


def rendered(page: str) -> str:
    """A page's HTML with its equations as MathML."""
    return _EQUATION.sub(_converted, page)


def copy_font(folder: Path) -> None:
    """STIX Two Math (SIL Open Font License), so that equations look alike everywhere."""
    fonts = Path(ziamath.__file__).parent / "fonts"
    (folder / "fonts").mkdir()
    shutil.copy(fonts / "STIXTwoMath-Regular.ttf", folder / "fonts")


def _converted(equation: re.Match[str]) -> str:
    display = "block" if equation["kind"] == "[" else "inline"
    mathml = convert(html.unescape(equation["latex"]).strip(), display=display)
    mathml = _BAR.sub(r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>', mathml)
    mathml = _NAME.sub(r"<mi>\1</mi>", mathml)
    for name, sign in _SIGN.items():
        mathml = mathml.replace(name, sign)
    mathml = _PRIME.sub(rf"<mrow>\1{_PRIME_SIGN}</mrow>", mathml)
    tag = equation["tag"]
    return f'<{tag} class="equation-{display}">{mathml}</{tag}>'
