"""Nodes with a temperature of their own at the start."""

import re

import numpy as np
import pytest
from boxes import box, box_table

import jaxtwin as jt
from jaxtwin import Experiment, Twin
from jaxtwin.errors import RigError, SimulationError
from jaxtwin.rig import rig_from_tables

IDLE = Experiment.schedule("0:0", duration=100, step=10, ambient=20.0)


@pytest.mark.slow
def test_nodes_begin_as_the_rig_file_says():
    table = box_table()
    table["initial"] = {"temperature": "25 degC", "nodes": {"air": "T_air", "P1.TH": "40 degC"}}
    table["parameters"]["T_air"] = {"value": 30.0, "unit": "degC", "bounds": [0.0, 60.0]}
    twin = Twin(rig_from_tables(table, "box"))
    run = jt.simulate(twin, IDLE)
    first = dict(zip(run.nodes, run.states[0], strict=True))
    assert first == pytest.approx(
        {"V11": 25, "V12": 25, "P1.TC": 25, "P1.TH": 40, "P1.SINK": 25, "air": 30}
    )
    warmer = jt.simulate(twin.with_values({"T_air": 33.0}), IDLE)
    assert warmer.states[0, run.nodes.index("air")] == pytest.approx(33.0)


@pytest.mark.slow
def test_some_nodes_begin_as_given_and_the_others_as_the_rig_says():
    twin = Twin(box())
    run = jt.simulate(twin, IDLE, initial={"air": 31.0})
    array = np.full(len(run.nodes), 20.0)
    array[run.nodes.index("air")] = 31.0
    np.testing.assert_array_equal(run.states, jt.simulate(twin, IDLE, initial=array).states)
    batch = jt.simulate_batch(twin, IDLE, {"R_air": np.array([0.8])}, initial={"air": 31.0})
    np.testing.assert_allclose(batch[0], run.temperatures, atol=1e-4)


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"ari": 20.0}, "initial: unknown node 'ari', did you mean 'air'?"),
        ({"air": -300.0}, "initial: air: expected -273.15 degC and above, got -300 degC"),
        ({"air": np.nan}, "initial: air: expected a finite number"),
    ],
)
def test_a_wrong_start_of_a_node_is_refused(initial, message):
    with pytest.raises(SimulationError, match=re.escape(message)):
        jt.simulate(Twin(box()), IDLE, initial=initial)


def test_the_start_of_an_unknown_node_is_refused():
    table = box_table()
    table["initial"] = {"nodes": {"ari": "20 degC"}}
    with pytest.raises(RigError, match=re.escape("initial.nodes: unknown node 'ari'")):
        jt.physics.build_netlist(rig_from_tables(table, "box"))


@pytest.mark.slow
def test_a_match_holds_only_the_starts_that_are_given(tmp_path):
    table = box_table()
    table["initial"] = {"nodes": {"air": "T_air", "P1.SINK": "T_sink"}}
    for name in ("T_air", "T_sink"):
        table["parameters"][name] = {
            "value": 22.0, "unit": "degC", "bounds": [0.0, 60.0], "free": True,
            "scope": "recording", "prior": {"spread": 10.0},
        }  # fmt: skip
    twin = Twin(rig_from_tables(table, "box"))
    truth = twin.with_values({"T_air": 28.0, "T_sink": 35.0})
    experiment = Experiment.schedule("0:0.3,300:0", duration=900, step=5, ambient=20.0)
    stated = experiment.with_inputs(lid="closed", fan=1.0, V_supply=12.0, T_water=20.0)
    recording = jt.simulate(truth, stated).to_recording(noise=0.02, seed=1)
    fit = jt.match(twin, recording, initial={"air": 28.0})
    assert not fit.parameters["T_air"].free
    assert fit.parameters["T_sink"].value == pytest.approx(35.0, abs=1.0)
    fit.save(tmp_path / "fit.toml")
    again = jt.Fit.load(tmp_path / "fit.toml", experiments=recording, rig=twin.rig)
    assert again.comparisons is not None
    assert fit.comparisons is not None
    np.testing.assert_allclose(
        again.comparisons[0].run.temperatures, fit.comparisons[0].run.temperatures, atol=1e-9
    )
