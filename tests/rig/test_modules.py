"""Bundled module datasheets and eq. (10) of the paper."""

import pytest

from jaxtwin.errors import RigError
from jaxtwin.rig import bundled_materials, bundled_modules, load_material, load_module


def test_datasheets_are_listed():
    assert {"CP10-127-05", "TEC1-12706"} <= set(bundled_modules())


def test_tec1_12706_gives_the_constants_of_the_model_file():
    """Start-up values of the authors' model file: 0.050774 V/K, 1.96749 ohm, 1.86131 K/W."""
    module = load_module("TEC1-12706")
    assert module.seebeck_coefficient == pytest.approx(0.050774, rel=1e-5)
    assert module.electrical_resistance == pytest.approx(1.96749, rel=1e-5)
    assert module.thermal_resistance == pytest.approx(1.86131, rel=1e-5)


def test_cp10_127_05_is_table_2_with_its_difference_read_as_degrees():
    """Table 2: 33 W, 4 A, 13.9 V, 9 g at 300 K; 345.5 K there is 72.35 degC in kelvin."""
    module = load_module("CP10-127-05")
    assert module.maximum_temperature_difference == pytest.approx(345.5 - 273.15)
    assert module.maximum_heat_flow == 33
    assert module.maximum_current == 4
    assert module.maximum_voltage == 13.9
    assert module.mass == pytest.approx(9e-3)
    assert module.seebeck_coefficient == pytest.approx(0.0463, abs=5e-5)


@pytest.mark.parametrize("name", bundled_modules())
def test_constants_give_back_the_datasheet(name):
    """At I_max and dT_max: no heat is pumped and the voltage is V_max."""
    module = load_module(name)
    hot, difference = module.hot_side_temperature, module.maximum_temperature_difference
    alpha, resistance = module.seebeck_coefficient, module.electrical_resistance
    current = module.maximum_current
    heat = (
        alpha * current * (hot - difference)
        - 0.5 * resistance * current**2
        - difference / module.thermal_resistance
    )
    assert heat == pytest.approx(0, abs=1e-12)
    assert alpha * difference + resistance * current == pytest.approx(module.maximum_voltage)


@pytest.mark.parametrize("name", bundled_modules())
def test_constants_give_about_the_heat_flow_of_the_datasheet(name):
    """With constants from I_max, V_max and dT_max, the heat at I_max without a difference is
    alpha I T - I^2 R / 2. Datasheets measure it with what their figures for the difference leave
    out, and state up to a fifth less."""
    module = load_module(name)
    if module.maximum_heat_flow is None:
        return
    hot, current = module.hot_side_temperature, module.maximum_current
    peltier = module.seebeck_coefficient * current * hot
    heat = peltier - 0.5 * module.electrical_resistance * current**2
    assert 0.8 * heat < module.maximum_heat_flow < 1.05 * heat


# Heat flow of the datasheet / that of the constants, by hand: V I (T + difference) / (2 T).
STATED = {
    "1MA10-063-05": 0.970,
    "CP10-127-05": 0.956,
    "PC-072-14-06": 1.011,
    "PC-128-10-05": 1.010,
    "PC-128-14-06": 1.013,
    "TEC1-12705": 0.926,
    "TEC1-12706": 0.881,
    "TEC1-12710": 0.853,
    "TM-127-1.4-4.0": 0.859,
    "TM-31-1.4-8.5": 0.944,
}


@pytest.mark.parametrize(("name", "part"), STATED.items())
def test_the_heat_flow_of_a_datasheet_is_this_part_of_what_the_constants_give(name, part):
    module = load_module(name)
    assert module.maximum_heat_flow is not None
    hot, difference = module.hot_side_temperature, module.maximum_temperature_difference
    power = module.maximum_voltage * module.maximum_current
    heat = power * (hot + difference) / (2 * hot)
    assert module.maximum_heat_flow / heat == pytest.approx(part, abs=6e-4)


def test_every_heat_flow_that_is_stated_is_compared():
    assert set(STATED) == {n for n in bundled_modules() if load_module(n).maximum_heat_flow}


@pytest.mark.parametrize(
    "name", [name for name in bundled_modules() if load_module(name).ac_resistance is not None]
)
def test_the_resistance_is_about_what_alternating_current_measures(name):
    """A number of the datasheet that the constants do not come from: 1 to 4 % above theirs."""
    module = load_module(name)
    assert module.ac_resistance is not None
    assert 1.0 < module.ac_resistance / module.electrical_resistance < 1.04


@pytest.mark.parametrize("name", bundled_modules())
def test_a_datasheet_names_its_source(name):
    module = load_module(name)
    assert module.name == name
    assert module.references


LISTED = [name for name in bundled_materials() if load_material(name).diffusivity is not None]


@pytest.mark.parametrize("name", LISTED)
def test_the_values_of_a_material_agree_with_its_diffusivity(name):
    """The handbook lists the diffusivity k / (rho c) beside them, to three digits."""
    solid = load_material(name)
    diffusivity = solid.conductivity / (solid.density * solid.specific_heat)
    assert diffusivity == pytest.approx(solid.diffusivity, rel=0.01)


def test_the_conductivity_of_6061_agrees_with_that_for_electricity():
    """The same handbook lists 43 % of 58.0 MS/m (the standard of copper) for temper T6. Metals have
    k = L sigma T, with L = 2.44e-8 W ohm/K^2 (Wiedemann and Franz) within 10 % in alloys of
    aluminium."""
    solid = load_material("aluminium-6061")
    assert solid.conductivity == pytest.approx(2.44e-8 * 0.43 * 58.0e6 * 298, rel=0.1)
    assert solid.density == pytest.approx(load_material("aluminium").density, rel=0.01)
    assert solid.specific_heat == pytest.approx(load_material("aluminium").specific_heat, rel=0.02)


def test_unknown_material_is_refused_with_the_nearest():
    with pytest.raises(RigError, match="did you mean 'aluminium'"):
        load_material("aluminum")


def test_unknown_module_is_refused_with_the_known_ones():
    with pytest.raises(RigError, match=r"did you mean 'TEC1-127\d\d'.*CP10-127-05"):
        load_module("TEC1-12707")
