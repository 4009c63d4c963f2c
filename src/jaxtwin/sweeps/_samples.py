"""The parameters of a sweep's draws as a lazy array, drawn again from the seed when it is read."""

from typing import Any, final

import numpy as np
from xarray.backends import BackendArray
from xarray.core.indexing import (
    ExplicitIndexer,
    IndexingSupport,
    LazilyIndexedArray,
    explicit_indexing_adapter,
)

from ..sensitivity_analysis._sampling import normal_draws


@final
class SampledParameters(BackendArray):
    """The parameters of a sweep's draws, `(draws, parameters)`, drawn from its seed.

    **Arguments:**

    - `identity`: the identity of the sweep, as in `Plan.identity`.
    """

    def __init__(self, identity: dict[str, Any]):
        self.identity = identity
        self.shape = (identity["draws"], len(identity["drawn"]))
        self.dtype = np.dtype(float)

    @classmethod
    def of(cls, identity: dict[str, Any]) -> LazilyIndexedArray:
        """Wraps the array as xarray expects it."""
        return LazilyIndexedArray(cls(identity))

    def __getitem__(self, key: ExplicitIndexer) -> np.ndarray:
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self._make)

    def _make(self, key: tuple[int | slice, int | slice]) -> np.ndarray:
        rows, columns = key
        wanted = np.arange(self.shape[0])[rows] if isinstance(rows, slice) else np.array(rows)
        start, stop = (wanted.min(), wanted.max() + 1) if wanted.size else (0, 1)
        drawn, seed = self.identity["drawn"], self.identity["seed"]
        draws = normal_draws(drawn, self.identity["spread"], seed, int(stop), int(start))
        return np.column_stack(list(draws.values()))[wanted - start][..., columns]
