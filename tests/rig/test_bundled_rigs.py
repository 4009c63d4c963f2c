"""The bundled rigs against the facts that they are made from."""

import math
import tomllib
from collections import Counter

import pytest

from jaxtwin.data import data_folder
from jaxtwin.rig import Rig, ZoneSensor, bundled_rigs, load_rig, rig_from_tables
from jaxtwin.rig._plate import AMBIENT

COLUMNS, ROWS = range(1, 9), range(1, 4)

# Start-up values of the authors' model file: its sizes, copper and film coefficient.
L = W = 0.04
W1, W2, W3, THICKNESS = 0.01, 0.03, 0.015, 0.00508
DENSITY, SPECIFIC_HEAT, K, H = 8960.0, 390.0, 401.0, 75.0

# Table 4 of the paper: initial value, final value, maximum (every minimum is 0). R_Tex3 and C_co
# are not in the circuit.
TABLE_4 = {
    "C_esp": (1200, 1959, 2000),
    "R_Th": (1.86, 9.75, 12),
    "R_E": (1.96, 0.01, 10),
    "R_Tfx": (0.49, 0.20, 2),
    "R_Tez": (24.5, 18.54, 36),
    "R_Tez1": (50, 95.5, 200),
    "R_Tez2": (16.6, 0.52, 32),
    "R_Tez3": (33.3, 0.82, 70),
    "R_Tey": (197, 149.6, 400),
    "R_Tex1": (196.91, 199.5, 400),
    "R_Tey1": (788.3, 3.9, 2000),
    "R_Tey2": (262.7, 367.9, 200),
    "R_Tey3": (545.5, 315.5, 200),
    "R_ph": (0.6, 6.9e-5, 2),
    "R_pc": (0.3, 1.1, 2),
    "R_Tfx2": (0.42, 0.2, 2),
}


@pytest.fixture(scope="module")
def paper() -> Rig:
    return load_rig("paper-2024")


@pytest.fixture(scope="module")
def dual() -> Rig:
    return load_rig("dual-cell")


def si_values(rig: Rig) -> dict[str, float]:
    return {name: p.to_si(p.value) for name, p in rig.parameters.items()}


def links_as_built() -> Counter[tuple[frozenset[str], float]]:
    """The model file's 83 plate links, from its formulas and the picture of its circuit."""
    between_columns = (L / (K * THICKNESS * L) + W / (K * THICKNESS * L)) / 2
    narrow = (between_columns + W1 / (K * THICKNESS * L)) / 2
    middle = (between_columns + W2 / (K * THICKNESS * L)) / 2
    along_x = [narrow] + [between_columns] * 2 + [middle] * 2 + [between_columns] * 2
    along_y = [L / (K * THICKNESS * W1)] + [between_columns] * 7

    def film(area: float, depth: float) -> float:
        return 1 / (H * area) + depth

    face = {w: film(w * L, THICKNESS / 2 / (K * w * L)) / 2 for w in (W, W2, W3)}
    face[W1] = film(W1 * L, 0) / 2 + THICKNESS / 2 / (K * W1 * L)  # built differently
    edge = {w: film(w * THICKNESS, L / 2 / (K * THICKNESS * w)) for w in (W, W1, W2, W3)}
    left = film(L * THICKNESS, W1 / 2 / (K * THICKNESS * L))
    widths = [W1, W, W, W, W2, W, W, W3]

    links: Counter[tuple[frozenset[str], float]] = Counter()

    def add(first: str, second: str, resistance: float) -> None:
        links[frozenset((first, second)), float(f"{resistance:.9e}")] += 1

    for row in ROWS:
        for column, width in zip(COLUMNS, widths, strict=True):
            here = f"V{row}{column}"
            if column < 8:
                add(here, f"V{row}{column + 1}", along_x[column - 1])
            if row < 3:
                add(here, f"V{row + 1}{column}", along_y[column - 1])
            carries_cell = here in ("V23", "V26")
            add(here, AMBIENT, face[width] * (2 if carries_cell else 1))
            if row in (1, 3):
                add(here, AMBIENT, edge[width])
        add(f"V{row}1", AMBIENT, left)
        add(f"V{row}8", AMBIENT, edge[W3])  # not the right edge's own value
    return links


