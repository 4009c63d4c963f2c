# Public names of jaxtwin.sweeps. `__init__.py` imports each when it is first used.

from ._store import open_sweep as open_sweep
from ._sweep import Sweep as Sweep
from ._sweep import SweepProgress as SweepProgress
from ._sweep import sweep as sweep
