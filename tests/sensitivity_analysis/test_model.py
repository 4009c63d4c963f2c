"""A global analysis of a user's own model: the function of Ishigami and Homma, and closed loops."""

from typing import Any

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import PID
from jaxtwin.errors import SimulationError
from jaxtwin.sensitivity_analysis import Uniform
from jaxtwin.simulation import Reductions

Draws = dict[str, np.ndarray]

INPUTS = {name: Uniform(4 - np.pi, 4 + np.pi) for name in ("R_E", "R_Th", "R_pc")}


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("paper-2024")


def ishigami(draws: Draws) -> Draws:
    """With a = 7 and b = 0.1, in variables from -pi to pi."""
    x, y, z = (draws[name] - 4 for name in INPUTS)
    value = np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    return {"value": value, "both": np.stack([value, 2 * value], axis=1)}


def test_sobol_indices_of_the_ishigami_function(twin: Twin):
    found = jt.global_sensitivity(twin, method="sobol", inputs=INPUTS, model=ishigami, draws=4096)
    assert found.labels == ("value", "both[0]", "both[1]")
    # Ishigami and Homma (1990), from the variance's integrals.
    for output in found.labels:
        index = found.to_dataframe().loc[output]
        np.testing.assert_allclose(index["S1"], [0.3139, 0.4424, 0.0], atol=0.02)
        np.testing.assert_allclose(index["ST"], [0.5576, 0.4424, 0.2437], atol=0.02)


def test_a_failed_run_is_left_out(twin: Twin):
    def fails(draws: Draws) -> Draws:
        value = ishigami(draws)["value"]
        return {"value": np.where(np.arange(len(value)) == 3, np.nan, value)}

    found = jt.global_sensitivity(twin, method="src", inputs=INPUTS, model=fails, draws=64)
    assert list(np.flatnonzero(found.failed)) == [3]
    assert found.counted[0] == 63


@pytest.mark.slow
def test_measures_of_closed_loops_are_outputs():
    twin = Twin("single-cell")
    controller = PID(0.1, 0.001, measured=[list(twin.channels)])
    settings: dict[str, Any] = {"duration": 300, "noise": False, "quantised": False}

    def loops(draws: Draws) -> Reductions:
        measures = ["settling_time", "energy"]
        return jt.simulate_closed_loops(
            twin, controller, 30.0, draws=draws, measures=measures, **settings
        )

    found = jt.global_sensitivity(
        twin, method="pearson", model=loops, draws=8, names=["R_E", "C_load"]
    )
    assert found.labels == ("settling_time", "energy")  # as they were asked for
    assert [output.unit for output in found.outputs] == ["s", "J"]
    assert not found.failed.any()
    assert len(set(found.values[:, 0])) > 3
    for number, row in enumerate(found.samples):
        own = twin.with_values(dict(zip(found.names, row.tolist(), strict=True)))
        run = jt.simulate_closed_loop(own, controller, 30.0, **settings)
        assert found.values[number, 1] == pytest.approx(run.energy[-1], rel=1e-6)
        # From the first sample on after which all are within half a kelvin.
        out = np.flatnonzero(np.abs(run.output[:, 0] - 30.0) > 0.5)
        assert found.values[number, 0] == run.time[out[-1] + 1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"model": lambda draws: draws["R_E"]}, "returns output -> values"),
        ({"model": lambda draws: {}}, "returns output -> values"),
        ({"model": lambda draws: {"a": 1.0}}, "'a': expected a number for each of"),
        ({"model": lambda draws: {"a": np.zeros(2)}}, "'a': expected a number for each of"),
        ({"model": lambda draws: {"a": draws["R_E"].astype(str)}}, "'a': expected a number"),
        ({"model": ishigami, "outputs": ["final"]}, "outputs: expected none beside a model"),
        ({"model": ishigami, "times": [3.0]}, "times: expected none beside a model"),
        ({"model": ishigami, "method": "dgsm"}, "a method without derivatives"),
    ],
)
def test_what_does_not_go_with_a_model_is_refused(
    twin: Twin, settings: dict[str, Any], message: str
):
    arguments = {"method": "src", "names": list(INPUTS), "draws": 16, **settings}
    with pytest.raises(SimulationError, match=message):
        jt.global_sensitivity(twin, **arguments)


def test_several_twins_have_no_model(twin: Twin):
    with pytest.raises(SimulationError, match="sensitivity: twin: expected a Twin"):
        jt.global_sensitivity([twin, twin], method="src", model=ishigami)


def test_without_any_finite_output_no_parameter_is_called_the_strongest(twin: Twin):
    names = list(INPUTS)
    found = jt.global_sensitivity(
        twin,
        method="src",
        names=names,
        draws=16,
        model=lambda values: {"nothing": np.full(len(values[names[0]]), np.nan)},
    )
    assert "no index is known" in repr(found)
    assert "strongest" not in repr(found)
