"""Linear models of rigs whose lid, fan, supply or coolant change."""

import numpy as np
import pytest
from boxes import box, box_table

from jaxtwin import Experiment, Twin, linearize, simulate
from jaxtwin.control import StateSpace
from jaxtwin.errors import ControlError
from jaxtwin.rig import rig_from_tables

OTHER = {"lid": "open", "fan": 0.4, "V_supply": 11.0, "T_water": 28.0}


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(box())


@pytest.fixture(scope="module")
def other() -> Twin:
    """The same rig, in whose file the inputs have other values."""
    table = box_table()
    for one in table["inputs"]:
        one["value"] = OTHER[one["name"]]
    return Twin(rig_from_tables(table, "box"))


def assert_equal(found: StateSpace, expected: StateSpace) -> None:
    for name in ("A", "B", "C"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9)
    for name in ("duty", "nodes", "outputs"):
        one, two = (getattr(model.operating_point, name) for model in (found, expected))
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_given_inputs_are_those_of_a_rig_file_with_these_values(twin: Twin, other: Twin):
    point = {"T1": 30.0}
    assert_equal(linearize(twin, duty=0.3, inputs=OTHER), linearize(other, duty=0.3))
    assert_equal(
        linearize(twin, temperatures=point, inputs=OTHER), linearize(other, temperatures=point)
    )
    closed = linearize(twin, duty=0.3)
    assert_equal(linearize(twin, duty=0.3, inputs={"lid": 0}), closed)
    assert np.abs(linearize(twin, duty=0.3, inputs=OTHER).A - closed.A).max() > 1e-3


@pytest.mark.slow
def test_a_time_of_a_run_has_the_inputs_of_the_run(twin: Twin):
    """The rates are those of the run, in which the lid has been opened shortly before."""
    lid = np.repeat([0.0, 1.0], [100, 101])
    time = np.arange(0, 50.1, 0.25)
    run = simulate(twin, Experiment(time, np.full(201, 0.5), ambient=20.0).with_inputs(lid=lid))
    model = linearize(twin, run=run, time=30.0)
    slope = (run.states[121] - run.states[119]) / 0.5
    assert model.offset is not None
    np.testing.assert_allclose(model.offset, slope, atol=1e-4)
    air = run.nodes.index("air")
    assert slope[air] < -0.01
    still = linearize(twin, run=simulate(twin, run.experiment.with_inputs(lid=0)), time=30.0)
    assert model.A[air, air] < 2 * still.A[air, air] < 0


@pytest.mark.slow
def test_unknown_inputs_and_states_are_refused(twin: Twin):
    for inputs, message in (
        ({"door": 1.0}, "linearize: inputs: unknown input 'door'"),
        ({"lid": "ajar"}, "linearize: input lid: unknown state 'ajar'"),
        ({"lid": 2.0}, "linearize: input lid: expected closed, open, or 0 to 1, got 2"),
        ({"fan": "fast"}, "linearize: input fan: expected a number, got 'fast'"),
    ):
        with pytest.raises(ControlError, match=message):
            linearize(twin, duty=0.3, inputs=inputs)
    run = simulate(twin, Experiment(np.arange(9.0), np.full(9, 0.5), ambient=20.0))
    with pytest.raises(ControlError, match="inputs: expected none beside a run"):
        linearize(twin, run=run, time=3.0, inputs={"lid": 1})
