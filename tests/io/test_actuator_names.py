"""Columns of duty belong to the cells and heaters of a rig by their names, whatever their order."""

import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas
import pytest
from heated_box import heated_box
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Twin
from jaxtwin.data import data_folder
from jaxtwin.errors import MatchError, RecordingError, SimulationError
from jaxtwin.io import Experiment, read_recording, write_recording
from jaxtwin.io._experiment import as_experiments
from jaxtwin.rig import Rig, rig_from_tables
from jaxtwin.spice import to_spice

# Names that cells may have; some look like units, and not all can be written without quotes.
NAMES: tuple[str, ...] = (
    "P1",
    "P2",
    "P3",
    "P4",
    "left",
    "right",
    "foil",
    "hot end",
    "T_s",
    "a,b",
    "Ω",
)


def rig_of(cells: Sequence[str], heaters: Sequence[str] = ()) -> Rig:
    """The plate of the single cell, with cells and heaters of these names in this order."""
    document = tomllib.loads((data_folder() / "rigs" / "single-cell.toml").read_text())
    cell = document["cells"][0]
    document["cells"] = [{**cell, "name": name} for name in cells]
    document["heaters"] = [{"name": name, "power": "5 W", "contacts": ["V11"]} for name in heaters]
    return rig_from_tables(document, "rig.toml")


def level(name: str) -> float:
    """A duty by which a cell or heater of this name is recognised."""
    return (1 + NAMES.index(name)) / 100


def levels(names: Sequence[str]) -> np.ndarray:
    return np.tile([level(name) for name in names], (3, 1))


@st.composite
def cells_and_orders(draw: st.DrawFn) -> tuple[list[str], list[str], list[str]]:
    """The cells and the heaters of a rig, and all of them in another order."""
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=4, unique=True))
    heaters = draw(st.integers(0, len(names) - 1))
    return names[heaters:], names[:heaters], draw(st.permutations(names))


@given(cells_and_orders(), st.sampled_from(["csv", "nc"]))
def test_files_in_any_order_arrive_in_that_of_the_rig(tmp_path_factory, case, ending: str):
    cells, heaters, order = case
    rig = rig_of(cells, heaters)
    file: Path = tmp_path_factory.mktemp("order") / f"run.{ending}"
    write_recording(Experiment([0, 1, 2], levels(order), cells=order), file)
    found = read_recording(file, rig=rig)
    assert found.cells == rig.driven
    np.testing.assert_array_equal(found.duty, levels(rig.driven))
    again = write_recording(found, file)
    assert read_recording(again, rig=rig) == found
    assert read_recording(again, rig=rig).cells == found.cells


@given(cells_and_orders())
def test_tables_in_any_order_arrive_in_that_of_the_rig(case):
    cells, heaters, order = case
    rig = rig_of(cells, heaters)
    given_ = Experiment([0, 1, 2], levels(order), cells=order)
    frame = given_.to_dataframe()
    assert list(frame.columns) == [f"duty_{name}" for name in order]
    for found in (
        Experiment.from_dataframe(frame, rig=rig),
        Experiment.from_xarray(given_.to_xarray()).for_rig(rig),
        as_experiments("match", given_, MatchError, rig)[0],
    ):
        assert found.cells == rig.driven
        np.testing.assert_array_equal(found.duty, levels(rig.driven))


@given(st.permutations(["P1", "P2", "P3"]), st.permutations(["P1", "P2", "P3"]))
def test_a_file_read_without_its_rig_meets_the_rig_by_name(tmp_path_factory, of_file, of_rig):
    """Also counts: the driver's scale and polarity are those of all."""
    file = tmp_path_factory.mktemp("order") / "run.csv"
    titles = ["time_s", *(f"pwm_{name}" for name in of_file)]
    rows = [[k, *(round(100 * level(name)) for name in of_file)] for k in range(3)]
    pandas.DataFrame(rows, columns=titles).to_csv(file, index=False)
    plain = read_recording(file, counts=100)
    assert plain.cells == ("P1", "P2", "P3")
    np.testing.assert_array_equal(plain.duty, levels(("P1", "P2", "P3")))
    rig = rig_of(of_rig)
    with_rig = read_recording(file, rig=rig, counts=100, polarity=1)
    assert plain.for_rig(rig) == with_rig
    np.testing.assert_array_equal(with_rig.duty, levels(rig.driven))


