"""Cells and heaters by place: the network under them, its derivatives, its heat balance, its limit
on fine grids."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed_rig import AT, GRID, MOVING, PLACES, placed_rig, placed_text

from jaxtwin import Experiment, Twin, response, simulate, simulate_batch
from jaxtwin.errors import ParameterError
from jaxtwin.physics import System, build_netlist
from jaxtwin.spice import to_spice

STEP = Experiment.schedule("0:0.6", duration=300.0, cells=1)
COARSE = GRID.replace("1 cm", "2 cm")  # where the number of elements is not the question
HEATER = """
[[heaters]]
name = "mat"
power = "20 W"
capacitance = "10 J/K"
at = ["13 cm", "4 cm"]
size = ["4 cm", "6 cm"]
contact_resistance = "0.2 K/W"
"""


def far(twin: Twin) -> np.ndarray:
    return simulate(twin, STEP).temperatures


@pytest.mark.slow
def test_a_cell_on_lines_of_the_grid_is_one_whose_contacts_are_listed():
    """The 16 elements of 1 cm under the cell have 16 times its contact resistance each."""
    touched = [f"V{row}_{column}" for row in range(3, 7) for column in range(4, 8)]
    contacts = ", ".join(f'{name} = "9.6 K/W"' for name in touched)
    listed = placed_rig(
        f'contacts = {{ {contacts} }}\narea = "16 cm^2"',
        parts='[[bodies]]\nname = "used"\ncapacitance = "1 J/K"\n'
        '[[links]]\nresistance = "R_contact"\nbetween = ["used-ambient"]',
    )
    np.testing.assert_allclose(far(Twin(placed_rig())), far(Twin(listed)), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [pytest.param("0 deg", marks=pytest.mark.long), "30 deg"])
def test_a_place_by_parameters_is_that_place(angle: str):
    turned = f'\nangle = "{angle}"'
    fixed = Twin(placed_rig(AT.replace('"5 cm"', '"5.3 cm"') + turned, grid=COARSE))
    moving = Twin(placed_rig(MOVING + turned, grid=COARSE), {"x_1": 53.0})
    np.testing.assert_allclose(far(moving), far(fixed), atol=1e-9)


def test_the_conductances_of_the_contacts_sum_to_that_of_the_face():
    rig = placed_rig(MOVING)
    for x in (30.0, 47.3, 80.0):
        twin = Twin(rig, {"x_1": x, "R_contact": 0.8})
        values = twin.numbers_si
        contacts = [link for link in twin.netlist.links if link.role == "contact"]
        total = sum(1 / link.resistance(values) for link in contacts)
        assert total == pytest.approx(1 / 0.8, rel=1e-12)


@pytest.mark.parametrize("place", [AT, MOVING], ids=["fixed", "parameters"])
def test_a_cell_covers_its_area_of_one_face(place: str):
    """15 W/(m^2 K) from 2 x 128 cm^2 - 16 cm^2 of the faces and 2 x (16 + 8) cm x 1 mm of rim,
    conduction to the surface left aside."""
    twin = Twin(placed_rig(place, losses='film_coefficient = "15 W/(m^2 K)"'))
    values = twin.numbers_si
    plate = {node.name for node in twin.netlist.nodes if node.kind == "plate"}
    film = sum(
        1 / link.resistance(values)
        for link in twin.netlist.links
        if link.a in plate and link.b == "ambient"
    )
    assert film == pytest.approx(15 * (240e-4 + 4.8e-4), rel=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("angle", [pytest.param("", marks=pytest.mark.long), '\nangle = "30 deg"'])
def test_derivatives_in_x_and_y_are_central_differences(angle: str):
    rig = placed_rig(MOVING + angle, grid=COARSE)

    def reading(place):
        twin = Twin(rig, {"x_1": place[0], "y_1": place[1]})
        return response(twin, STEP)[-1, 0]

    place, step = np.array([52.0, 41.3]), 1e-3
    slope = jax.grad(reading)(place)
    for axis in (0, 1):
        moved = step * np.eye(2)[axis]
        expected = float(reading(place + moved) - reading(place - moved)) / (2 * step)
        assert slope[axis] == pytest.approx(expected, rel=1e-5, abs=1e-9)
    assert slope[0] > 0.1  # K/mm: the cell comes nearer


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("place", [AT, MOVING], ids=["fixed", "parameters"])
def test_heat_is_balanced_at_rest(place: str):
    """What cell and heater move into the network leaves through the links to ambient."""
    twin = Twin(placed_rig(place, losses='film_coefficient = "15 W/(m^2 K)"', parts=HEATER))
    system = eqx.filter_jit(Twin.system)(twin)
    reference = system.ambient_temperature
    duty = jnp.array([0.5, 0.4])
    rest = eqx.filter_jit(System.steady_state)(system, duty, reference)
    sides = np.concatenate([system.wiring.cold, system.wiring.hot])
    heat = system.cell_heat(rest[sides] + reference, duty)
    supplied = float((heat.hot - heat.cold).sum())
    lost = float(system.ambient_conductance @ rest)
    assert supplied == pytest.approx(lost, rel=1e-5)
    assert supplied > 8.0


@pytest.mark.slow
def test_a_heater_on_the_plate_heats_what_is_under_it():
    """Its 20 W go into the 24 cm^2 that it covers."""
    rig = placed_rig(parts=HEATER)
    netlist = build_netlist(rig)
    contacts = [link for link in netlist.links if link.a == "mat"]
    assert len(contacts) == 24
    assert sum(1 / link.resistance({}) for link in contacts) == pytest.approx(1 / 0.2)
    run = simulate(Twin(rig), Experiment.schedule("0:0/1", duration=600.0, cells=2))
    assert run.channel("T_far")[-1] > run.channel("T_near")[-1] + 1


@pytest.mark.long
def test_readings_converge_with_the_resolution():
    """Grids of 2, 1 and 0.5 cm, against one of 0.25 cm. The lines of the grid cut the cell at other
    places each time, so that errors do not fall evenly; from 2 to 0.5 cm they fall by more than 6,
    where an error of first order falls by 4."""
    place = AT.replace('["5 cm", "4 cm"]', '["5.3 cm", "3.6 cm"]')

    def end(resolution: str) -> np.ndarray:
        grid = GRID.replace("1 cm", resolution)
        losses = 'film_coefficient = "15 W/(m^2 K)"'
        return far(Twin(placed_rig(place, grid=grid, losses=losses)))[-1]

    finest = end("0.25 cm")
    errors = [np.abs(end(size) - finest).max() for size in ("2 cm", "1 cm", "0.5 cm")]
    assert errors[0] < 0.4
    assert errors[1] < errors[0] / 2
    assert errors[2] < errors[0] / 6


@pytest.mark.slow
def test_a_batch_of_places_is_one_run_for_each():
    twin = Twin(placed_rig(MOVING, grid=COARSE))
    draws = {"x_1": np.array([40.0, 55.5]), "y_1": np.array([35.0, 44.0])}
    batch = simulate_batch(twin, STEP, draws)
    for number in (0, 1):
        alone = far(twin.with_values({name: values[number] for name, values in draws.items()}))
        np.testing.assert_allclose(batch[number], alone, atol=2e-3)


@pytest.mark.slow
def test_a_place_beyond_its_bounds_is_refused():
    twin = Twin(placed_rig(MOVING))
    with pytest.raises(ParameterError, match=r"x of P1 \(x_1\): expected its bounds, 3 cm to 8 cm"):
        simulate(twin.with_values({"x_1": 90.0}), STEP)
    assert not bool(twin.with_values({"x_1": 90.0}).system().is_valid)
    assert bool(twin.with_values({"x_1": 80.0}).system().is_valid)


@pytest.mark.slow
def test_a_file_for_spice_has_the_contacts_of_the_place():
    text = to_spice(Twin(placed_rig(MOVING)), STEP)
    contacts = [line for line in text.splitlines() if line.startswith("Rcontact")]
    assert len(contacts) == 16
    assert {round(float(line.split()[3]), 6) for line in contacts} == {9.6}


def test_the_fingerprint_of_a_rig_has_the_place():
    texts = (AT, AT.replace('"5 cm"', '"5.1 cm"'), MOVING)
    assert len({placed_rig(text).fingerprint for text in texts}) == 3
    assert len({Twin(placed_rig(text)).wiring.fingerprint for text in texts}) == 3
    assert PLACES in placed_text(MOVING)
