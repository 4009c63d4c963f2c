"""Long sweeps: millions of draws, written chunk by chunk to a Zarr store that survives a kill.

`_sweep` is the entry: it makes the plan (`_plan`), whose draws a seed determines (`_samples`), and
hands chunks to this process or to a cluster. A chunk that the store (`_store`, `_disk`) marks as
done is complete. `_open` reads the results when they are used, and `_progress_meter` reports.
"""

from ._open import open_sweep
from ._progress_meter import SweepProgress
from ._sweep import Sweep, sweep

__all__ = ["Sweep", "SweepProgress", "open_sweep", "sweep"]