def test_bundled_rigs_are_listed():
    assert {"paper-2024", "dual-cell"} <= set(bundled_rigs())


def test_every_link_of_the_paper_rig_is_the_model_file_s(paper):
    values = si_values(paper)
    assert paper.circuit is not None
    ours = Counter(
        (frozenset(pair), float(f"{link.factor * link.resistance.evaluate(values):.9e}"))
        for link in paper.circuit.links
        for pair in link.between
    )
    assert ours.total() == 83
    assert ours == links_as_built()


def test_paper_rig_has_the_model_file_s_total_capacitance_and_conductance(paper):
    """681.7 J/K and 4.604 W/K."""
    values = si_values(paper)
    capacitance = 24 * paper.circuit.capacitance.evaluate(values)
    conductance = sum(
        1 / (link.factor * link.resistance.evaluate(values))
        for link in paper.circuit.links
        for pair in link.between
        if AMBIENT in pair
    )
    assert capacitance == pytest.approx(24 * L * W * THICKNESS * DENSITY * SPECIFIC_HEAT)
    assert capacitance == pytest.approx(681.7, abs=0.05)
    assert conductance == pytest.approx(4.604, abs=5e-4)


def test_cells_of_the_paper_rig_are_the_model_file_s(paper):
    """V_max 16.4 V, I_max 6.4 A, dT_max 75 K at 323 K; 13.5 g a side at 1262 J/(kg K)."""
    values = si_values(paper)
    assert [cell.contacts[0][0] for cell in paper.cells] == ["V23", "V26"]
    for cell in paper.cells:
        numbers = {
            "seebeck_coefficient": 16.4 / 323,
            "electrical_resistance": 16.4 * (323 - 75) / (323 * 6.4),
            "thermal_resistance": 75 / (16.4 * 6.4) * 2 * 323 / (323 - 75),
            "side_capacitance": 17.037,
            "sink_resistance": 0.6,
            "initial_temperature": 298.0,
        }
        for name, number in numbers.items():
            assert getattr(cell, name).evaluate(values) == pytest.approx(number, rel=1e-12), name
        assert cell.contacts[0][1].evaluate(values) == 0.09
        assert cell.sink_capacitance is None


def test_paper_rig_starts_at_15_degrees(paper):
    values = si_values(paper)
    assert paper.ambient_temperature.evaluate(values) == pytest.approx(288.15)
    assert paper.initial_temperature.evaluate(values) == pytest.approx(288.15)


def test_channels_of_the_paper_rig_are_single_elements_and_one_pair(paper):
    nodes = {channel.name: tuple(channel.sensor.weights(paper.plate)) for channel in paper.channels}
    assert len(nodes) == 15
    for zone_row, row in ((1, 1), (2, 3)):
        for zone, column in enumerate((1, 3, 4, 5, 6, 8), 1):
            assert nodes[f"T{zone_row}{zone}"] == (f"V{row}{column}",)
    assert (nodes["TAM"], nodes["TBM"], nodes["TCM"]) == (("V22",), ("V24", "V25"), ("V27",))


def test_free_parameters_of_the_paper_rig_are_the_16_of_table_4_in_the_circuit(paper):
    free = [name for name, parameter in paper.parameters.items() if parameter.free]
    assert free == list(TABLE_4)
    others = [name for name in paper.parameters if name not in TABLE_4]
    assert others == ["R_Tfx1", "R_Tcy1", "alpha", "C_element", "T_amb", "T_start"]


def test_parameter_sets_of_the_paper_rig_are_the_columns_of_table_4(paper):
    sets = paper.parameter_sets
    assert sets["initial"] == {name: row[0] for name, row in TABLE_4.items()}
    assert sets["published"] == {name: row[1] for name, row in TABLE_4.items()}
    assert sets["startup"] == {name: paper.parameters[name].value for name in sets["startup"]}
    assert set(paper.parameters) - set(sets["startup"]) == {"T_amb", "T_start"}


