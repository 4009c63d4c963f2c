"""What the widgets of a notebook have in common: their module, and messages to all their views."""

import json
import re
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import traitlets

from .. import serve
from ..errors import JaxtwinError

# Joins the modules of a widget to one.
#
# A notebook loads a widget as one ECMAScript module, which can import no file beside it. The
# modules of the page are written so that they can stand one behind the other: they import only
# names, under their own names, and no two of them declare the same one.


PAGE = Path(serve.__path__[0]) / "assets"
OWN_SOURCE = Path(__file__).with_name("assets")
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:class|function|const) )", re.MULTILINE)
_EXPORTED = re.compile(r"^export \{[^}]*\};\n", re.MULTILINE)


@cache
def one_module(entry: str) -> str:
    """Returns the module `entry` of this package with all that it imports, uPlot, and the style
    sheets as a constant `STYLES`."""
    styles = [PAGE / "uplot" / "uPlot.min.css", PAGE / "page.css", OWN_SOURCE / "widgets.css"]
    text = "\n".join(file.read_text(encoding="utf-8") for file in styles)
    library = (PAGE / "uplot" / "uPlot.iife.min.js").read_text(encoding="utf-8")
    parts = [library, f"const STYLES = {json.dumps(text)};"]
    _add(entry, parts, set())
    return "\n".join(parts)


def _add(name: str, parts: list[str], added: set[str]) -> None:
    """Adds a module behind those that it imports."""
    added.add(name)
    own = OWN_SOURCE / f"{name}.js"
    text = (own if own.exists() else PAGE / own.name).read_text(encoding="utf-8")
    for other in _IMPORT.findall(text):
        if other not in added:
            _add(other, parts, added)
    parts.append(_EXPORT.sub("", _EXPORTED.sub("", _IMPORT.sub("", text))))


try:
    import anywidget
except ImportError as error:
    raise JaxtwinError(
        "jaxtwin.widgets: expected anywidget, which is not installed; pip install "
        "'jaxtwin[widgets]', in a checkout pip install -e '.[widgets]'"
    ) from error


class NotebookWidget(anywidget.AnyWidget):
    """A widget whose views are drawn by a module of `assets/`.

    A view that begins, such as that of a second cell, says "hello".

    **Arguments:**

    - `module`: the name of the module.
    """

    _esm = traitlets.Unicode().tag(sync=True)

    def __init__(self, module: str):
        super().__init__(_esm=one_module(module))
        self.on_msg(lambda _, content, buffers: self.on_request(content))

    @abstractmethod
    def on_request(self, content: Mapping[str, Any]) -> None:
        """Answers a view, whose request has a `kind`."""

    def show(self, kind: str, content: Any, buffers: Sequence[bytes] = ()) -> None:
        """Sends something to all views."""
        self.send({"kind": kind, "content": content}, buffers=list(buffers))
