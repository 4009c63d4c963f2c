# Public names of jaxtwin.fmu. `__init__.py` imports each when it is first used.

from ._export_fmu import FMU as FMU
from ._export_fmu import export_fmu as export_fmu
