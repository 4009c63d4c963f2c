# Public names of jaxtwin.doctor. `__init__.py` imports each when it is first used.

from ._examine import examine as examine
