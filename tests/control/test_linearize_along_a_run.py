"""Linear models about a state of a run: against central differences and the run that goes on."""

from typing import Any

import jax
import numpy as np
import pytest
from central_differences import differences

from jaxtwin import Experiment, Twin, export_c, linearize, simulate
from jaxtwin.control import design_lqi
from jaxtwin.errors import ControlError
from jaxtwin.simulation import Run

# After this time under one duty the commands have long arrived, s, and the plate still warms.
WARM_UP = 60.0


@pytest.fixture(scope="module")
def run(twin: Twin) -> Run:
    """A warm-up at a duty of 0.5 and 0.3, with a step up at 60 s, and a sample each 0.5 s."""
    time = np.arange(0.0, 90.5, 0.5)
    drive = np.where(time[:, None] < WARM_UP, [0.5, 0.3], [0.55, 0.4])
    return simulate(twin, Experiment(time, drive))


@pytest.mark.slow
def test_matrices_and_rates_are_those_of_the_run(twin: Twin, run: Run, float64):
    """To 1e-6 by central differences of the equations; the rates also by those of the run."""
    model = linearize(twin, run=run, time=WARM_UP)
    system = twin.system()
    reference = system.ambient_temperature
    at = run.states[120] + 273.15 - float(reference)
    duty = np.array([0.5, 0.3])
    np.testing.assert_allclose(model.operating_point.nodes, run.states[120], atol=1e-12)
    np.testing.assert_allclose(model.operating_point.outputs, run.temperatures[120], atol=1e-9)
    np.testing.assert_allclose(model.operating_point.duty, duty, atol=1e-4)
    rate = jax.jit(
        lambda nodes, duty: system.heat_into_nodes(nodes, duty, reference) / system.capacitance
    )
    held = jax.numpy.asarray(model.operating_point.duty)
    by_nodes = differences(lambda nodes: rate(nodes, held), at, 0.05)
    by_duty = differences(lambda duty: rate(jax.numpy.asarray(at), duty), np.asarray(held), 1e-3)
    for found, expected in ((model.A, by_nodes), (model.B, by_duty)):
        rows = np.abs(expected).max(axis=1, keepdims=True)
        scale = np.maximum(rows, 1e-3 * rows.max())
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-6)
    of_run = (run.states[121] - run.states[119]) / 1.0
    assert model.offset is not None
    np.testing.assert_allclose(model.offset, of_run, rtol=0, atol=2e-3 * np.abs(of_run).max())
    assert np.abs(model.offset).max() > 0.05


@pytest.mark.slow
def test_the_next_seconds_are_those_of_the_twin(twin: Twin, run: Run):
    """With a step of the duty; without the rates it would miss 5 K of the 6 K."""
    model = linearize(twin, run=run, time=WARM_UP)
    found = model.discretise(0.5).simulate(run.experiment.duty[120:])
    expected = run.temperatures[120:]
    change = np.abs(expected - expected[0]).max()
    assert change > 3
    assert np.abs(found - expected).max() < 0.01 * change
    rest = model.at_rest()
    assert rest.offset is None
    discrete = rest.discretise(0.5)
    start = np.zeros(len(discrete.A))
    start[: len(model.A)] = run.states[120] - np.asarray(rest.operating_point.nodes)
    same = discrete.simulate(run.experiment.duty[120:], start)
    np.testing.assert_allclose(same, found, rtol=0, atol=1e-8)
    # Under its own duty the affine model comes to where the other is at rest.
    np.testing.assert_allclose(
        model.discretise(0.5).start(np.asarray(model.operating_point.duty))[: len(model.A)],
        np.asarray(rest.operating_point.nodes) - run.states[120],
        atol=1e-6,
    )


@pytest.mark.slow
def test_at_a_rest_it_is_the_model_of_the_duty(twin: Twin):
    duty = [0.4, 0.3]
    still = simulate(twin, Experiment([0.0, 20_000.0], [duty, duty]), initial="steady")
    model, expected = linearize(twin, run=still, time=20_000), linearize(twin, duty=duty)
    assert model.offset is not None
    np.testing.assert_allclose(model.offset, 0, atol=1e-9)
    np.testing.assert_allclose(model.A, expected.A, rtol=0, atol=1e-9)
    np.testing.assert_allclose(model.operating_point.duty, duty, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"time": 60.0}, "expected one of duty, temperatures and run, got none"),
        ({"run": True, "duty": 0.1, "time": 1}, "temperatures and run, got duty and run"),
        ({"run": True}, "expected a time beside a run, s, got no time"),
        ({"duty": 0.4, "time": 3.0}, r"got time 3\.0 without a run"),
        ({"run": True, "time": 91.0}, "time: expected 0 to 90 s, the times of the run, got 91 s"),
        ({"run": True, "time": np.nan}, "time: expected a finite number"),
    ],
)
def test_a_time_without_a_run_or_outside_of_it_is_refused(
    twin: Twin, run: Run, arguments: dict[str, Any], message: str
):
    given: Any = {name: run if value is True else value for name, value in arguments.items()}
    with pytest.raises(ControlError, match=message):
        linearize(twin, **given)


def test_a_run_of_another_rig_is_refused(run: Run):
    with pytest.raises(ControlError, match="run: expected a run of single-cell, whose nodes"):
        linearize(Twin("single-cell"), run=run, time=1.0)


@pytest.mark.slow
def test_designs_on_a_state_that_is_not_at_rest_are_refused(twin: Twin, run: Run, tmp_path: Any):
    model = linearize(twin, run=run, time=WARM_UP)
    for use in (
        lambda: model.reduce(4),
        lambda: design_lqi(model.discretise(1.0)),
        lambda: export_c(model.discretise(1.0), tmp_path),
    ):
        with pytest.raises(ControlError, match=r"take StateSpace\.at_rest\(\) first"):
            use()
    assert model.at_rest().reduce(4).A.shape == (4, 4)
