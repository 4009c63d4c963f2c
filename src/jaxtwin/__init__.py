"""Digital twins of multizone thermoelectric rigs: simulate, match to recordings, analyse.

The public names stand in `__init__.pyi`, one line each, and are imported when they are first used,
so that `import jaxtwin` itself costs next to nothing. Importing changes no setting of JAX.
"""

import sys
from types import ModuleType

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _PublicNamesFirst(ModuleType):
    """Keeps a public name from being hidden by the subpackage of the same name.

    Importing `jaxtwin.sensitivity` would set the attribute `sensitivity` to the package, and
    `jaxtwin.sensitivity(...)` would depend on what was imported before.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in __all__ and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _PublicNamesFirst
