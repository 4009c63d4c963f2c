"""The folder of a sweep: a Zarr store in which a chunk that is marked as done is complete.

A chunk of draws is one file in each array. These files are written first and forced to the disk.
Then a mark of one byte, the chunk's element of the array `done`, is moved to its place. If the
process stops in between, the chunk has no mark. It is then computed again and gives the same bytes,
because a draw is a function of its number.
"""

import json
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Bool, Shaped

from ..errors import SimulationError
from ._disk import disk_errors, lock, put, to_disk
from ._plan import ROLES, Plan

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


def _refuse_other(folder: Path, found: dict[str, Any], asked: dict[str, Any]) -> None:
    for key in (*asked, *found):
        if found.get(key) != asked.get(key):
            before, now = _difference(found.get(key), asked.get(key))
            raise SimulationError(
                f"{folder}: holds another sweep: {key}: expected {before}, as the sweep began, "
                f"got {now}; ask for the same or use another folder"
            )


def _difference(found: object, asked: object) -> tuple[str, str]:
    """Two different values as short text; for lists and tables, the first entries that differ."""
    if isinstance(found, list) and isinstance(asked, list) and len(found) == len(asked):
        return _difference(
            *next((old, new) for old, new in zip(found, asked, strict=True) if old != new)
        )
    if isinstance(found, dict) and isinstance(asked, dict):
        name = next(name for name in (*asked, *found) if found.get(name) != asked.get(name))
        return f"{name} = {found.get(name)}", f"{name} = {asked.get(name)}"
    return str(found), str(asked)
