"""Long sweeps: millions of draws, written chunk by chunk to a Zarr store that survives a kill."""

from ._open import open_sweep
from ._parts import meet, own_part
from ._progress import Advance
from ._sweep import Sweep, sweep

__all__ = ["Advance", "Sweep", "meet", "open_sweep", "own_part", "sweep"]
