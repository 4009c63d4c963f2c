"""Natural convection, radiation and laws of the drive, against SciPy's Radau at 1e-9."""

import subprocess

import jax
import numpy as np
import pytest
from radiating_rig import DRIVE, TABLE, by_scipy, radiating_rig

from jaxtwin import Experiment, Twin, match
from jaxtwin.rig import rig_from_tables
from jaxtwin.simulation import response, simulate_batch
from jaxtwin.spice import to_spice

TWIN = Twin(radiating_rig())
DRAWS = {
    "eps": np.array([0.8, 0.3, 0.9]),
    "n": np.array([0.25, 0.4, 0.1]),
    "p": np.array([2.0, 1.6, 0.7]),
}


def test_a_run_is_that_of_scipy():
    np.testing.assert_allclose(TWIN.simulate(DRIVE).states, by_scipy(DRIVE), atol=1e-3)


@pytest.mark.parametrize("native", ["on", "off"])
def test_draws_are_those_of_scipy(native, monkeypatch):
    monkeypatch.setenv("JAXTWIN_NATIVE", native)
    found = np.asarray(simulate_batch(TWIN, DRIVE, DRAWS))
    for number, row in enumerate(found):
        values = {name: numbers[number] for name, numbers in DRAWS.items()}
        np.testing.assert_allclose(row, by_scipy(DRIVE, **values), atol=2e-4)


def test_derivatives_are_those_of_differences_also_at_duty_0(float64):
    def readings(values):
        return response(TWIN.with_values(values), DRIVE)

    values = {"eps": 0.8, "g": 0.1, "n": 0.25, "p": 1.6}
    found = jax.jacfwd(readings)(values)
    for name, value in values.items():
        step = 1e-4 * value
        more, less = (readings({**values, name: value + sign * step}) for sign in (1, -1))
        by_difference = np.asarray(more - less) / (2 * step)
        assert np.isfinite(found[name]).all()
        scale = np.abs(by_difference).max()
        np.testing.assert_allclose(found[name], by_difference, atol=5e-6 * scale)


def test_a_match_recovers_emissivity_and_exponents():
    truth = {"eps": 0.6, "g": 0.15, "p": 1.6}
    drive = Experiment.schedule(
        "0:0.9,600:0.3,1500:0.6,2400:0.15,3300:1.0", duration=4200, step=5.0, cells=1
    )
    clean = by_scipy(drive, **truth)
    noise = np.random.default_rng(0).normal(0, 0.1, clean.shape)
    recording = Experiment(
        drive.time, drive.duty, temperatures=clean + noise, channels=("T1", "T2")
    )
    fit = match(TWIN, recording)
    for name, value in truth.items():
        assert fit[name].value == pytest.approx(value, rel=0.05)


@pytest.mark.ngspice
def test_ngspice_finds_the_same_temperatures(tmp_path):
    table, netlist = tmp_path / "out.txt", tmp_path / "twin.cir"
    netlist.write_text(to_spice(TWIN, DRIVE, output=str(table)))
    subprocess.run(["ngspice", "-b", str(netlist)], check=True, capture_output=True, timeout=120)
    rows = np.loadtxt(table, skiprows=1)
    found = np.stack([np.interp(DRIVE.time, rows[:, 0], column) for column in rows.T[1:]], axis=1)
    np.testing.assert_allclose(by_scipy(DRIVE), found, atol=1e-2)


def test_a_link_without_convection_and_radiation_is_that_of_a_resistance():
    """The limit of small constants: what remains is the resistance of 8 K/W."""
    tiny = {**TABLE, "links": [dict(link) for link in TABLE["links"]]}
    tiny["links"][0] |= {"convection": "1e-12 W/K", "radiating_area": "1e-9 cm^2"}
    plain = {**tiny, "links": [dict(link) for link in tiny["links"]]}
    plain["links"][0] = {"between": ["block-shield"], "resistance": "8 K/W"}
    plain["parameters"] = {k: v for k, v in TABLE["parameters"].items() if k != "eps"}
    one, two = (Twin(rig_from_tables(table, "rig")).simulate(DRIVE) for table in (tiny, plain))
    np.testing.assert_allclose(one.states, two.states, atol=1e-6)
