"""Relay feedback: the oscillation is that of the describing function, and gives a controller."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import ClosedLoopRun, Relay, UltimatePoint, ultimate_point
from jaxtwin.errors import ControlError

AMPLITUDE, HYSTERESIS, REFERENCE = 0.08, 0.03, 40.0


@pytest.fixture(scope="module")
def bias(twin: Twin) -> float:
    """The duty that holds the reference, and a little more."""
    point = jt.linearize(twin, temperatures=REFERENCE).operating_point
    return float(np.asarray(point.duty)[0]) + 0.015


@pytest.fixture(scope="module")
def relay(bias: float) -> Relay:
    return Relay(AMPLITUDE, bias, HYSTERESIS, limits=(0, 1))


@pytest.fixture(scope="module")
def run(twin: Twin, relay: Relay) -> ClosedLoopRun:
    rest = np.asarray(jt.linearize(twin, temperatures=REFERENCE).operating_point.nodes)
    return jt.simulate_closed_loop(
        twin,
        relay,
        REFERENCE,
        duration=400,
        initial=rest,
        noise=False,
        quantised=False,
    )


@pytest.mark.slow
def test_the_oscillation_is_that_of_the_describing_function(twin: Twin, run: ClosedLoopRun):
    r"""$G(z) = -1 / N(a)$ with $N = 4 d / (\pi a) (\sqrt{1 - (\epsilon / a)^2} - j \epsilon / a)$,
    of the plant at the sample times. Switches come at whole samples, half a sample late on average;
    harmonics are left out of N."""
    model = jt.linearize(twin, temperatures=REFERENCE).discretise(1.0)
    A, C = np.asarray(model.A), np.asarray(model.C).mean(axis=0)
    B = np.asarray(model.B).sum(axis=1)

    def response(omega: float) -> complex:
        late = np.exp(-0.5j * omega)
        return complex(C @ np.linalg.solve(np.exp(1j * omega) * np.eye(len(A)) - A, B) * late)

    def off(omega: float) -> float:
        size = abs(response(omega)) * 4 * AMPLITUDE / np.pi
        phase = np.angle(response(omega))
        above = np.pi + (phase if phase <= 0 else phase - 2 * np.pi)  # -180 degrees
        return above - np.arcsin(min(HYSTERESIS / size, 1.0))

    omega = float(brentq(off, 0.08, 0.5))  # pyright: ignore[reportArgumentType]
    point = ultimate_point(run)
    assert point.period_s == pytest.approx(2 * np.pi / omega, rel=0.08)
    assert point.amplitude == pytest.approx(abs(response(omega)) * 4 * AMPLITUDE / np.pi, rel=0.12)
    # The plant's own response at the frequency that was found, harmonics and all.
    exact = response(2 * np.pi / point.period_s) * np.exp(0.5j * 2 * np.pi / point.period_s)
    assert point.gain == pytest.approx(1 / abs(exact), rel=0.03)
    assert point.phase_deg == pytest.approx(np.degrees(np.angle(exact)) % -360, abs=3)


@pytest.mark.slow
def test_the_oscillation_is_that_of_the_linear_loop(twin: Twin, relay: Relay, run: ClosedLoopRun):
    """The same relay about the discrete model, sample by sample."""
    model = jt.linearize(twin, temperatures=REFERENCE).discretise(1.0)
    A, B, C = (np.asarray(matrix) for matrix in (model.A, model.B, model.C))
    about = np.asarray(model.operating_point.outputs).mean()
    start = model.start(np.zeros(2))
    step = jax.jit(lambda *arguments: relay.step(*arguments))
    states = np.zeros(len(A))
    states[len(twin.netlist.nodes) :] = np.asarray(start)[len(twin.netlist.nodes) :]
    outputs, duties = [], []
    with jax.enable_x64(True):
        state = relay.init(np.zeros(2), np.array([about]))
        for _ in range(401):
            output = about + C.mean(axis=0) @ states
            duty, state = step(state, np.array([REFERENCE]), np.array([output]))
            outputs.append(output)
            duties.append(float(duty[0]))
            states = A @ states + B @ (np.asarray(duty) - np.asarray(model.operating_point.duty))
    linear = ultimate_point((np.arange(401.0), outputs, duties))
    point = ultimate_point(run)
    assert abs(linear.period_s - point.period_s) <= 1.0
    assert linear.gain == pytest.approx(point.gain, rel=0.05)


@pytest.mark.slow
def test_the_bias_moves_until_both_halves_are_alike(run: ClosedLoopRun):
    """It began 0.015 too high."""
    ups = 1 + np.flatnonzero(np.diff(run.duty[:, 0]) > AMPLITUDE)
    downs = 1 + np.flatnonzero(np.diff(run.duty[:, 0]) < -AMPLITUDE)
    shares = [(downs[downs > up][0] - up) for up in ups[:-1]] / np.diff(ups)
    assert abs(shares[-1] - 0.5) < 0.1


def test_each_cycle_moves_the_bias_by_the_difference_of_its_halves():
    """Up for 3 samples and down for 1: by half an amplitude; up and down for 2: not further."""
    relay = Relay(0.2, 0.1, 0.5)
    state = relay.init(np.zeros(1), np.zeros(1))
    low, high = np.array([-1.0]), np.array([1.0])  # K from a reference of 0
    asked = []
    for reading in (low, high, low, low, low, high, low, low, high, high, low):
        duty, state = relay.step(state, np.zeros(1), reading)
        asked.append(float(np.asarray(duty)[0]))
    up, down = 0.1 + 0.2, 0.1 - 0.2
    before, after = [up, down, up, up, up, down], [up, up, down, down, up]
    expected = before + [duty + 0.5 * 0.2 for duty in after]
    np.testing.assert_allclose(asked, expected, rtol=1e-6)


def test_a_pid_from_the_point_is_by_the_published_rules():
    point = UltimatePoint(gain=2.0, period_s=20.0, phase_deg=-175.0, amplitude=0.3, cycles=3)
    classic = point.pid("ziegler-nichols")
    np.testing.assert_allclose([classic.Kp, classic.Ki, classic.Kd], [1.2, 0.12, 3.0])
    cautious = point.pid(derivative=False, limits=(0, 1), sample_time_s=0.5)
    np.testing.assert_allclose([cautious.Kp, cautious.Ki, cautious.Kd], [0.625, 0.625 / 44, 0.0])
    assert cautious.limits == (0, 1)


def test_a_relay_that_never_switches_gives_up_and_stays_off():
    relay = Relay(0.1, 0.4, 0.1, timeout_s=5)
    state = relay.init(np.zeros(2), np.array([20.0]))
    duties = []
    for _ in range(9):
        duty, state = relay.step(state, np.array([40.0]), np.array([20.0]))
        duties.append(float(duty[0]))
    np.testing.assert_allclose(duties, [0.5] * 5 + [0.0] * 4, atol=1e-6)
    duty, _ = relay.step(state, np.array([40.0]), np.array([50.0]))
    np.testing.assert_array_equal(duty, 0)


def oscillation(periods: list[float], drift: float = 0.0) -> tuple[Any, Any, Any]:
    """A triangle under a square wave with these periods, s."""
    duty = np.concatenate([np.repeat([0.5, 0.3], int(period / 2)) for period in periods])
    duty = np.concatenate([[0.3], duty, [0.5, 0.5]])
    time = np.arange(len(duty), dtype=float)
    return time, 40 + 0.1 * np.cumsum(duty - 0.4) + drift * time, duty


@pytest.mark.parametrize(
    ("bias", "advice"),
    [
        (0.9, "above the reference at its lower duty, 0.8, from 50 s on: take a lower bias"),
        (
            0.15,
            r"below the reference at its higher duty, 0\.25., from 0 s on: let it run .* higher",
        ),
    ],
)
def test_a_bias_that_does_not_let_the_relay_switch_is_named(bias: float, advice: str):
    relay = Relay(amplitude=0.1, bias=bias, hysteresis=0.1, limits=(0, 1))
    run = jt.simulate_closed_loop(jt.Twin("dual-cell"), relay, 40.0, duration=1200)
    with pytest.raises(ControlError, match=advice):
        ultimate_point(run)


def test_an_oscillation_that_drifts_is_refused():
    assert ultimate_point(oscillation([20, 20, 20])).period_s == 20
    with pytest.raises(ControlError, match="periods that do not change, got 40, 28, 20 s"):
        ultimate_point(oscillation([40, 28, 20]))
    with pytest.raises(ControlError, match="an oscillation about one level"):
        ultimate_point(oscillation([20, 20, 20], drift=0.02))
    with pytest.raises(ControlError, match="at least 3 whole periods of the relay, got 2"):
        ultimate_point(oscillation([20, 20]))
    time, output, duty = oscillation([20, 20, 20])
    heard = (time < 24) | (time > 29)
    with pytest.raises(ControlError, match="got none for 7 s of a period of 20 s"):
        ultimate_point((time[heard], output[heard], duty[heard]))


def test_late_and_missing_samples_do_not_change_what_is_found():
    r"""A square wave of duty, $d = 0.1$, whose fundamental is $4 d / \pi \sin(\omega t)$, and an
    output $0.5 \sin(\omega t - 2.7)$. Samples are up to 0.2 s late; three are left out."""
    period, late = 30.0, np.random.default_rng(0).uniform(0, 0.2, 150)
    time = np.delete(np.arange(150.0) + late, [70, 101, 102])
    turn = 2 * np.pi * time / period
    output = 40 + 0.5 * np.sin(turn - 2.7)
    duty = 0.4 + 0.1 * np.where(np.sin(turn) > 0, 1.0, -1.0)
    point = ultimate_point((time, output[:, None], np.column_stack([np.full(147, 0.5), duty])))
    assert point.period_s == pytest.approx(period, abs=0.1)
    assert point.amplitude == pytest.approx(0.5, rel=0.02)
    assert point.gain == pytest.approx(4 * 0.1 / np.pi / 0.5, rel=0.02)
    # The plant is the sampled one: with the hold, which is half a sample late.
    assert point.phase_deg == pytest.approx(np.degrees(-2.7) - 360 * 0.5 / period, abs=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"amplitude": 0}, "amplitude: expected a number above 0"),
        ({"amplitude": float("nan")}, "amplitude: expected finite numbers"),
        ({"bias": 1.5}, "bias: expected a duty from -1 to 1"),
        ({"hysteresis": -0.1}, "hysteresis: expected finite numbers of at least 0"),
        ({"timeout_s": 0}, "timeout_s: expected a number above 0"),
    ],
)
def test_invalid_parameters_of_a_relay_are_refused(arguments: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        Relay(**{"amplitude": 0.1, "bias": 0.4, "hysteresis": 0.1, **arguments})


@pytest.mark.parametrize(
    "given",
    [
        ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], [0.0, 1.0, 0.0]),
        ([0.0, 1.0, 2.0], np.ones((3, 2)), [0.0, 1.0, 0.0]),
        ([0.0, 1.0, 2.0], np.ones((3, 0)), [0.0, 1.0, 0.0]),
        ([0.0, 1.0, 2.0], [1.0, np.nan, 3.0], [0.0, 1.0, 0.0]),
        ([0.0, 1.0, 2.0], [1.0, 2.0], [0.0, 1.0]),
    ],
)
def test_an_invalid_run_is_refused(given: Any):
    with pytest.raises(ControlError, match="ultimate_point: run: expected"):
        ultimate_point(given)
