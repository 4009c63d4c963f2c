"""C for a microcontroller: models and controllers as C99 sources."""

from ._export_c import CSources, export_c

__all__ = ["CSources", "export_c"]
