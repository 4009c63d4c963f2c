"""Digital twins of thermal rigs: simulate, match to recordings, analyse, run beside the rig.

The public names are listed in `__init__.pyi`, one line each. A name is imported when it is first
used, so that `import jaxtwin` itself takes very little time. Importing changes no setting of JAX.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
