"""A twin and its rig in a notebook: sliders for its parameters, and the page of a rig that runs.

`Sliders` (`_sliders`) moves parameters and duty of a twin; `RigView` (`_rig_view`) shows a live or
replayed rig as `jaxtwin serve` does. Both compute beside the kernel's main thread: the first in a
thread for which only the newest request counts, the second in one that polls
the rig. What a browser draws is in `assets/`, and in those of `jaxtwin.serve`, whose modules
`_notebook_widget` joins to one that needs nothing else.

They are widgets of anywidget, the extra `widgets`: for JupyterLab, VS Code and marimo.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
