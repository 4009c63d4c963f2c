"""The results of a sweep as an xarray data set, read when they are looked at."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool

from .._arguments import path_of
from .._errors import SimulationError
from ._disk import disk_errors
from ._store import read_identity

if TYPE_CHECKING:
    import xarray


def open_sweep(folder: str | os.PathLike[str]) -> "xarray.Dataset":
    """The draws of a sweep that are done so far.

    Nothing is read or made before it is asked for: `open_sweep(...).cost.isel(draw=slice(100))`
    reads one chunk, `.load()` everything. `.chunk()` makes dask arrays where dask is installed.

    **Arguments:**

    - `folder`: of the sweep, which may still be running.

    **Returns:** dims draw, channel, recording, parameter. `sample` are the parameters of each
    draw, made again from the seed; `value` is what they are drawn around; `failed` says which
    draws gave no finite temperatures; the rest is what the sweep kept. The coordinate `draw` is a
    draw's number. The attributes count the draws that were asked for, are done, and failed.

    **Raises:** `SimulationError` where the folder holds no sweep.
    """
    place = path_of("open_sweep: folder", folder, SimulationError)
    identity = read_identity(place)
    with disk_errors(place):
        import xarray
        import zarr

        from ._samples import Samples

        done = np.asarray(zarr.open_group(place, mode="r")["done"]).astype(bool)
        stored = xarray.open_zarr(place, consolidated=False, chunks=None, mask_and_scale=False)
    drawn, size, draws = identity["drawn"], identity["chunk_size"], identity["draws"]
    table = stored.drop_vars("done").assign(
        sample=(("draw", "parameter"), Samples.of(identity)),
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
    """How many draws of the chunks that are done failed."""
    with disk_errors(folder):
        import zarr

        failed = zarr.open_group(folder, mode="r")["failed"]
        assert isinstance(failed, zarr.Array)
        return sum(
            int(np.count_nonzero(failed[chunk * size : (chunk + 1) * size]))
            for chunk in np.flatnonzero(done).tolist()
        )
