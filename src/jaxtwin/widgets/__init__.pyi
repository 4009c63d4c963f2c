# Public names of jaxtwin.widgets. `__init__.py` imports each when it is first used.

from ._rig_view import RigView as RigView
from ._sliders import Sliders as Sliders

__all__: list[str]
