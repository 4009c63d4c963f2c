"""A twin as an FMU, the Functional Mock-up Unit of other simulators."""

from ._export_fmu import FMU, export_fmu

__all__ = ["FMU", "export_fmu"]
