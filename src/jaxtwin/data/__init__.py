"""What comes with the package: rig files, module datasheets and the tables of the paper."""

from ._tables import Table as Table
from ._tables import table as table

__all__ = ["Table", "table"]
