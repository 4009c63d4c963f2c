"""Margins of a controller on a twin, against the loop written out by hand."""

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import (
    PID,
    DecoupledPI,
    FunctionController,
    decoupling_of,
    design_lqi,
    loop_margins,
)
from jaxtwin.errors import ControlError


@pytest.fixture(scope="module")
def single() -> Twin:
    return Twin("single-cell")


@pytest.mark.slow
def test_a_pi_has_the_margins_of_the_loop_written_out(single: Twin):
    """The plant of `discretise`, and the law of the PI in z."""
    pid, at = PID(0.1, 0.002), 35.0
    model = jt.linearize(single, temperatures={"T": at}).discretise(1.0)
    A, B, C, D = (np.asarray(part, float) for part in (model.A, model.B, model.C, model.D))
    omega = np.geomspace(1e-4, np.pi, 20_000)
    z = np.exp(1j * omega)
    plant = np.array([(C @ np.linalg.solve(x * np.eye(len(A)) - A, B) + D)[0, 0] for x in z])
    loop = plant * (0.1 + 0.002 / (z - 1))
    found = loop_margins(single, pid, at)
    assert found.is_stable
    assert found.sensitivity_peak == pytest.approx(np.abs(1 / (1 + loop)).max(), rel=1e-4)
    assert found.complementary_peak == pytest.approx(np.abs(loop / (1 + loop)).max(), rel=1e-4)
    assert found.channel is not None
    at_unity = omega[np.argmin(np.abs(np.abs(loop) - 1))]
    assert found.channel.wcp == pytest.approx(at_unity, rel=1e-2)
    np.testing.assert_allclose(found.sensitivity_peaks, found.sensitivity_peak, rtol=1e-2)


@pytest.mark.slow
def test_a_loop_that_is_not_stable_or_fragile_says_so(single: Twin):
    assert loop_margins(single, PID(0.1, 0.002), 35.0).summary().startswith("sensitivity peak 1.")
    wild = loop_margins(single, PID(5.0, 0.5), 35.0)
    assert not wild.is_stable
    assert wild.summary() == "the loop is not stable"


@pytest.mark.slow
def test_the_examples_of_the_page_are_not_fragile_and_an_earlier_one_was(twin: Twin):
    """An LQI that looks at readings of 0.1 K amplifies some disturbances by three
    (`benchmarks/results/controllers.md`)."""
    two = {"measured": ["TAM", "TCM"], "limits": (0, 1)}
    model = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0})
    small = model.reduce(4).discretise(1.0)
    fragile = design_lqi(
        small, integral_deviation=30.0, duty_deviation=0.5, reading_noise=0.1, **two
    )
    robust = design_lqi(
        small, integral_deviation=30.0, duty_deviation=0.5, reading_noise=2.0, **two
    )
    before, after = (loop_margins(twin, one, 40.0) for one in (fragile, robust))
    assert before.sensitivity_peak > 2.5
    assert "fragile, a usual limit of the peak is 2" in before.summary()
    assert after.sensitivity_peak < 1.8
    assert after.channel is None
    assert after.disk.phase_deg > before.disk.phase_deg


@pytest.mark.slow
def test_margins_of_draws_are_those_of_each_twin(single: Twin):
    pid, values = PID(0.1, 0.002), np.array([1.6, 2.0])
    found = loop_margins(single, pid, 35.0, draws={"R_E": values})
    for peak, value in zip(found.sensitivity_peaks, values, strict=True):
        alone = loop_margins(single.with_values({"R_E": value}), pid, 35.0)
        assert peak == pytest.approx(alone.sensitivity_peak, rel=1e-2)


def test_a_controller_that_is_not_linear_has_no_margins(single: Twin):
    def thermostat(time_s, reference, measurement):
        return (measurement < reference).astype(float)

    with pytest.raises(ControlError, match="linear within its limits, got a FunctionController"):
        loop_margins(single, FunctionController(thermostat), 35.0)


@pytest.mark.slow
def test_a_decoupled_pi_is_fragile_with_the_gains_of_one_that_is_not_decoupled(twin: Twin):
    gain = jt.linearize(twin, duty=0.5).dcgain
    rows = [twin.channels.index(name) for name in ("TAM", "TCM")]
    two = {"measured": ["TAM", "TCM"], "limits": (0, 1), "decoupling": decoupling_of(gain[rows])}
    peaks = [
        loop_margins(twin, DecoupledPI(k, k / 100, k, k / 100, **two), 40.0).sensitivity_peak
        for k in (0.1, 0.05)
    ]
    assert peaks[1] < 1.8 < 2.0 < peaks[0]
