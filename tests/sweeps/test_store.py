"""What a sweep's folder promises: no draw lost, none done twice, nobody else's folder touched."""

import json
import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Experiment, Twin, load_rig
from jaxtwin.errors import SimulationError
from jaxtwin.sweeps import _plan, _store, sweep
from jaxtwin.sweeps._store import put, read_identity, to_disk

REDUCTIONS = ("final", "plate_range")
FORKED = ProcessPoolExecutor(mp_context=multiprocessing.get_context("fork"))
ASKED: dict[str, Any] = {"draws": 20, "chunk_size": 8, "reductions": REDUCTIONS}


class PowerCutError(Exception):
    """Stops a sweep where a kill would."""


def test_each_chunk_is_one_file_an_array_and_a_mark_of_one_byte(
    stored, tmp_path, twin, experiment, engine
):
    """Zarr format 3: a chunk is named by its coordinates with a dot between them."""
    sweep(twin, experiment, tmp_path, **ASKED)
    files = stored(tmp_path)
    for chunk in range(3):
        assert files[f"done/{chunk}"] == b"\x01"
        assert {f"failed/{chunk}", f"final/{chunk}.0", f"plate_range/{chunk}.0"} <= set(files)
    group = zarr.open_group(tmp_path, mode="r")
    drawn = np.concatenate(engine.given)
    assert np.array_equal(np.asarray(group["final"])[:, 0], drawn)
    assert np.array_equal(np.asarray(group["plate_range"])[:, 0], np.sqrt(drawn))
    assert np.array_equal(np.asarray(group["failed"]), drawn > 2.8)


@pytest.mark.slow
def test_stopped_at_any_write_it_ends_as_if_it_had_not_been(
    stored, tmp_path, twin, experiment, engine, monkeypatch
):
    """The sweep is stopped at its first write to the disk, the second, ..., and run again.

    Every order of events on the disk is then seen: whole files without a mark, marks not yet in
    their place, a store half made.
    """
    sweep(twin, experiment, tmp_path / "whole", **ASKED)
    whole = stored(tmp_path / "whole")
    fsync, point = os.fsync, 0
    while True:
        folder = tmp_path / str(point)
        left = point

        def failing(handle: int) -> None:
            nonlocal left
            if left == 0:
                raise PowerCutError
            left -= 1
            fsync(handle)

        monkeypatch.setattr(os, "fsync", failing)
        try:
            sweep(twin, experiment, folder, **ASKED)
            break
        except PowerCutError:
            monkeypatch.setattr(os, "fsync", fsync)
        marked = sum((folder / "done" / f"{chunk}").exists() for chunk in range(3))
        engine.given.clear()
        result = sweep(twin, experiment, folder, **ASKED)
        assert len(engine.given) == 3 - marked, "a chunk with a mark is not done again"
        assert result.complete
        assert stored(folder) == whole
        point += 1
    assert point > 20


def test_a_file_and_its_entry_in_the_folder_are_forced_to_the_disk(tmp_path, monkeypatch):
    """A file that has been replaced is found after a power cut if its folder was synced after
    that (POSIX, fsync)."""
    synced = []

    def noted(handle: int) -> None:
        state = os.fstat(handle)
        synced.append((state.st_ino, sorted(file.name for file in tmp_path.iterdir())))

    monkeypatch.setattr(os, "fsync", noted)
    put(tmp_path / "mark", b"done")
    file, folder = (tmp_path / "mark").stat().st_ino, tmp_path.stat().st_ino
    assert synced == [(file, [".mark.part"]), (folder, ["mark"])]
    synced.clear()
    to_disk(tmp_path / "mark")
    assert synced == [(file, ["mark"]), (folder, ["mark"])]


