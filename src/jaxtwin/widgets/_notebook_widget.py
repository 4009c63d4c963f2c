"""What the widgets of a notebook have in common: their module, and messages to all their views."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import traitlets

from ..errors import JaxtwinError
from ._one_module import one_module

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
