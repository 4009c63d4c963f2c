"""The folder of a sweep: a Zarr store in which a chunk that is marked as done is complete.

A chunk of draws is one file in each array. These files are written first and forced to the disk.
Then a mark of one byte, the chunk's element of the array `done`, is moved to its place. If the
process stops in between, the chunk has no mark. It is then computed again and gives the same bytes,
because a draw is a function of its number.
"""

import json
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Bool, Shaped
from xarray.backends import BackendArray
from xarray.core.indexing import (
    ExplicitIndexer,
    IndexingSupport,
    LazilyIndexedArray,
    explicit_indexing_adapter,
)

from .._arguments import path_of
from ..errors import SimulationError
from ..sensitivity_analysis._sampling import normal_draws
from ._plan import ROLES, Plan

if TYPE_CHECKING:
    import xarray


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


try:
    import fcntl
except ImportError:  # not on Windows: two processes may then do the same work, with one result
    fcntl = None


# The attribute of the store that holds the identity of the sweep.
KEY = "jaxtwin_sweep"

# A chunk key format with a single folder for each array, so that fewer names are forced to the
# disk.
KEYS: Any = {"name": "v2", "separator": "."}


@final
class Store:
    """The folder of a sweep, opened for writing.

    **Arguments:**

    - `folder`: the folder. A missing or empty folder is filled.
    - `plan`: the plan of the sweep.

    **Raises:** `SimulationError` if the folder holds something else or cannot be made.
    """

    def __init__(self, folder: Path, plan: Plan):
        self.folder = folder
        self.plan = plan
        self.arrays = ("failed", *plan.reductions)
        with disk_errors(folder):
            if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
                _create(folder, plan)
        _refuse_other(folder, read_identity(folder), plan.identity)

    def finished_chunks(self) -> Bool[np.ndarray, " chunks"]:
        """Whether each chunk is finished."""
        return np.array([self.is_finished(chunk) for chunk in range(self.plan.chunks)])

    def is_finished(self, chunk: int) -> bool:
        """Whether a chunk is marked, and its files are still there."""
        return all(self._file(name, chunk).exists() for name in ("done", *self.arrays))

    def write(
        self, chunk: int, results: Mapping[str, Shaped[np.ndarray, "draws *columns"]]
    ) -> None:
        """Writes the results of a chunk, and then its mark.

        **Raises:** `SimulationError` if they cannot be written.
        """
        import zarr

        start, stop = self.plan.span(chunk)
        with disk_errors(self.folder), zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(self.folder, mode="r+")
            for name in self.arrays:
                file = self._file(name, chunk)
                for torn in file.parent.glob(f"{chunk}.*.partial"):
                    torn.unlink()  # a temporary file that zarr left when a process was killed
                array = group[name]
                assert isinstance(array, zarr.Array)
                array[start:stop] = results[name]
                to_disk(file)
            put(self._file("done", chunk), b"\x01")

    @contextmanager
    def claim(self, chunks: Iterable[int]) -> Iterator[list[int]]:
        """Locks chunks for this process while the block runs, and yields those that no other
        process has locked.

        A process may hold only one claim at a time, because all its locks end with the first claim.
        """
        with disk_errors(self.folder):
            file = (self.folder / "done" / "claims").open("ab")
        with file:
            yield [chunk for chunk in chunks if lock(file, chunk)]

    def _file(self, name: str, chunk: int) -> Path:
        """The file of a chunk in an array, named by its key in the Zarr format."""
        return self.folder / name / (f"{chunk}" if name in ("done", "failed") else f"{chunk}.0")


def read_identity(folder: Path) -> dict[str, Any]:
    """Reads the identity of the sweep that a folder holds.

    **Raises:** `SimulationError` if the folder does not hold a sweep.
    """
    try:
        identity = json.loads((folder / "zarr.json").read_bytes())["attributes"][KEY]
        if not isinstance(identity, dict):
            raise TypeError
    except (OSError, ValueError, TypeError, KeyError):
        raise SimulationError(
            f"{folder}: expected the folder of a sweep, an empty or a new one, got another; "
            "choose another folder"
        ) from None
    return identity