def test_a_marked_chunk_whose_file_is_gone_is_done_again(
    stored, tmp_path, twin, experiment, engine
):
    sweep(twin, experiment, tmp_path, **ASKED)
    whole = stored(tmp_path)
    (tmp_path / "final" / "1.0").unlink()
    assert sweep(twin, experiment, tmp_path, **ASKED).new == 8
    assert stored(tmp_path) == whole


def test_what_a_killed_writer_left_beside_a_chunk_is_cleared_away(
    tmp_path, twin, experiment, engine
):
    """Zarr writes to NAME.RANDOM.partial first; a kill leaves that."""
    sweep(twin, experiment, tmp_path, **ASKED)
    (tmp_path / "done" / "1").unlink()
    torn = tmp_path / "final" / "1.4f3a.partial"
    torn.write_bytes(b"half a chu")
    sweep(twin, experiment, tmp_path, **ASKED)
    assert not torn.exists()


OTHERS = {
    "draws": {"draws": 21},
    "seed": {"seed": 1},
    "spread": {"spread": 0.1},
    "chunk_size": {"chunk_size": 4},
    "precision": {"precision": "float32"},
    "reductions": {"reductions": ["final"]},
    "drawn": {"names": ["R_E", "R_pc"]},
}


@pytest.mark.parametrize("key", OTHERS)
def test_another_sweep_is_refused_before_any_work(stored, tmp_path, twin, experiment, engine, key):
    sweep(twin, experiment, tmp_path, **ASKED)
    before = stored(tmp_path)
    engine.given.clear()
    with pytest.raises(SimulationError, match=f"holds another sweep: {key}: expected .*, got"):
        sweep(twin, experiment, tmp_path, **ASKED | OTHERS[key])
    assert engine.given == []
    assert stored(tmp_path) == before


def test_other_values_rigs_recordings_and_formats_are_refused(
    tmp_path, twin, experiment, engine, monkeypatch
):
    """Whatever the results depend on is part of what a folder belongs to."""
    sweep(twin, experiment, tmp_path, **ASKED)

    def refused(key: str, twin: Twin = twin, experiment: Experiment = experiment) -> None:
        with pytest.raises(SimulationError, match=f"holds another sweep: {key}"):
            sweep(twin, experiment, tmp_path, **ASKED)

    # A parameter that is not drawn counts too.
    refused(
        "values: expected T_amb = 15.0, as the sweep began, got T_amb = 16.0",
        twin.with_values({"T_amb": 16.0}),
    )
    longer = Experiment.schedule("0:0.5,10:0.8", duration=31.0, cells=2, channels=("T11", "TAM"))
    refused("experiments", experiment=replace_name(longer, experiment.name))
    refused("recordings", experiment=replace_name(experiment, "another name"))
    rig = load_rig("paper-2024")
    stronger = replace(
        rig, driver=replace(rig.driver, supply_voltage=rig.driver.supply_voltage * 2.0)
    )
    refused("rig_content", Twin(stronger))
    monkeypatch.setattr(_plan, "FORMAT", 0)
    refused("format")


def test_the_order_of_names_does_not_count(stored, tmp_path, twin, experiment, engine):
    """A sweep that goes on with the same names in another order keeps its draws."""
    asked: dict[str, Any] = ASKED | {"names": ["R_E", "R_pc"]}
    sweep(twin, experiment, tmp_path, **asked)
    before = stored(tmp_path)
    (tmp_path / "done" / "1").unlink()
    asked["names"] = ["R_pc", "R_E"]
    assert sweep(twin, experiment, tmp_path, **asked).new > 0
    assert stored(tmp_path) == before


def replace_name(experiment: Experiment, name: str) -> Experiment:
    return Experiment(experiment.time, experiment.duty, channels=experiment.channels, name=name)


def test_a_changed_description_is_the_same_rig(tmp_path, twin, experiment, engine):
    """A better description, or the same file in another place, is the same rig."""
    sweep(twin, experiment, tmp_path, **ASKED)
    rig = replace(load_rig("paper-2024"), description="better", source="elsewhere.toml")
    assert sweep(Twin(rig), experiment, tmp_path, **ASKED).new == 0


