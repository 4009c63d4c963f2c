"""`response`: the run as a pure function of parameters, under every transformation of JAX."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin, response

TIME = np.arange(41.0)
DUTY = np.where(TIME < 15, 0.5, -0.8)[:, None] * np.array([1.0, 0.6])
EXPERIMENT = Experiment(TIME, DUTY)

# A square plate with one cell in its middle: every symmetry that a plate can have, so eigenvalues
# repeat. Parameters that keep the symmetry and parameters that break it.
SYMMETRIC = """
format = 1
name = "symmetric"
[plate]
columns = ["4 cm", "4 cm", "4 cm"]
rows = ["4 cm", "4 cm", "4 cm"]
thickness = "2 mm"
density = "2700 kg/m^3"
specific_heat = "c"
conductivity = "k"
film_coefficient = ["h_left", "h", "h"]
film_row_factor = ["f_top", "1", "1"]
[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "17 J/K"
contacts = { V22 = "R_pc" }
sink_resistance = "0.6 K/W"
[driver]
supply_voltage = "12 V"
supply_resistance = "0.2 ohm"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"
off_phase = "open"
[camera]
resolution = [80, 60]
noise = "0.1 K"
view = { x = [0, 80], y = [0, 60] }
[[channels]]
name = "corner"
nodes = ["V11"]
[[channels]]
name = "opposite"
nodes = ["V33"]
[[channels]]
name = "edge"
nodes = ["V12"]
[ambient]
temperature = "T_amb"
[initial]
temperature = "T_start"
[parameters]
c = { value = 900.0, unit = "J/(kg K)" }
k = { value = 200.0, unit = "W/(m K)" }
h = { value = 10.0, unit = "W/(m^2 K)" }
h_left = { value = 10.0, unit = "W/(m^2 K)" }
f_top = { value = 1.0, unit = "" }
R_pc = { value = 0.3, unit = "K/W" }
T_amb = { value = 20.0, unit = "degC" }
T_start = { value = 22.0, unit = "degC" }
"""


def of_values(twin: Twin, experiment: Experiment):
    """name -> value to (times, channels)."""

    def function(values: dict[str, jax.Array]) -> jax.Array:
        return response(twin.with_values(values), experiment)

    return function


def values_of(twin: Twin) -> dict[str, jax.Array]:
    return {name: jnp.asarray(value) for name, value in twin.values.items()}


def differences(twin: Twin, experiment: Experiment) -> dict[str, np.ndarray]:
    """Central differences by each parameter, in runs by `simulate`."""
    found = {}
    for name, value in twin.values.items():
        step = 1e-4 * (abs(float(value)) or 1.0)
        runs = [
            twin.with_values({name: float(value) + way * step}).simulate(experiment)
            for way in (1, -1)
        ]
        found[name] = (runs[0].temperatures - runs[1].temperatures) / (2 * step)
    return found


def assert_equal_slopes(found, expected, relative: float) -> None:
    """Relative to the largest entry of each parameter; each one has an effect."""
    for name, slope in expected.items():
        largest = np.abs(slope).max()
        assert largest > 0, name
        np.testing.assert_allclose(found[name], slope, atol=relative * largest, err_msg=name)


@pytest.fixture(
    scope="module", params=["paper-2024", pytest.param("dual-cell", marks=pytest.mark.long)]
)
def twin(request) -> Twin:
    """With the camera's zones moved where the rig has a camera that can be: zones have a kink where
    their edges meet those of elements."""
    moved = {"d_x": 1.3, "d_y": -0.7, "s_view": 1.01, "r_view": 0.4}
    twin = Twin(request.param)
    return twin.with_values({key: moved[key] for key in moved if key in twin.values})


@pytest.fixture
def symmetric(tmp_path: Path) -> Twin:
    path = tmp_path / "symmetric.toml"
    path.write_text(SYMMETRIC)
    return Twin(path)


@pytest.mark.slow
def test_same_numbers_as_simulate(twin, float64):
    run = twin.simulate(EXPERIMENT)
    np.testing.assert_allclose(response(twin, EXPERIMENT), run.temperatures, atol=1e-9)


@pytest.mark.slow
def test_forward_slopes_equal_differences_in_every_parameter(twin, float64):
    """The whole Jacobian (times, channels) of each of the rig's parameters.

    Differences hold the change of the solver's error too, since its modes move with a parameter.
    """
    found = jax.jit(jax.jacfwd(of_values(twin, EXPERIMENT)))(values_of(twin))
    assert_equal_slopes(found, differences(twin, EXPERIMENT), 5e-4)


@pytest.mark.slow
def test_backward_slopes_equal_forward_slopes(twin, float64):
    """Of one number that every time and channel enters with a weight of its own."""
    weights = jnp.cos(jnp.arange(41 * 15.0)).reshape(41, 15)
    function = of_values(twin, EXPERIMENT)

    def number(values):
        return jnp.sum(weights * function(values))

    values = values_of(twin)
    backward = jax.jit(jax.grad(number))(values)
    forward = jax.jit(jax.jacfwd(number))(values)
    for name, slope in forward.items():
        assert np.isfinite(slope), name
        np.testing.assert_allclose(backward[name], slope, rtol=1e-9, err_msg=name)


@pytest.mark.slow
def test_slopes_exist_where_eigenvalues_repeat(symmetric, float64):
    """The derivative of an eigenvector does not exist there; that of a temperature does."""
    system = symmetric.system()
    scale = 1 / np.sqrt(system.capacitance)
    rates = np.linalg.eigvalsh(np.asarray(system.conductance) * scale[:, None] * scale[None, :])
    gaps = np.diff(rates) / rates[1:]
    assert gaps.min() < 1e-12, "the plate has repeated eigenvalues"
    experiment = Experiment(TIME, DUTY[:, :1])
    found = jax.jit(jax.jacfwd(of_values(symmetric, experiment)))(values_of(symmetric))
    assert_equal_slopes(found, differences(symmetric, experiment), 1e-4)
    # Breaking the symmetry cools its own corner more than the opposite one.
    last = np.asarray(found["f_top"])[-1]
    assert last[0] < last[1] < 0


@pytest.mark.slow
def test_draws_in_one_call_equal_draws_one_by_one(twin, float64):
    draws = jnp.array([1.7, 1.9, 2.4])
    function = of_values(twin, EXPERIMENT)
    batch = jax.jit(jax.vmap(lambda R_E: function({"R_E": R_E})))(draws)
    single = [
        twin.with_values({"R_E": float(R_E)}).simulate(EXPERIMENT).temperatures for R_E in draws
    ]
    np.testing.assert_allclose(batch, single, atol=1e-9)
    assert np.ptp(np.asarray(batch)[:, -1, 0]) > 0.01


@pytest.mark.slow
def test_new_values_compile_nothing_anew(twin):
    """Also of a rig that is read again."""
    function = eqx.debug.assert_max_traces(lambda twin: response(twin, EXPERIMENT), max_traces=1)
    traced = eqx.filter_jit(function)
    for R_E in (1.8, 1.9, 2):
        traced(twin.with_values({"R_E": R_E}))
    traced(Twin(twin.rig.name))
    assert eqx.debug.get_num_traces(function) == 1


@pytest.mark.slow
def test_precision_is_the_caller_s(twin):
    """float32 outside `jax.enable_x64`; deviations from ambient keep it to a few millikelvin."""
    single = response(twin, EXPERIMENT)
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, twin.simulate(EXPERIMENT).temperatures, atol=5e-3)


@pytest.mark.slow
def test_channels_and_start_are_those_of_simulate(twin, float64):
    experiment = Experiment(TIME, DUTY, channels=("TCM", "T11"))
    found = response(twin, experiment, initial=25.0)
    run = twin.simulate(experiment, initial=25.0)
    np.testing.assert_allclose(found, run.temperatures, atol=1e-9)