def test_numbers_call_those_that_have_other_names():
    """The oven's top and bottom were P1 and P2 in older files."""
    rig = rig_of(["left", "right"], ["foil"])
    found = Experiment([0, 1], [[0.3, 0.1, 0.2]] * 2, cells=["P3", "P1", "P2"]).for_rig(rig)
    assert found.cells == ("left", "right", "foil")
    assert found.duty[0].tolist() == [0.1, 0.2, 0.3]
    assert rig_of(["P2", "right"]).driven_called("P1") is None
    assert rig_of(["P2", "right"]).driven_called("P2") == "P2"


@pytest.mark.parametrize("cells", [["P1", "P2"], ["foil", "P2"], ["P3", "foil"]])
def test_other_cells_are_refused(tmp_path, cells):
    rig = rig_of(["P3"], ["P1"])
    drive = Experiment([0, 1], [[0.1, 0.2]] * 2, cells=cells, name="run")
    with pytest.raises(RecordingError, match="run: duty: expected columns of P3, P1, as single-"):
        drive.for_rig(rig)
    with pytest.raises(SimulationError, match="run: duty: expected columns of P3, P1"):
        Twin(rig).simulate(drive)
    file = write_recording(drive, tmp_path / "run.csv")
    with pytest.raises(RecordingError, match=r"P3, P1|duty_P3, duty_P1"):
        read_recording(file, rig=rig)


def test_a_constant_duty_is_that_of_what_has_no_column(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("time_s,duty_foil\n0,0.5\n1,0.5\n")
    found = read_recording(file, rig=rig_of(["P2", "P1"], ["foil"]), duty=0)
    assert found.cells == ("P2", "P1", "foil")
    assert found.duty[0].tolist() == [0, 0, 0.5]
    assert "duty_P2, duty_P1: 0 throughout, as stated" in found.notes
    with pytest.raises(RecordingError, match="expected drives of P2, P1, foil, got foil; duty="):
        read_recording(file, rig=rig_of(["P2", "P1"], ["foil"]))


def test_a_scale_may_have_the_name_of_the_heater(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("time_s,power,duty_P1\n0,5,0\n1,10,1\n")
    found = read_recording(
        file, rig=heated_box(), columns={"power": "duty_bulb"}, scale={"duty_bulb": "1/10 W"}
    )
    assert found.duty.tolist() == [[0, 0.5], [1, 1]]
    assert found.cells == ("heater", "bulb")


def test_a_run_calls_its_heaters_by_their_names():
    twin = Twin(heated_box())
    plan = Experiment([0, 1, 2], [[0.1, 0.9]] * 3, cells=["bulb", "heater"])
    run = twin.simulate(plan)
    assert run.temperatures == pytest.approx(twin.simulate("0:0.9/0.1", duration=2).temperatures)
    assert run.to_xarray()["cell"].values.tolist() == ["heater", "bulb"]
    assert run.to_recording().cells == ("heater", "bulb")
    assert Experiment.from_xarray(run.to_recording().to_xarray()) == run.to_recording()
    texts = [text.get_text() for axes in run.plot().axes for text in axes.texts]
    assert {"heater", "bulb"} <= set(texts)


def test_what_does_not_reorder_refuses_another_order():
    twin = Twin(heated_box())
    plan = Experiment([0, 1, 2], [[0.1, 0.9]] * 3, cells=["bulb", "heater"], name="plan")
    with pytest.raises(SimulationError, match=r"the order of heated box, heater, bulb, got bulb"):
        to_spice(twin, plan, output="out.txt")


@pytest.mark.parametrize("cells", [["a"], ["a", "a"], ["a", ""], {"a", "b"}])
def test_names_that_belong_to_no_column_are_refused(cells):
    with pytest.raises(RecordingError, match="cells: expected"):
        Experiment([0, 1], [[0, 0], [0, 0]], cells=cells)


def test_equal_recordings_drive_the_same_cells():
    plain = Experiment([0, 1], [[0.1, 0.2]] * 2)
    first = Experiment([0, 1], [[0.1, 0.2]] * 2, cells=["P1", "P2"])
    assert plain == first
    assert first != Experiment([0, 1], [[0.1, 0.2]] * 2, cells=["P2", "P1"])