def test_a_foreign_folder_is_refused_and_left_alone(stored, tmp_path, twin, experiment, engine):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(SimulationError, match="expected the folder of a sweep"):
        sweep(twin, experiment, tmp_path, **ASKED)
    assert stored(tmp_path) == {"thesis.txt": b"years of work"}
    with pytest.raises(SimulationError, match="expected the folder of a sweep"):
        sweep(twin, experiment, tmp_path / "thesis.txt", **ASKED)
    other = tmp_path / "other.zarr"
    zarr.create_group(other, attributes={"title": "somebody's"})
    with pytest.raises(SimulationError, match="expected the folder of a sweep"):
        sweep(twin, experiment, other, **ASKED)
    assert engine.given == []


@given(content=st.binary(max_size=60) | st.sampled_from([b"{}", b'{"attributes": []}', b"[1]"]))
def test_a_damaged_head_is_a_folder_without_a_sweep(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "zarr.json").write_bytes(content)
    with pytest.raises(SimulationError, match="expected the folder of a sweep"):
        read_identity(folder)


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path, twin, experiment, engine):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(SimulationError, match="file/sweep: "):
        sweep(twin, experiment, tmp_path / "file" / "sweep", **ASKED)


def test_a_full_disk_is_one_line_and_the_rest_is_kept(
    tmp_path, twin, experiment, engine, monkeypatch
):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(_store, "put", full)
        with pytest.raises(SimulationError, match="No space left on device"):
            sweep(twin, experiment, tmp_path, **ASKED)
    assert sweep(twin, experiment, tmp_path, **ASKED).complete


def test_a_chunk_that_another_process_is_at_is_left_to_it(tmp_path, twin, experiment, engine):
    """The claim ends with the process that holds it, also when it is killed."""
    sweep(twin, experiment, tmp_path, **ASKED)
    for chunk in "12":
        (tmp_path / "done" / chunk).unlink()
    hold = (
        "import fcntl, sys; file = open(sys.argv[1], 'ab'); fcntl.lockf(file, fcntl.LOCK_EX, 1, 1);"
        "print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(tmp_path / "done" / "claims")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        result = sweep(twin, experiment, tmp_path, **ASKED)
        assert (result.done, result.busy) == (12, 1)
        other.kill()
    assert sweep(twin, experiment, tmp_path, **ASKED).complete


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"draws": 0}, "draws: expected a whole number above 0.*, got 0"),
        ({"chunk_size": 0}, "chunk_size: expected .* got 0"),
        ({"seed": -1}, "seed: expected .* got -1"),
        ({"spread": 0.0}, "spread: expected a number between 0 and 1, got 0.0"),
        ({"reductions": ["mean"]}, "reductions: expected .* got mean"),
        ({"reductions": ["cost"]}, "expected recorded temperatures"),
        ({"executor": FORKED}, "executor: expected processes that start afresh"),
        ({"names": ["R_X"]}, "got R_X"),
    ],
)
def test_bad_input_is_refused_before_a_folder_is_made(
    tmp_path, twin, experiment, engine, asked, message
):
    from jaxtwin import JaxtwinError

    with pytest.raises(JaxtwinError, match=message):
        sweep(twin, experiment, tmp_path / "new", **ASKED | asked)
    assert not (tmp_path / "new").exists()


def test_the_identity_is_plain_json(tmp_path, twin, experiment, engine):
    """Anyone can read what a folder holds, without this package."""
    sweep(twin, experiment, tmp_path, **ASKED)
    identity = json.loads((tmp_path / "zarr.json").read_text())["attributes"]["jaxtwin_sweep"]
    assert identity == read_identity(tmp_path)
    assert identity["rig"] == "paper-2024"
    assert identity["experiments"] == [experiment.fingerprint]
    assert identity["draws"] == 20