def test_bounds_of_the_paper_rig_are_table_4_s_but_for_zero_and_two_widened_rows(paper):
    """Table 4's values of R_Tey2 and R_Tey3 lie above its own maximum of 200 K/W."""
    for name, (initial, final, maximum) in TABLE_4.items():
        parameter = paper.parameters[name]
        outside = max(initial, final) > maximum
        assert outside == (name in ("R_Tey2", "R_Tey3"))
        assert parameter.upper == (2000 if outside else maximum)
        assert parameter.lower == pytest.approx(1e-6 * parameter.upper)


def test_dual_cell_plate_is_one_millimetre_of_copper(dual):
    """Table 1 of the paper: 1 mm. The plate then stores 25.5 x 11.5 x 0.1 cm3 of copper."""
    values = si_values(dual)
    plate = dual.plate
    volume = plate.width * plate.height * plate.thickness.evaluate(values)
    assert volume == pytest.approx(0.255 * 0.115 * 0.001)
    assert plate.density.evaluate(values) == 8960
    assert plate.specific_heat.evaluate(values) == 390
    assert plate.conductivity.evaluate(values) == 401
    assert dual.circuit is None


def test_dual_cell_zones_tile_the_plate(dual):
    """Three thirds of the length, each 2 x 2: the twelve zones cover the plate once."""
    zones = {channel.name: channel.sensor for channel in dual.channels}
    area = sum(
        math.prod(high - low for low, high in (zone.x, zone.y))
        for name, zone in zones.items()
        if name[1].isdigit()
    )
    assert area == pytest.approx(dual.plate.width * dual.plate.height)
    for first, second in ((1, 2), (3, 4), (5, 6)):
        assert zones[f"T1{first}"].x[1] == pytest.approx(zones[f"T1{second}"].x[0])
        assert zones[f"T1{first}"].y[1] == pytest.approx(zones[f"T2{first}"].y[0])


def test_dual_cell_taps_are_centimetre_squares_in_the_middle_of_the_thirds(dual):
    taps = {channel.name: channel.sensor for channel in dual.channels}
    for third, name in enumerate(("TAM", "TBM", "TCM")):
        tap = taps[name]
        assert isinstance(tap, ZoneSensor)
        assert tap.x[1] - tap.x[0] == pytest.approx(0.01)
        assert tap.y[1] - tap.y[0] == pytest.approx(0.01)
        assert sum(tap.x) / 2 == pytest.approx((third + 0.5) * 0.255 / 3)
        assert sum(tap.y) / 2 == pytest.approx(0.115 / 2)


def test_both_rigs_record_the_same_channels(paper, dual):
    assert [c.name for c in paper.channels] == [c.name for c in dual.channels]


@pytest.mark.parametrize("name", ["paper-2024", "dual-cell"])
def test_a_rig_prints_its_size_and_parameters(name):
    rig = load_rig(name)
    assert str(rig).startswith(f"{name}: ")
    assert "25.5 cm x 11.5 cm, 3 x 8 elements" in str(rig)
    assert all(f"<td>{parameter}</td>" in rig._repr_html_() for parameter in rig.parameters)
    assert len(repr(rig)) < 100


def test_two_readings_of_a_file_are_equal_and_hash_alike(paper):
    again = load_rig("paper-2024")
    assert again == paper
    assert hash(again) == hash(paper)


def test_elements_are_named_by_row_and_column(paper, dual):
    assert paper.plate.element_names[:2] == ("V11", "V12")
    assert paper.plate.element_names[-1] == "V38"
    assert dual.plate.extent("V23") == pytest.approx((0.05, 0.09, 0.04, 0.08))
    with pytest.raises(KeyError):
        dual.plate.extent("V99")


@pytest.mark.parametrize("name", bundled_rigs())
def test_the_tables_of_a_file_are_the_rig_of_that_file(name: str):
    tables = tomllib.loads((data_folder() / "rigs" / f"{name}.toml").read_text())
    rig = rig_from_tables(tables, "tables")
    assert rig.fingerprint == load_rig(name).fingerprint
    assert (rig.source, rig.text) == ("tables", "")
