"""A plate by geometry: eqs. (1)-(6) by hand, the authors' own formulas, and a fin in the limit."""

import json
from collections import defaultdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_rigs import small_rig_file

from jaxtwin.physics import Netlist, Twin, build_netlist
from jaxtwin.physics._plate import finite_volume_links
from jaxtwin.rig import Plate, Value, load_rig

FORMULAS = json.loads(Path(__file__).with_name("circuit_facts.json").read_text())["formulas"]


def resistances(netlist: Netlist) -> dict[tuple[str, str], list[float]]:
    between = defaultdict(list)
    for link in netlist.links:
        between[link.a, link.b].append(link.resistance({}))
    return {ends: sorted(values) for ends, values in between.items()}


def test_two_elements_by_hand(make_rig):
    """2 cm and 6 cm wide, 5 cm high, 2 mm thick; k = 200, rho = 2700, c = 900, h = 10 (SI)."""
    rig = make_rig(["2 cm", "6 cm"], ["5 cm"], [{"V12": "0.5 K/W"}])
    netlist = build_netlist(rig)
    found = resistances(netlist)
    # eq. (1): 2700 * 900 * 0.002 * 0.05 = 243 J/K a metre of length
    assert [node.capacitance.evaluate({}) for node in netlist.nodes[:2]] == pytest.approx(
        [4.86, 14.58]
    )
    # eq. (3): 0.01 / (200 * 0.002 * 0.05) + 0.03 / (200 * 0.002 * 0.05)
    assert found["V11", "V12"] == pytest.approx([0.5 + 1.5])
    # eqs. (4), (6): both faces 1 / (10 * 0.002) + 0.001 / (200 * 0.002); left edge
    # 1 / (10 * 1e-4) + 0.5; top and bottom edge together (1 / (10 * 4e-5) + 3.125) / 2
    assert found["V11", "ambient"] == pytest.approx([50.0025, 1000.5, 2503.125 / 2])
    # The cell covers one of the two faces; right edge; top and bottom edge together.
    assert found["V12", "ambient"] == pytest.approx(
        sorted([1 / 0.03 + 0.001 / 0.6, 1001.5, (1 / 1.2e-3 + 0.025 / 0.024) / 2])
    )


def test_single_element_by_hand(make_rig):
    """4 cm x 5 cm: both edges of each direction in parallel, and one free face."""
    netlist = build_netlist(make_rig(["4 cm"], ["5 cm"], [{"V11": "0.5 K/W"}]))
    # 0.02 / (200 * 0.002 * 0.05) + 1 / (10 * 1e-4); 0.025 / (200 * 0.002 * 0.04) + 1 / (10 * 8e-5)
    edges = [(1.0 + 1000.0) / 2, (1.5625 + 1250.0) / 2]
    assert resistances(netlist)["V11", "ambient"] == pytest.approx([50.0025, *edges])


def test_formulas_of_the_model_file_follow_from_its_sizes(make_rig):
    """With its own 5.08 mm and rows of 4 cm, the rule gives the file's numbers, those that it
    computes and never uses (R3x, R2y, R3y, Rxp3) included."""
    rig = make_rig(
        ["1 cm", "4 cm", "4 cm", "4 cm", "3 cm", "4 cm", "4 cm", "1.5 cm"],
        ["4 cm", "4 cm", "4 cm"],
        [{"V23": "0.09 K/W"}, {"V26": "0.09 K/W"}],
        thickness="5.08 mm",
        conductivity="401 W/(m K)",
        density="8960 kg/m^3",
        specific_heat="390 J/(kg K)",
        film_coefficient="75 W/(m^2 K)",
    )
    netlist = build_netlist(rig)
    found = resistances(netlist)
    f = FORMULAS
    for ends, expected in {
        ("V12", "V13"): [f["R"]],
        ("V11", "V12"): [f["R1x"]],
        ("V14", "V15"): [f["R2x"]],
        ("V17", "V18"): [f["R3x"]],
        ("V12", "V22"): [f["R"]],
        ("V11", "V21"): [f["R1y"]],
        ("V15", "V25"): [f["R2y"]],
        ("V18", "V28"): [f["R3y"]],
        ("V22", "ambient"): [f["Ra"]],
        ("V23", "ambient"): [2 * f["Ra"]],
        ("V12", "ambient"): [f["Ra"], f["Rp"]],
        ("V15", "ambient"): [f["Ra2"], f["Ryp2"]],
        ("V28", "ambient"): [f["Ra3"], f["Rxp3"]],
        ("V18", "ambient"): [f["Ra3"], f["Rxp3"], f["Ryp3"]],
    }.items():
        assert found[ends] == pytest.approx(expected, rel=1e-12), ends
    # Column 1: the file adds the whole of Rzcd1 where the others have half of it, 0.05 %.
    assert found["V21", "ambient"] == pytest.approx([f["Ra1"], f["Rxp1"]], rel=6e-4)
    assert found["V11", "ambient"] == pytest.approx([f["Ra1"], f["Rxp1"], f["Ryp1"]], rel=6e-4)
    assert netlist.nodes[1].capacitance.evaluate({}) == pytest.approx(28.4024832)
    assert netlist.nodes[0].capacitance.evaluate({}) == pytest.approx(7.1006208)


