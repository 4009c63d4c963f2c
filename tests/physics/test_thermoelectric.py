"""The module: eqs. (7)-(10), closed forms, datasheets, and the paper's Table 3."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.data import table
from jaxtwin.errors import ParameterError, RigError
from jaxtwin.physics import DCSweep, ThermoelectricModule

MODULES = ("TEC1-12706", "CP10-127-05")

temperatures = st.floats(150, 500)
positive = st.floats(0.01, 10)


@pytest.fixture(params=MODULES)
def module(request) -> ThermoelectricModule:
    return ThermoelectricModule.from_datasheet(request.param)


@given(st.floats(-20, 20), temperatures, temperatures, positive, positive)
def test_heat_put_out_less_heat_taken_in_is_the_electrical_power(current, cold, hot, alpha, R_E):
    """q_h - q_c = I V with V = EMF + R_E I: energy is conserved in the cell."""
    module = ThermoelectricModule(alpha, R_E, 1.0)
    q_c, q_h = module.heat_flows(current, cold, hot)
    voltage = float(module.emf(hot - cold)) + R_E * current
    scale = abs(alpha * current * max(cold, hot)) + R_E * current**2
    # Single precision: nothing here switches to float64.
    assert float(q_h - q_c) == pytest.approx(current * voltage, abs=1e-6 * scale + 1e-30)


def test_heat_flows_by_hand(float64):
    """alpha I T = 0.05 * 2 * 290 = 29 W, half of R_E I^2 = 4 W."""
    q_c, q_h = ThermoelectricModule(0.05, 2.0, 1.5).heat_flows(2.0, 290.0, 310.0)
    assert (float(q_c), float(q_h)) == pytest.approx((29.0 - 4.0, 31.0 + 4.0))


def test_largest_heat_flow_is_at_the_optimum_current(module):
    """dQ_c/dI = alpha T_c - R_E I = 0."""
    T_hot, differences = 300.0, np.array([0.0, 20.0, 50.0])
    currents = np.linspace(0, 10, 10_001)
    sweep = module.dc_sweep(currents, differences, T_hot)
    for difference, heat_flow in zip(differences, sweep.heat_flow, strict=True):
        optimum = module.optimum_current(T_hot - difference)
        assert currents[heat_flow.argmax()] == pytest.approx(optimum, abs=6e-4)
        closed = 0.5 * module.seebeck_coefficient * optimum * (T_hot - difference)
        assert heat_flow.max() == pytest.approx(closed - difference / module.thermal_resistance)


def test_no_heat_is_pumped_at_the_largest_difference(module):
    """Z T_c^2 / 2; at the cold side temperature that belongs to the datasheet's point."""
    cold = 250.0
    difference = module.maximum_temperature_difference(cold)
    optimum = module.optimum_current(cold)
    sweep = module.dc_sweep(
        [0.9 * optimum, optimum, 1.1 * optimum], [difference], cold + difference
    )
    below, at, above = sweep.heat_flow[0]
    assert at == pytest.approx(0, abs=1e-9)
    assert max(below, above) < -0.01


@pytest.mark.parametrize(
    ("name", "V_max", "I_max", "dT_max", "T_h"),
    [("TEC1-12706", 16.4, 6.4, 75.0, 323.0), ("CP10-127-05", 13.9, 4.0, 72.35, 300.0)],
)
def test_module_meets_the_points_of_its_datasheet(name, V_max, I_max, dT_max, T_h):
    """At dT_max the optimum current is I_max, at V_max, and nothing is pumped: what eq. (10) is
    solved from."""
    module = ThermoelectricModule.from_datasheet(name)
    assert module.optimum_current(T_h - dT_max) == pytest.approx(I_max)
    assert module.maximum_temperature_difference(T_h - dT_max) == pytest.approx(dT_max)
    sweep = module.dc_sweep([I_max], [dT_max], T_h)
    assert sweep.heat_flow[0, 0] == pytest.approx(0, abs=1e-9)
    assert sweep.power[0, 0] == pytest.approx(I_max * V_max)


def test_constants_of_the_model_file_follow_from_its_datasheet():
    """0.0508 V/K, 1.967 ohm, 1.861 K/W."""
    module = ThermoelectricModule.from_datasheet("TEC1-12706")
    assert module.seebeck_coefficient == pytest.approx(0.05077399380804953, rel=1e-12)
    assert module.electrical_resistance == pytest.approx(1.9674922600619191, rel=1e-12)
    assert module.thermal_resistance == pytest.approx(1.8613081481117233, rel=1e-12)


