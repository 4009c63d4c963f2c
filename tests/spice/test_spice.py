"""The SPICE text, and what another simulator makes of it."""

import dataclasses
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hand_rig import rig_of_many_parts
from heated_box import cell_and_heater, heated_box
from small_results import fit, recordings

from jaxtwin import load_rig
from jaxtwin.errors import ParameterError, SimulationError
from jaxtwin.io import Experiment
from jaxtwin.physics import Twin
from jaxtwin.simulation import simulate
from jaxtwin.spice import to_spice

STEPS = Experiment.schedule("0:0.502,500:0.784", duration=1000.0, cells=2)


def run_ngspice(text: str, folder: Path) -> tuple[list[str], np.ndarray]:
    """Names and numbers of the table that the text makes ngspice write."""
    (folder / "net.cir").write_text(text, encoding="utf-8")
    command = ["ngspice", "-b", "net.cir"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    complaints = [line for line in done.stderr.splitlines() if "Reference value" not in line]
    assert not "".join(complaints).strip(), done.stderr
    lines = (folder / "temperatures.txt").read_text().splitlines()
    return lines[0].split(), np.loadtxt(lines[1:])


def largest_difference(twin: Twin, experiment: Experiment, folder: Path) -> float:
    """Between the twin's simulation and ngspice's, over all nodes and samples, K."""
    _, table = run_ngspice(to_spice(twin, experiment), folder)
    elapsed = experiment.time - experiment.time[0]
    rows = np.searchsorted(table[:, 0], elapsed - 1e-7)
    np.testing.assert_allclose(table[rows, 0], elapsed, atol=1e-7)
    return float(np.abs(table[rows, 1:] - simulate(twin, experiment).states).max())


@pytest.mark.slow
@pytest.mark.ngspice
@pytest.mark.parametrize(
    ("rig", "parameter_set"),
    [("paper-2024", "startup"), ("paper-2024", "published"), ("dual-cell", None)],
)
def test_twin_agrees_with_ngspice_on_the_paper_s_steps(rig, parameter_set, tmp_path):
    """Within 2 mK in every node. What limits it is ngspice's step control at reltol = 1e-8: up to
    0.6 mK at the cells with the published values, 0.1 mK elsewhere."""
    rig = load_rig(rig)
    twin = Twin(rig, None if parameter_set is None else rig.parameter_sets[parameter_set])
    assert largest_difference(twin, STEPS, tmp_path) < 2e-3


@pytest.mark.slow
@pytest.mark.ngspice
@pytest.mark.parametrize(
    ("rig", "values", "allowed"),
    [
        ("paper-2024", {}, 2e-3),
        ("dual-cell", {"t_delay": 2.0}, 2e-3),
    ],
)
def test_twin_agrees_with_ngspice_under_random_drive_and_ambient(rig, values, allowed, tmp_path):
    """Both directions, both cells apart, uneven samples that do not start at 0, and an ambient
    temperature that changes with the samples: both averagings in full."""
    rng = np.random.default_rng(3)
    time = 7.5 + np.cumsum(rng.uniform(1, 5, 80))
    ambient = 16 + np.cumsum(rng.normal(0, 0.2, 80))
    experiment = Experiment(time, rng.uniform(-1, 1, (80, 2)), ambient=ambient)
    assert largest_difference(Twin(rig, values), experiment, tmp_path) < allowed


@pytest.mark.slow
@pytest.mark.ngspice
@pytest.mark.parametrize("averaging", ["on-off", "voltage"])
def test_heaters_agree_with_ngspice(averaging, tmp_path):
    """On a plate beside a cell, by power and by resistance; and without a plate."""
    rng = np.random.default_rng(3)
    time = np.arange(0, 200.0, 4)
    duty = rng.uniform(0, 1, (50, 3))
    duty[:, 0] -= 0.5
    mixed = Twin(cell_and_heater(averaging))
    assert largest_difference(mixed, Experiment(time, duty), tmp_path) < 2e-3
    box = Twin(heated_box())
    assert largest_difference(box, Experiment(time, duty[:, 1:]), tmp_path) < 2e-3


@pytest.mark.slow
@pytest.mark.ngspice
def test_twin_agrees_with_ngspice_on_an_open_off_phase(make_rig, tmp_path):
    """A rig of one cell on one element, and another number of nodes."""
    rig = make_rig(["3 cm", "2 cm"], ["3 cm"], [{"V11": "0.2 K/W"}], off_phase="open")
    experiment = Experiment.schedule("0:0.3,100:-0.7,200:0", duration=300.0, cells=1)
    assert largest_difference(Twin(rig), experiment, tmp_path) < 2e-3


@pytest.mark.slow
@pytest.mark.ngspice
@pytest.mark.parametrize("averaging", ["on-off", "voltage"])
def test_twin_agrees_with_ngspice_on_a_rig_of_many_parts(averaging, tmp_path):
    """In both directions, with the limit reached and not."""
    experiment = Experiment.schedule("0:0.3,40:-0.8,80:1", duration=120.0, cells=1)
    twin = Twin(rig_of_many_parts(averaging))
    assert largest_difference(twin, experiment, tmp_path) < 2e-3


@pytest.mark.slow
@pytest.mark.ngspice
def test_names_that_spice_cannot_hold_are_written_in_its_own_way(tmp_path):
    """To SPICE `Zelle_1` and `zelle_1` are one; blanks, dots and Greek are none of its letters."""
    rig = load_rig("dual-cell")
    names = ("Zelle α.1", "zelle Α 1")
    cells = [
        dataclasses.replace(cell, name=name) for cell, name in zip(rig.cells, names, strict=True)
    ]
    twin = Twin(dataclasses.replace(rig, cells=tuple(cells), name="two\nlines"))
    experiment = Experiment.schedule("0:1", duration=3.0, cells=2, name="three\n.end\nlines")
    header, table = run_ngspice(to_spice(twin, experiment), tmp_path)
    assert len(set(header)) == len(header) == table.shape[1] == 1 + len(twin.netlist.nodes)
    assert table[-1, 0] == 3.0


@pytest.fixture(scope="module")
def text() -> str:
    return to_spice(Twin("paper-2024"), STEPS)


def test_every_link_is_a_resistor_of_its_own(text):
    """89 links; V18 has three to the surroundings, kept apart."""
    resistors = re.findall(r"^(R\w+) (\w+) (\w+) (\S+) ; (.*)$", text, re.MULTILINE)
    assert len(resistors) == len({name.lower() for name, *_ in resistors}) == 89
    to_air = [resistor for resistor in resistors if resistor[1:3] == ("V18", "ambient")]
    assert [(name, formula) for name, *_, formula in to_air] == [
        ("Rfilm_V18_ambient", "R_Tez3"),
        ("Rfilm_V18_ambient_2", "R_Tey3"),
        ("Rfilm_V18_ambient_3", "R_Tey3"),
    ]
    assert [float(value) for *_, value, _ in to_air] == [
        11.11638958160155,
        *[175.63265938391115] * 2,
    ]


def test_every_node_is_a_capacitor_with_a_start(text):
    """The cells start at 298 K, 9.85 K above the surroundings."""
    capacitors = dict(re.findall(r"^C_(\w+) \w+ 0 (\S+) ;", text, re.MULTILINE))
    starts = dict(re.findall(r"^\.ic v\((\w+)\)=(\S+)$", text, re.MULTILINE))
    assert len(capacitors) == 28
    assert capacitors.keys() == starts.keys()
    assert float(capacitors["V11"]) == 28.402483200000002
    assert float(starts["V11"]) == 0.0
    assert float(starts["P1_TC"]) == pytest.approx(9.85)


def test_drive_is_held_and_then_steps(text):
    """A corner at every sample, and one microsecond for the step at 500 s."""
    found = re.search(r"^Vduty_1 duty_1 0 PWL\((.*?)\)", text, re.MULTILINE | re.DOTALL)
    assert found is not None
    points = np.array(found[1].replace("+", " ").split(), float).reshape(-1, 2)
    assert len(points) == 1001 + 1
    assert points[[0, 500, 501, 502, -1]].tolist() == [
        [0.0, 0.502],
        [500.0, 0.502],
        [500.000001, 0.784],
        [501.0, 0.784],
        [1000.0, 0.784],
    ]


def test_parameters_stand_in_a_comment_in_si_units():
    text = to_spice(Twin("paper-2024", {"R_E": 1.25, "T_amb": 18.0}), STEPS)
    assert "\n* R_E = 1.25 (electrical resistance of a cell)\n" in text
    assert "\n* T_amb = 291.15 (" in text
    assert "\n.param T_ref=291.15\n" in text


def test_a_parameter_without_a_description_has_no_empty_brackets():
    rig = load_rig("paper-2024")
    bare = {name: dataclasses.replace(row, description="") for name, row in rig.parameters.items()}
    text = to_spice(Twin(dataclasses.replace(rig, parameters=bare)), STEPS)
    for name in bare:
        assert re.search(rf"^\* {name} = \S+$", text, re.MULTILINE)


def test_recorded_ambient_takes_the_place_of_the_rig_s():
    experiment = Experiment(STEPS.time, STEPS.duty, ambient=21.0)
    assert "\n.param T_ref=294.15\n" in to_spice(Twin("paper-2024"), experiment)


def test_another_number_of_cells_is_refused():
    with pytest.raises(SimulationError, match="expected the 2 cells of paper-2024, got 1"):
        to_spice(Twin("paper-2024"), Experiment.schedule("0:1", duration=10.0))


def test_several_draws_are_refused():
    twin = Twin("paper-2024", {"R_E": np.array([1.0, 2.0])})
    with pytest.raises(ParameterError, match="parameter R_E: expected one value, got 2"):
        to_spice(twin, STEPS)


@pytest.mark.slow
def test_a_fit_gives_the_values_of_each_recording():
    """Each of the two recordings has an ambient temperature of its own."""
    for name, experiment in zip(("synthetic-A", "synthetic-B"), recordings(), strict=True):
        assert to_spice(fit(), experiment) == to_spice(fit().twins[name], experiment)
    first, second = (to_spice(fit().twins[name], recordings()[0]) for name in fit().recordings)
    assert first != second