@pytest.mark.parametrize(
    ("columns", "rows"),
    [(["3 cm"], ["3 cm"]), (["3 cm"], ["1 cm", "2 cm"]), (["1 cm"] * 3, ["3 cm"])],
)
def test_surface_of_the_plate_loses_heat_once(make_rig, columns, rows):
    """With conduction out of the way: h times two faces less the cell, plus the rim."""
    rig = make_rig(columns, rows, [{"V11": "1 K/W"}], conductivity="1e9 W/(m K)")
    netlist = build_netlist(rig)
    left, right, top, bottom = rig.plate.extent("V11")
    faces = 2 * 0.03 * 0.03 - (right - left) * (bottom - top)
    rim = 4 * 0.03 * 0.002
    assert netlist.ambient_conductance({}, "plate") == pytest.approx(10 * (faces + rim), rel=1e-6)
    assert netlist.capacitance({}, "plate") == pytest.approx(2700 * 900 * 0.03 * 0.03 * 0.002)


def test_cell_that_touches_three_elements_covers_a_third_of_each_from_one_side(make_rig):
    contacts = {"V11": "1 K/W", "V21": "1 K/W", "V31": "1 K/W"}
    many = make_rig(["3 cm"], ["1 cm"] * 3, [contacts], conductivity="1e9 W/(m K)")
    faces = 2 * 3 * 0.03 * 0.01 - 0.03 * 0.01
    rim = 2 * (0.03 + 0.03) * 0.002
    found = build_netlist(many).ambient_conductance({}, "plate")
    assert found == pytest.approx(10 * (faces + rim), rel=1e-6)


def test_a_cell_covers_the_area_that_it_states_of_one_face(tmp_path):
    """Half of three elements of 2, 2 and 4 cm^2, the same part of each."""
    contacts = {"V11": "1 K/W", "V12": "1 K/W", "V13": "1 K/W"}
    file = small_rig_file(
        tmp_path, ["1 cm", "1 cm", "2 cm"], ["2 cm"], [contacts], conductivity="1e9 W/(m K)"
    )
    file.write_text(file.read_text().replace("contacts =", 'area = "4 cm^2"\n        contacts ='))
    netlist = build_netlist(load_rig(file))
    faces, rim = 2 * 8e-4 - 4e-4, 2 * (0.04 + 0.02) * 0.002
    assert netlist.ambient_conductance({}, "plate") == pytest.approx(10 * (faces + rim), rel=1e-6)
    film = [link for link in netlist.links if link.role == "film" and link.a == "V13"]
    largest = max(1 / link.resistance({}) for link in film)
    assert largest == pytest.approx(10 * (2 * 4e-4 - 2e-4), rel=1e-6)


def fin_error(elements: int, network) -> float:
    """Largest error of the temperatures along a fin whose first node is held 1 K above the air.

    theta'' = m^2 theta, with cosh and sinh for solution and a film on the tip.
    """
    length, height, thickness, k, h = 0.3, 0.02, 1e-3, 200.0, 20.0
    plate = Plate(
        columns=(length / elements,) * elements,
        rows=(height,),
        thickness=Value(thickness),
        density=Value(2700.0),
        specific_heat=Value(900.0),
        conductivity=Value(k),
        film_coefficient=(Value(h),) * elements,
    )
    matrix, _ = network(plate.element_names, finite_volume_links(plate, {}), {})
    theta = np.ones(elements)
    theta[1:] = np.linalg.solve(matrix[1:, 1:], -matrix[1:, 0])

    # The way from the middle of the sheet to its surface is part of the film's resistance.
    face, edge = 1 / (1 / h + thickness / 2 / k), 1 / (1 / h + height / 2 / k)
    m = np.sqrt(2 * (height * face + thickness * edge) / (k * height * thickness))
    x = (np.arange(elements) + 0.5) * length / elements
    shape = np.cosh(m * (length - x)) + h / (m * k) * np.sinh(m * (length - x))
    return float(np.max(np.abs(theta - shape / shape[0])))


def test_fine_fin_approaches_its_analytic_solution(network):
    """Second order: a fourth of the error with twice the elements."""
    coarse, fine = fin_error(40, network), fin_error(80, network)
    assert coarse / fine == pytest.approx(4, rel=0.05)
    assert fin_error(320, network) < 1e-4


def steady_rise(twin: Twin, duty: list[float]) -> np.ndarray:
    @jax.jit
    def solve(twin: Twin, duty: jax.Array) -> jax.Array:
        system = twin.system()
        return system.steady_state(duty, system.ambient_temperature)

    with jax.enable_x64(True):
        return np.asarray(solve(twin, jnp.array(duty)))


def test_symmetric_rig_has_symmetric_temperatures(make_rig):
    """Left and right, top and bottom, to rounding."""
    rig = make_rig(
        ["1 cm", "3 cm", "2 cm", "3 cm", "1 cm"],
        ["2 cm", "4 cm", "2 cm"],
        [{"V22": "0.1 K/W"}, {"V24": "0.1 K/W"}],
    )
    rise = steady_rise(Twin(rig), [0.6, 0.6])
    plate = rise[:15].reshape(3, 5)
    assert plate.max() - plate.min() > 1
    np.testing.assert_allclose(plate, plate[:, ::-1], rtol=1e-12)
    np.testing.assert_allclose(plate, plate[::-1], rtol=1e-12)


@pytest.mark.slow
def test_circuit_of_the_authors_is_symmetric_top_to_bottom():
    """Row 3 repeats row 1 in the model file, so T1j = T2j in simulation."""
    rise = steady_rise(Twin("paper-2024"), [0.5, 0.8])
    np.testing.assert_allclose(rise[:8], rise[16:24], rtol=1e-12)
