"""Results of a sweep as a data set: labelled, lazy, and only what is done."""

from typing import Any

import numpy as np
import pytest
import zarr

from jaxtwin import open_sweep
from jaxtwin.errors import SimulationError
from jaxtwin.sensitivity_analysis import normal_draws
from jaxtwin.sweeps import sweep
from jaxtwin.sweeps._store import count_failed

ASKED: dict[str, Any] = {
    "draws": 20,
    "chunk_size": 8,
    "reductions": ("final", "plate_range"),
    "seed": 3,
}


def test_results_stand_beside_the_draws_that_gave_them(tmp_path, twin, experiment, engine):
    """Samples are made again from the seed, by the same function for any part."""
    sweep(twin, experiment, tmp_path, **ASKED)
    table = open_sweep(tmp_path)
    assert dict(table.sizes) == {"draw": 20, "channel": 2, "recording": 1, "parameter": 16}
    samples = normal_draws(
        dict(zip(table.parameter.values, table.value.values, strict=True)), 0.25, 3, 20
    )
    assert np.array_equal(table.sample.sel(parameter="R_E"), samples["R_E"])
    assert np.array_equal(table.final.sel(channel="TAM"), 2 * samples["R_E"])
    assert np.array_equal(table.failed, samples["R_E"] > 2.8)
    assert table.attrs["failed"] == int(table.failed.sum()) > 0
    assert list(table.recording) == ["half a minute"]
    assert table.final.attrs["units"] == "degC"


def test_any_part_of_the_samples_is_the_same_as_of_the_whole(tmp_path, twin, experiment, engine):
    sweep(twin, experiment, tmp_path, **dict(ASKED, draws=2500, chunk_size=1000))
    sample = open_sweep(tmp_path).sample
    whole = sample.values
    for key in (slice(3, 7), slice(1020, 1030), slice(2400, 3, -100), [7, 2, 2049], -1):
        assert np.array_equal(sample.isel(draw=key).values, whole[key])
    assert np.array_equal(sample.isel(draw=5, parameter=2).values, whole[5, 2])
    assert sample.isel(draw=slice(0, 0)).values.shape == (0, 16)


def test_draws_that_are_not_done_are_left_out(tmp_path, twin, experiment, engine):
    """Of three chunks of eight the middle one."""
    sweep(twin, experiment, tmp_path, **ASKED)
    for chunk in "02":
        (tmp_path / "done" / chunk).unlink()
    table = open_sweep(tmp_path)
    assert table.draw.values.tolist() == list(range(8, 16))
    assert np.array_equal(table.final[:, 1], 2 * table.sample.sel(parameter="R_E"))
    assert (table.attrs["draws"], table.attrs["done"]) == (20, 8)


def test_only_the_chunks_that_are_used_are_read(tmp_path, twin, experiment, engine):
    """A chunk that cannot be read does not stand in the way of another one."""
    sweep(twin, experiment, tmp_path, **ASKED)
    (tmp_path / "final" / "2.0").write_bytes(b"torn")
    final = open_sweep(tmp_path).final
    assert np.isfinite(final.isel(draw=slice(0, 16))).all()
    with pytest.raises(RuntimeError):
        final.load()


def test_a_folder_without_a_sweep_is_refused(tmp_path):
    with pytest.raises(SimulationError, match="expected the folder of a sweep"):
        open_sweep(tmp_path)


def test_failed_draws_are_counted_in_the_chunks_that_are_done(tmp_path):
    failed = zarr.open_group(tmp_path, mode="w").create_array("failed", shape=6, dtype=bool)
    failed[:] = np.array([False, True, True, True, False, False])
    assert count_failed(tmp_path, np.array([True, False, True]), 2) == 1
    assert count_failed(tmp_path, np.array([False, True, True]), 2) == 2
