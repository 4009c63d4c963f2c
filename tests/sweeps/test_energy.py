"""A sweep knows what the cells draw from the supply."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin
from jaxtwin.sweeps import sweep


@pytest.mark.slow
def test_a_sweep_holds_the_energy_and_the_peak_power_of_a_heater(tmp_path):
    """Of `printer-bed`, whose cell is a resistance: V^2 / R for as much of the time as the duty
    says, 40 % for 20 s and 80 % for 10 s; R is that of tracks, switch and supply."""
    drive = Experiment.schedule("0:0.4,20:0.8", duration=30, cells=1)
    names = ["R_tracks", "R_supply", "R_pc"]
    reductions = ("energy", "peak_power")
    result = sweep(
        Twin("printer-bed"), drive, tmp_path, draws=12, names=names, reductions=reductions,
        chunk_size=5, seed=2,
    )  # fmt: skip
    table = result.to_xarray()
    sample = {name: table.sample.sel(parameter=name).values for name in names}
    power = 12.0**2 / (sample["R_tracks"] + 0.01 + sample["R_supply"])
    assert power.max() > 1.3 * power.min()
    np.testing.assert_allclose(table.energy[:, 0], (0.4 * 20 + 0.8 * 10) * power, rtol=1e-9)
    np.testing.assert_allclose(table.peak_power[:, 0], 0.8 * power, rtol=1e-9)
    assert table.energy.attrs["units"] == "J"
    assert table.peak_power.attrs["units"] == "W"
