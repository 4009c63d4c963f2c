"""What jaxtwin runs on: versions, devices, compilation cache, recordings, known traps."""

from ._compilation_cache import cache_state, use_compilation_cache
from ._examine import examine

__all__ = ["cache_state", "examine", "use_compilation_cache"]
