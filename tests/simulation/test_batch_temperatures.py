"""The temperatures of many draws are an array that knows the draws of its parameters."""

import pickle

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.errors import SimulationError
from jaxtwin.simulation import BatchTemperatures

DRIVE = jt.Experiment(np.arange(61.0), np.full((61, 1), 0.3), name="a step")
DRAWS = {"R_E": [1.9, 2.0, 2.1], "R_pc": np.array([0.1, 0.2, 0.3])}


@pytest.fixture(name="batch", scope="module")
def make_batch() -> BatchTemperatures:
    result = jt.simulate_batch(jt.Twin("single-cell"), DRIVE, DRAWS)
    assert isinstance(result, BatchTemperatures)
    return result


def test_the_dataset_has_the_numbers_and_the_draws_as_coordinates(batch: BatchTemperatures) -> None:
    dataset = batch.to_xarray()
    temperature = dataset["temperature"]
    assert temperature.dims == ("draw", "time", "channel")
    np.testing.assert_array_equal(temperature, batch)
    for name, values in DRAWS.items():
        assert dataset[name].dims == ("draw",)
        np.testing.assert_array_equal(dataset[name], values)
    assert (dataset["R_E"].units, dataset.attrs["experiment"]) == ("ohm", "a step")
    third = temperature.where(dataset["R_pc"] > 0.25, drop=True)
    np.testing.assert_array_equal(third[0], batch[2])


def test_it_is_an_array_for_everything_else(batch: BatchTemperatures) -> None:
    assert isinstance(batch, np.ndarray)
    assert batch.mean(axis=0).shape == batch[0].shape
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(batch)), batch)


def test_a_part_has_no_labels_and_says_so(batch: BatchTemperatures) -> None:
    part = batch[:2]
    assert isinstance(part, BatchTemperatures)
    with pytest.raises(SimulationError, match="expected the whole result of simulate_batch"):
        part.to_xarray()


def test_an_array_of_the_caller_stays_as_it_is(batch: BatchTemperatures) -> None:
    out = np.empty(batch.shape)
    assert jt.simulate_batch(jt.Twin("single-cell"), DRIVE, DRAWS, out=out) is out
    np.testing.assert_array_equal(out, batch)
