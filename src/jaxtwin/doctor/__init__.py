"""Diagnosis of an installation: versions, devices, compilation cache, recordings, known traps.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
