"""Diagnosis of an installation: versions, devices, compilation cache, recordings, known traps."""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
