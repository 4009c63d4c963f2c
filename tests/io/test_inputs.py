"""Inputs besides the duty in experiments, schedules and files."""

import pickle
import re

import numpy as np
import pytest
from boxes import box, box_file
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxtwin as jt
from jaxtwin import Experiment
from jaxtwin.cli import run
from jaxtwin.errors import RecordingError
from jaxtwin.io import read_recording, write_recording

NAMES = st.text("abcdefgh_", min_size=1, max_size=6)
COLUMNS = st.one_of(
    st.lists(st.floats(-1e9, 1e9), min_size=5, max_size=5),
    st.lists(st.sampled_from(["open", "closed", "half_open"]), min_size=5, max_size=5),
)


@given(st.dictionaries(NAMES, COLUMNS, max_size=3))
@settings(max_examples=30, deadline=None)
def test_every_format_reads_back_equal_inputs(tmp_path_factory, inputs):
    folder = tmp_path_factory.mktemp("inputs")
    experiment = Experiment(
        range(5), [0.0, 0.5, 0.5, 0.0, 1.0], channels=["T1"], temperatures=range(5), inputs=inputs
    )
    assert pickle.loads(pickle.dumps(experiment)) == experiment
    assert Experiment.from_dataframe(experiment.to_dataframe()) == experiment
    for ending in ("csv", "nc"):
        path = write_recording(experiment, folder / f"run.{ending}")
        assert read_recording(path) == experiment


def test_parts_keep_their_inputs():
    experiment = Experiment(range(4), [0, 0, 1, 1], inputs={"lid": ["a", "b", "b", "c"]})
    assert experiment.between(1, 3).inputs["lid"].tolist() == ["b", "b"]
    assert experiment.with_inputs(lid="open").inputs["lid"].tolist() == ["open"] * 4
    assert experiment != experiment.with_inputs(lid="open")


def test_a_column_with_the_name_of_an_input_is_read_with_the_rig(tmp_path):
    path = tmp_path / "box.csv"
    path.write_text("time_s,duty_P1,T1_degC,lid,fan\n0,0.5,20,closed,True\n1,0.5,21,open,False\n")
    experiment = read_recording(path, rig=box())
    assert experiment.inputs["lid"].tolist() == ["closed", "open"]
    assert experiment.inputs["fan"].tolist() == [1.0, 0.0]
    with pytest.raises(RecordingError, match="got 'lid'"):
        read_recording(path)
    named = read_recording(path, columns={"lid": "input_cover"}, ignore=["fan"])
    assert named.inputs["cover"].tolist() == ["closed", "open"]


def test_a_schedule_of_an_input_holds_each_value_until_the_next():
    experiment = Experiment.schedule(
        "0:0.5", duration=10, step=5, inputs={"lid": "0:closed,7:open", "flow": "0:1.5,5:0"}
    )
    assert experiment.time.tolist() == [0, 5, 7, 10]
    assert experiment.inputs["lid"].tolist() == ["closed", "closed", "open", "open"]
    assert experiment.inputs["flow"].tolist() == [1.5, 0, 0, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("5:open", "expected a first time of 0 s, got 5 s"),
        ("0:closed,20:open", "expected times from 0 s to before the end at 10 s, got 20 s"),
        ("open", "expected text such as '0:closed,600:open', got 'open'"),
        ("0:", "got '0:'"),
    ],
)
def test_a_wrong_schedule_of_an_input_is_refused(text, message):
    with pytest.raises(RecordingError, match=re.escape(message)):
        Experiment.schedule("0:0.5", duration=10, step=1, inputs={"lid": text})


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"lid": [0, 1]}, "input lid: expected one value or shape (3,), got shape (2,)"),
        ({"lid": [0, np.nan, 1]}, "input lid: expected finite numbers, got nan"),
        ({"a b": 1}, "inputs: expected names of letters, digits and _, got 'a b'"),
    ],
)
def test_wrong_inputs_of_an_experiment_are_refused(inputs, message):
    with pytest.raises(jt.errors.RecordingError, match=re.escape(message)):
        Experiment([0, 1, 2], [0, 0, 0], inputs=inputs)


def test_import_says_what_the_columns_of_inputs_hold(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    box_file(tmp_path)
    (tmp_path / "raw.csv").write_text(
        "time_s,heater,T1,cover,fan\n0,0.5,20,closed,True\n1,0.5,21,open,False\n"
    )
    columns = ["--column", "heater=duty_P1", "--column", "cover=input_lid"]
    assert run(["import", "raw.csv", "--rig", "box.toml", *columns, "--out", "run.csv"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "input_fan from fan 0 to 1" in told
    assert "input_lid from cover closed, open" in told
    assert "inputs of box without a column: V_supply, T_water" in told
    assert read_recording("run.csv").inputs["lid"].tolist() == ["closed", "open"]


@pytest.mark.parametrize(
    ("title", "numbers"),
    [
        ("Coolant (°F)", [59.0, 68.0]),
        ("Coolant [K]", [288.15, 293.15]),
        ("Coolant/degC", [15.0, 20.0]),
        ("Coolant", [15.0, 20.0]),
    ],
)
def test_an_input_arrives_in_the_unit_of_the_rig_file(tmp_path, title, numbers):
    path = tmp_path / "box.csv"
    rows = "".join(f"{k};0.5;20;{number}\n" for k, number in enumerate(numbers))
    path.write_text(f"time_s;duty_P1;T1_degC;{title}\n{rows}", encoding="utf-8")
    for name in ("T_water", "input_T_water"):
        run = read_recording(path, rig=box(), columns={title: name})
        np.testing.assert_allclose(run.inputs["T_water"], [15, 20], atol=1e-9)


def test_an_input_of_another_quantity_is_refused(tmp_path):
    path = tmp_path / "box.csv"
    path.write_text("time_s,duty_P1,T1_degC,Supply (mV)\n0,0.5,20,12000\n1,0.5,20,12000\n")
    run = read_recording(path, rig=box(), columns={"Supply (mV)": "V_supply"})
    assert run.inputs["V_supply"].tolist() == [12, 12]
    with pytest.raises(RecordingError, match=r"unit of input_T_water in the rig file, .* got 'mV'"):
        read_recording(path, rig=box(), columns={"Supply (mV)": "T_water"})
    with pytest.raises(RecordingError, match="which rig= gives, got 'mV'"):
        read_recording(path, columns={"Supply (mV)": "input_supply"})
