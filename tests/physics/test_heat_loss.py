"""Losses that grow faster than the rise, and the lag of the command: against other solvers, ngspice
and the laws that they come from."""

import subprocess
import tomllib

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Rig, Twin, simulate
from jaxtwin.data import data_folder
from jaxtwin.physics._heat_loss import NonlinearLoss
from jaxtwin.rig import rig_from_tables
from jaxtwin.spice import to_spice

DRIVE = Experiment.schedule("0:0.5/0.7,60:0.8", duration=120, step=2.0, cells=2)


def changed(name: str, *changes: tuple[str, str]) -> Rig:
    """A bundled rig with some texts of its file replaced."""
    text = (data_folder() / "rigs" / f"{name}.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return rig_from_tables(tomllib.loads(text), "changed")


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell", {"e_copper": 0.3, "t_lag": 4.0, "t_delay": 3.0})


def loss(film: float, exponent: float, radiating: float) -> NonlinearLoss:
    return NonlinearLoss(jnp.array([film]), jnp.array(exponent), jnp.array([radiating]))


def test_at_the_reference_rise_the_film_is_as_given(float64):
    assert abs(float(loss(2.0, 0.25, 0.0).heat(jnp.array([20.0]), jnp.array(290.0))[0])) < 1e-12


def test_natural_convection_grows_with_the_power_five_fourths(float64):
    # Total loss at 40 K over that at 20 K: 2^1.25, but for the stillness below 1 K.
    extra = float(loss(1.0, 0.25, 0.0).heat(jnp.array([40.0]), jnp.array(290.0))[0])
    assert (40.0 + extra) / 20.0 == pytest.approx(2**1.25, rel=1e-3)


def test_radiation_is_stefan_boltzmanns(float64):
    heat = float(loss(0.0, 0.0, 0.01).heat(jnp.array([60.0]), jnp.array(290.0))[0])
    assert heat == pytest.approx(5.670374419e-8 * 0.01 * (350.0**4 - 290.0**4), rel=1e-12)


def test_no_rise_loses_nothing(float64):
    assert float(loss(1.0, 0.25, 0.01).heat(jnp.array([0.0]), jnp.array(290.0))[0]) == 0.0


@pytest.mark.long
def test_the_default_solver_agrees_with_kvaerno(twin):
    ours = simulate(twin, DRIVE)
    other = simulate(twin, DRIVE, solver=diffrax.Kvaerno5())
    # Delays end between steps of the fixed grid.
    np.testing.assert_allclose(ours.states, other.states, atol=5e-3)


@pytest.mark.slow
@pytest.mark.ngspice
def test_ngspice_finds_the_same_temperatures(twin, tmp_path):
    table = tmp_path / "out.txt"
    netlist = tmp_path / "twin.cir"
    netlist.write_text(to_spice(twin, DRIVE, output=str(table)))
    subprocess.run(["ngspice", "-b", str(netlist)], check=True, capture_output=True, timeout=120)
    rows = np.loadtxt(table, skiprows=1)
    found = np.stack([np.interp(DRIVE.time, rows[:, 0], column) for column in rows.T[1:]], axis=1)
    np.testing.assert_allclose(simulate(twin, DRIVE).states, found, atol=1e-2)


@pytest.mark.slow
def test_film_exponent_emissivity_lag_and_delay_can_each_be_left_out():
    linear = changed(
        "dual-cell",
        ('film_exponent = "n_film"\n', ""),
        ('emissivity = "e_copper"\n', ""),
        ('lag = "t_lag"\n', ""),
        ('delay = "t_delay"\n', ""),
        *(
            (line + "\n", "")
            for line in (data_folder() / "rigs/dual-cell.toml").read_text().splitlines()
            if line.startswith(("n_film", "e_copper", "t_lag", "t_delay"))
        ),
    )
    system = Twin(linear).system()
    assert (system.loss, system.lag, system.delay) == (None, None, None)
    whole = Twin("dual-cell", {"e_copper": 0.0, "n_film": 0.02, "t_lag": 0.1, "t_delay": 0.02})
    # With next to no exponent, lag and delay the whole is nearly the linear one.
    apart = simulate(whole, DRIVE).states - simulate(Twin(linear), DRIVE).states
    assert np.abs(apart[-1]).max() < 0.5


@pytest.mark.slow
def test_lumping_keeps_nonlinear_losses():
    rig = changed(
        "paper-2024", ('thickness = "5.08 mm"\n', 'thickness = "5.08 mm"\nfilm_exponent = "0.3"\n')
    )
    twin = Twin(rig)
    start = [
        node.initial_temperature.evaluate(twin.numbers_si) - 273.15 for node in twin.netlist.nodes
    ]
    lumped, whole = simulate(twin, DRIVE), simulate(twin, DRIVE, initial=np.array(start))
    np.testing.assert_allclose(lumped.states, whole.states, atol=1e-6)
    assert np.abs(lumped.states - simulate(Twin("paper-2024"), DRIVE).states).max() > 0.1
