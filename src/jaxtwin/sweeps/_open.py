"""The results of a sweep as an xarray dataset, which reads them when they are used."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool

from .._arguments import path_of
from ..errors import SimulationError
from ._disk import disk_errors
from ._store import read_identity

if TYPE_CHECKING:
    import xarray


def open_sweep(folder: str | os.PathLike[str]) -> "xarray.Dataset":
    """Opens the finished draws of a sweep as a dataset.

    The dataset is lazy: `open_sweep(...).cost.isel(draw=slice(100))` reads one chunk, `.load()`
    reads everything. If dask is installed, `.chunk()` makes dask arrays.

    **Arguments:**

    - `folder`: the folder of the sweep, which may still be running.

    **Returns:** a dataset with the dimensions draw, channel, recording and parameter. `sample`
    holds the parameters of each draw, drawn again from the seed; `value` holds the values around
    which they are drawn; `failed` marks draws without finite temperatures; the other variables are
    the reductions that the sweep kept. The coordinate `draw` is the number of a draw. The
    attributes count the draws that were requested, are finished, and failed.

    **Raises:** `SimulationError` if the folder does not hold a sweep.
    """
    place = path_of("open_sweep: folder", folder, SimulationError)
    identity = read_identity(place)
    with disk_errors(place):
        import xarray
        import zarr

        from ._samples import SampledParameters

        done = np.asarray(zarr.open_group(place, mode="r")["done"]).astype(bool)
        stored = xarray.open_zarr(place, consolidated=False, chunks=None, mask_and_scale=False)
    drawn, size, draws = identity["drawn"], identity["chunk_size"], identity["draws"]
    table = stored.drop_vars("done").assign(
        sample=(("draw", "parameter"), SampledParameters.of(identity)),
        value=("parameter", list(drawn.values())),
    )
    table = table.assign_coords(
        draw=np.arange(draws),
        channel=identity["channels"],
        recording=identity["recordings"],
        parameter=list(drawn),
    )
    if not done.all():
        table = table.isel(draw=np.flatnonzero(np.repeat(done, size)[:draws]))
    table.attrs = {name: identity[name] for name in ("rig", "spread", "seed", "draws")}
    return table.assign_attrs(done=table.sizes["draw"], failed=count_failed(place, done, size))


def count_failed(folder: Path, done: Bool[np.ndarray, " chunks"], size: int) -> int:
    """The number of failed draws in the finished chunks."""
    with disk_errors(folder):
        import zarr

        failed = zarr.open_group(folder, mode="r")["failed"]
        assert isinstance(failed, zarr.Array)
        return sum(
            int(np.count_nonzero(failed[chunk * size : (chunk + 1) * size]))
            for chunk in np.flatnonzero(done).tolist()
        )
