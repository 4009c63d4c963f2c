"""Diagnosis of an installation: versions, devices, compilation cache, recordings, known traps."""

from ._examine import examine

__all__ = ["examine"]
