# Public names of jaxtwin.spice. `__init__.py` imports each when it is first used.

from ._to_spice import to_spice as to_spice