def _create(folder: Path, plan: Plan) -> None:
    """Makes the store under another name and renames it, so that it is never incomplete."""
    import zarr

    part = folder.absolute().with_name(f".{folder.name}.{uuid.uuid4().hex}.part")
    part.parent.mkdir(parents=True, exist_ok=True)
    try:
        group = zarr.create_group(part, attributes={KEY: plan.identity})
        for name in ("failed", *plan.reductions):
            dim, units = ROLES[name]
            columns = {"channel": (len(plan.channels),), "recording": (len(plan.recordings),)}
            row = columns.get(dim, ())
            group.create_array(
                name,
                shape=(plan.draws, *row),
                chunks=(plan.chunk_size, *row),
                dtype="bool" if name == "failed" else plan.precision,
                fill_value=True if name == "failed" else float("nan"),
                chunk_key_encoding=KEYS,
                dimension_names=["draw", dim] if row else ["draw"],
                attributes={"units": units} if units else {},
            )
        group.create_array(
            "done",
            shape=(plan.chunks,),
            chunks=(1,),
            dtype="uint8",
            fill_value=0,
            chunk_key_encoding=KEYS,
            compressors=None,  # a mark is one byte
            dimension_names=["chunk"],
        )
        for file in part.rglob("*"):
            to_disk(file)
        try:
            part.rename(folder)
            to_disk(folder)
        except OSError:
            if not (folder / "zarr.json").exists():
                raise
            # Another process was quicker; whether it does the same sweep is checked next.
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _refuse_other(folder: Path, stored: dict[str, Any], asked: dict[str, Any]) -> None:
    for key in (*asked, *stored):
        if stored.get(key) != asked.get(key):
            before, now = _difference(stored.get(key), asked.get(key))
            raise SimulationError(
                f"{folder}: holds another sweep: {key}: expected {before}, as the sweep began, "
                f"got {now}; ask for the same or use another folder"
            )


def _difference(stored: object, asked: object) -> tuple[str, str]:
    """Two different values as short text; for lists and tables, the first entries that differ."""
    if isinstance(stored, list) and isinstance(asked, list) and len(stored) == len(asked):
        return _difference(
            *next((old, new) for old, new in zip(stored, asked, strict=True) if old != new)
        )
    if isinstance(stored, dict) and isinstance(asked, dict):
        name = next(name for name in (*asked, *stored) if stored.get(name) != asked.get(name))
        return f"{name} = {stored.get(name)}", f"{name} = {asked.get(name)}"
    return str(stored), str(asked)


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

        from ._store import SampledParameters

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


def put(file: Path, content: bytes) -> None:
    """Writes a file completely or not at all, even if the power fails meanwhile.

    Only one process at a time may write a given file.
    """
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content)
    _sync(part)
    part.replace(file)
    _sync(file.parent)


def to_disk(file: Path) -> None:
    """Forces a file and its entry in the folder to the disk."""
    _sync(file)
    _sync(file.parent)


def lock(file: IO[bytes], byte: int) -> bool:
    """Locks one byte of an open file until it is closed. Returns False if another process holds the
    lock."""
    if fcntl is None:
        return True
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # a file system without locks is like Windows
    return True


@contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turns an error of the disk, or a missing library, into an error that names the folder.

    **Raises:** `SimulationError` for any of them.
    """
    try:
        yield
    except ImportError:
        raise SimulationError(
            "a sweep's results are kept by zarr, which is not installed: "
            "pip install 'jaxtwin[storage]', in a checkout pip install -e '.[storage]'"
        ) from None
    except OSError as problem:
        raise SimulationError(f"{folder}: {problem.strerror or problem}") from None


def _sync(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # folders cannot be opened there
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
