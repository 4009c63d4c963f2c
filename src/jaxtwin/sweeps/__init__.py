"""Long sweeps: millions of draws, written chunk by chunk to a Zarr store that survives a kill.

`_sweep` is the entry: it reports its progress, makes the plan (`_plan`), whose draws a seed
determines, and hands chunks to this process or to a cluster. A chunk that the store
(`_store`) marks as done is complete; results are read when they are used.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
