# Public names of jaxtwin.c_export. `__init__.py` imports each when it is first used.

from ._export_c import CSources as CSources
from ._export_c import export_c as export_c
