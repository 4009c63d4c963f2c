"""Digital twins of thermal rigs: simulate, match to recordings, analyse, run beside the rig.

The public names are listed in `__init__.pyi`, one line each. A name is imported when it is first
used, so that `import jaxtwin` itself takes very little time. Importing changes no setting of JAX.
"""

import lazy_loader

__version__ = "0.1.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    try:
        return _load(name)
    except AttributeError:
        if name in __all__:  # an error of the module behind it
            raise
        from ._name_suggestions import did_you_mean

        hint = did_you_mean([name], __all__)
        raise AttributeError(f"module 'jaxtwin' has no attribute {name!r}{hint}") from None
