"""Simulation: one run or many draws.

The default solver is exponential time differencing in the modes of the thermal network on a time
grid that is fine after each input change; any diffrax solver can take its place.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