def test_table_3_belongs_to_another_difference_and_hot_side_than_table_2():
    """Its resistance needs 71.2 K, its Seebeck coefficient 330 K, and its thermal resistance
    neither."""
    datasheet, printed = table(2).column("value"), table(3).column("value")
    V_max, I_max = float(datasheet["V_max"]), float(datasheet["I_max"])
    module = ThermoelectricModule.from_datasheet(
        maximum_voltage=V_max,
        maximum_current=I_max,
        maximum_temperature_difference=71.2,
        hot_side_temperature=300.0,
    )
    assert module.electrical_resistance == pytest.approx(printed["R_E"], abs=0.005)
    assert module.seebeck_coefficient == pytest.approx(0.0463, abs=5e-5)
    assert V_max / 330 == pytest.approx(printed["alpha"], abs=5e-5)
    assert module.thermal_resistance == pytest.approx(3.36, abs=0.005)
    assert printed["R_Th"] == 3.22


def test_single_numbers_replace_those_of_a_datasheet():
    module = ThermoelectricModule.from_datasheet("TEC1-12706", hot_side_temperature=300.0)
    assert module.seebeck_coefficient == pytest.approx(16.4 / 300)


@pytest.mark.parametrize("name", MODULES)
@given(st.floats(0.05, 10), st.floats(1, 100))
def test_no_module_beats_carnot(name, current, difference):
    """Second law: COP <= T_c / (T_h - T_c)."""
    module = ThermoelectricModule.from_datasheet(name)
    cop = module.dc_sweep([current], [difference], 300.0).cop[0, 0]
    assert cop < (300 - difference) / difference


def test_sweep_has_labels_and_units():
    sweep = ThermoelectricModule.from_datasheet("TEC1-12706").dc_sweep([0, 1, 2], [0, 30], 300.0)
    data = sweep.to_xarray()
    assert dict(data.sizes) == {"delta_T": 2, "current": 3}
    assert data["heat_flow"].sel(delta_T=30, current=2) == pytest.approx(sweep.heat_flow[1, 2])
    assert {name: data[name].attrs["units"] for name in data.variables} == {
        "heat_flow": "W",
        "power": "W",
        "cop": "1",
        "delta_T": "K",
        "current": "A",
    }
    assert data.attrs["T_hot_K"] == 300.0


def test_coefficient_of_performance_is_undefined_without_power():
    sweep = DCSweep(
        np.array([0.0, 1.0]), np.array([0.0]), 300.0, np.ones((1, 2)), np.array([[0, 4.0]])
    )
    assert np.isnan(sweep.cop[0, 0])
    assert sweep.cop[0, 1] == 0.25


def test_unknown_datasheet_is_refused():
    with pytest.raises(RigError, match="TEC1-12706"):
        ThermoelectricModule.from_datasheet("TEC1-12760")


NUMBERS = {
    "maximum_voltage": 16.4,
    "maximum_current": 6.4,
    "maximum_temperature_difference": 75.0,
    "hot_side_temperature": 323.0,
}


@pytest.mark.parametrize("field", NUMBERS)
@pytest.mark.parametrize("value", [None, 0.0, -1.0, np.nan, np.inf])
def test_numbers_that_no_module_has_are_refused(field, value):
    with pytest.raises(ParameterError, match=f"^{field}: expected a number above 0, got {value}"):
        ThermoelectricModule.from_datasheet(**{**NUMBERS, field: value})


def test_difference_beyond_absolute_zero_is_refused():
    """The 345.5 K that Table 2 prints, at 300 K."""
    with pytest.raises(ParameterError, match=r"expected a value below .* 300\.0 K, got 345\.5 K"):
        ThermoelectricModule.from_datasheet("CP10-127-05", maximum_temperature_difference=345.5)


@pytest.mark.parametrize(
    ("currents", "differences", "T_hot"),
    [
        ([np.nan], [0.0], 300.0),
        ([1.0], [np.inf], 300.0),
        ([1.0], [300.0], 300.0),
        ([1.0], [0.0], np.inf),
        ([1.0], [0.0], np.nan),
    ],
)
def test_sweeps_that_mean_nothing_are_refused(module, currents, differences, T_hot):
    with pytest.raises(ParameterError, match=r"dc_sweep: expected .* got T_hot"):
        module.dc_sweep(currents, differences, T_hot)
