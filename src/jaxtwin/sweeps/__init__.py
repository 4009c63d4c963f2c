"""Long sweeps: millions of draws, written chunk by chunk to a Zarr store that survives a kill."""

from ._open import open_sweep
from ._progress_meter import SweepProgress
from ._sweep import Sweep, sweep

__all__ = ["Sweep", "SweepProgress", "open_sweep", "sweep"]
