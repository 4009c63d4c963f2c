"""The most even plate on the way and at rest: programs against scipy's, limits, refusals."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize

from jaxtwin import Twin, linearize, simulate_closed_loop
from jaxtwin._quadratic_program import QuadraticProgram, minimised
from jaxtwin.control import (
    MPC,
    AbstractEvennessCost,
    HeatInput,
    OperatingPoint,
    RangeCost,
    SquaresCost,
    StateSpace,
    WorstPointCost,
    design_mpc,
    design_uniformity_mpc,
    loop_margins,
    most_even_point,
)
from jaxtwin.control.controllers._mpc import MPCState
from jaxtwin.errors import ControlError

ROOM, ELEMENTS = 16.0, 6
CHANNELS = ("a", "b", "c")
DUTY = np.array([0.5, 0.3])

minimum = jax.jit(minimised)


def rod(delay_s: float = 2.0) -> StateSpace:
    """Six pieces in a row that warm each other, with a cell below the second and one below the
    fifth; each channel reads two pieces."""
    A = -0.05 * np.eye(ELEMENTS)
    for left in range(ELEMENTS - 1):
        A[[left, left + 1], [left, left + 1]] -= 0.04
        A[[left, left + 1], [left + 1, left]] += 0.04
    A[5, 5] -= 0.01
    B = np.zeros((ELEMENTS, 2))
    B[1, 0], B[4, 1] = 3.0, 2.5
    C = np.kron(np.eye(3), [[0.5, 0.5]])
    nodes = ROOM + np.linalg.solve(-A, B @ DUTY)
    names = tuple(f"V{n + 1}" for n in range(ELEMENTS))
    point = OperatingPoint(
        DUTY,
        nodes,
        C @ nodes,
        np.asarray(ROOM),
        node_names=names,
        channel_names=CHANNELS,
        elements=ELEMENTS,
    )
    return StateSpace(
        A,
        B,
        C,
        np.zeros((3, 2)),
        operating_point=point,
        state_names=names,
        output_names=CHANNELS,
        delay_s=delay_s,
        lag_s=3.0,
    )


def designed(cost: Any, **more: Any) -> MPC:
    return design_uniformity_mpc(rod(), evenness=cost, order=ELEMENTS, sample_time_s=2.0, **more)


def at_rest(mpc: MPC, reference: float, limits: tuple[float, float]) -> np.ndarray:
    """The duty that the controller aims at without disturbances."""
    with jax.enable_x64(True):
        states, errors = jnp.zeros(len(mpc.kalman.A)), jnp.zeros(len(mpc.read_channels))
        box = limits[0] - mpc.duty, limits[1] - mpc.duty
        rest = eqx.filter_jit(mpc._rest)(jnp.full((1, 1), reference), states, errors, box)
        return np.asarray(rest.duty)[0] + mpc.duty


def elements_of(duty: np.ndarray) -> np.ndarray:
    model = rod()
    return ROOM + np.linalg.solve(-np.asarray(model.A), np.asarray(model.B) @ duty)


@pytest.mark.slow
@pytest.mark.parametrize(("cost", "price"), [(RangeCost, 0.0), (RangeCost, 5.0)])
@pytest.mark.parametrize("limits", [(0.0, 1.0), (0.0, 0.48)])
def test_the_duty_at_rest_is_that_of_a_linear_program(
    cost: Any, price: float, limits: tuple[float, float]
):
    """The least range at a mean, by scipy's HiGHS in the duty, the hottest and the coldest."""
    gain = np.linalg.solve(-np.asarray(rod().A), np.asarray(rod().B))
    ones, none = np.ones((ELEMENTS, 1)), np.zeros((ELEMENTS, 1))
    reference = 24.5
    found = linprog(
        [price, price, 1.0, -1.0],
        A_ub=np.vstack([np.hstack([gain, -ones, none]), np.hstack([-gain, none, ones])]),
        b_ub=np.zeros(2 * ELEMENTS),
        A_eq=[[*gain.mean(axis=0), 0.0, 0.0]],
        b_eq=[reference - ROOM],
        bounds=[limits, limits, (None, None), (None, None)],
    )
    duty = at_rest(designed(cost(price), limits=limits), reference, limits)
    np.testing.assert_allclose(duty, found.x[:2], atol=1e-3)
    assert elements_of(duty).mean() == pytest.approx(reference, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("cost", [WorstPointCost(), SquaresCost()])
def test_other_costs_at_rest_are_those_of_a_search_along_the_mean(cost: Any):
    """The duty cycles that hold a mean are a line; scipy's bounded search along it."""
    gain = np.linalg.solve(-np.asarray(rod().A), np.asarray(rod().B)).mean(axis=0)
    reference, limits = 30.0, (0.0, 1.0)

    def along(first: float) -> np.ndarray:
        return np.array([first, (reference - ROOM - gain[0] * first) / gain[1]])

    def uneven(first: np.ndarray) -> float:
        deviation = elements_of(along(float(first[0]))) - reference
        return float((deviation**2).sum() if cost.is_quadratic else np.abs(deviation).max())

    start = [at_rest(designed(RangeCost(), limits=limits), reference, limits)[0]]
    found = minimize(uneven, start, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-12})
    duty = at_rest(designed(cost, limits=limits), reference, limits)
    np.testing.assert_allclose(duty, along(float(found.x[0])), atol=2e-3)


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_bands_are_sums_with_a_centre_among_the_unknowns(seed: int, is_soft: bool):
    """The same program, with the centres eliminated and with a column for each."""
    random = np.random.default_rng(seed)
    size, bands, members = 4, 3, 5
    root = random.normal(size=(size, size)) + 2 * np.eye(size)
    hessian, slope = root.T @ root, random.normal(size=size)
    sums = random.normal(size=(bands, members, size))
    middle, wide = random.normal(size=(bands, members)), 0.5 + random.random((bands, 1))
    low, high = (np.r_[end * np.ones(size), (middle + end * wide).ravel()] for end in (-1.0, 1.0))
    softness = np.r_[np.zeros(size), np.full(bands * members, 0.3 if is_soft else 0.0)]
    if not is_soft:
        low[size:] -= 10.0  # so that there is a solution
    columns = -np.kron(np.eye(bands), np.ones((members, 1)))
    matrix = np.zeros((size + bands * members, size + bands))
    matrix[:size, :size] = np.eye(size)
    matrix[size:] = np.hstack([sums.reshape(-1, size), columns])
    # A centre of hardly any cost, so that Cholesky finds no zero.
    wider = np.zeros((size + bands, size + bands))
    wider[:size, :size] = hessian
    with jax.enable_x64(True):
        parts = (hessian, slope, np.eye(size), low, high, softness, sums)
        found = minimum(QuadraticProgram(*map(jnp.asarray, parts)))
        whole = (wider, np.r_[slope, np.zeros(bands)], matrix, low, high, softness)
        expected = minimum(QuadraticProgram(*map(jnp.asarray, whole)))[:size]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_a_program_of_bands_is_that_of_scipy():
    """A range that is penalised beyond a width, by sequential least squares over all unknowns."""
    random = np.random.default_rng(5)
    size, members = 3, 6
    hessian, slope = np.diag([1.0, 2.0, 0.5]), np.array([-2.0, 1.0, 1.5])
    sums, offset = random.normal(size=(1, members, size)), random.normal(size=members)
    softness = 0.05

    def excess(z: np.ndarray) -> np.ndarray:
        value = sums[0] @ z[:size] + offset - z[size]
        return np.maximum(np.abs(value) - 0.2, 0)

    def cost(z: np.ndarray) -> float:
        x = z[:size]
        return float(0.5 * x @ hessian @ x + slope @ x + 0.5 * np.sum(excess(z) ** 2) / softness)

    box = [(-1.0, 1.0)] * size + [(None, None)]
    expected = minimize(cost, np.zeros(size + 1), bounds=box, options={"ftol": 1e-15, "gtol": 1e-9})
    low, high = (np.r_[np.full(size, end), end * 0.2 - offset] for end in (-1.0, 1.0))
    soft = np.r_[np.zeros(size), np.full(members, softness)]
    with jax.enable_x64(True):
        parts = (hessian, slope, np.eye(size), low, high, soft, sums)
        found = np.asarray(minimum(QuadraticProgram(*map(jnp.asarray, parts))))
    np.testing.assert_allclose(found, expected.x[:size], atol=1e-5)


def followed(mpc: MPC, reference: float, samples: int, heat: float = 0.0) -> np.ndarray:
    """The elements of the rod, degC, from the room on."""
    model = rod().with_states_as_outputs(rod().state_names).discretise(mpc.sample_time_s)
    point = model.operating_point
    with jax.enable_x64(True):
        step = jax.jit(lambda state, r, y: mpc.step(state, r, y))
        x = np.asarray(model.start(np.zeros(2)))
        weights, state, rows = mpc.reading_weights(CHANNELS), None, []
        for _ in range(samples):
            outputs = np.asarray(point.outputs) + model.C @ x
            rows.append(outputs[len(CHANNELS) :])
            reading = weights @ outputs[: len(CHANNELS)]
            if state is None:
                state = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), reading))
            duty, state = step(state, jnp.array([reference]), reading)
            x = model.A @ x + model.B @ (np.asarray(duty) + np.array([heat, 0.0]) - point.duty)
    return np.array(rows)


@pytest.mark.long
def test_the_rod_is_no_less_even_on_the_way_than_at_rest():
    """But for the room of 3 % on the way, without an error of the model. A plan that looks at the
    outputs alone is less even."""
    even = followed(designed(RangeCost(), limits=(0, 1)), 30.0, 120)
    rest = np.ptp(elements_of(at_rest(designed(RangeCost(), limits=(0, 1)), 30.0, (0, 1))))
    assert np.ptp(even[-1]) == pytest.approx(rest, abs=0.02)
    assert np.ptp(even, axis=1).max() < 1.03 * rest + 0.1
    assert even[-1].mean() == pytest.approx(30.0, abs=0.02)
    mean = design_mpc(rod().discretise(2.0), measured=[CHANNELS], limits=(0, 1))
    assert np.ptp(followed(mean, 30.0, 120), axis=1).max() > rest + 1.0


@pytest.mark.slow
def test_heat_that_the_model_does_not_know_leaves_no_offset_of_the_mean():
    even = followed(designed(RangeCost(), limits=(0, 1)), 30.0, 300, heat=0.1)
    assert even[-1].mean() == pytest.approx(30.0, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("temperature", [30.0, 40.0])
def test_a_plate_is_as_even_as_its_cells_can_hold_it(twin: Twin, temperature: float):
    """With the noise of the camera and the driver's counts. A step of the references of two halves
    takes the range to 16.5 K on the way to 40 degC."""
    best = most_even_point(twin, temperature, limits=(0, 1))
    mpc = design_uniformity_mpc(linearize(twin, temperatures=temperature), limits=(0, 1))
    run = simulate_closed_loop(twin, mpc, temperature, duration=900, seed=1)
    last = run.time > 800
    assert run.range.max() < best.range + 1.2
    assert run.range[last].mean() == pytest.approx(best.range, abs=0.1)
    assert run.output[last].mean() == pytest.approx(temperature, abs=0.05)


@pytest.mark.slow
def test_heat_beside_a_channel_is_seen_at_its_elements(twin: Twin):
    """10 W at the corner V11: the mean is held, and the range no larger than the cells can do with
    this heat, by scipy along the duty cycles that hold the mean."""
    mpc = design_uniformity_mpc(linearize(twin, temperatures=35.0), limits=(0, 1))
    hand = HeatInput(("V11",), 0.0, 1500.0, 10.0)
    settings: dict[str, Any] = {"duration": 1500, "disturbances": [hand], "noise": False}
    run = simulate_closed_loop(twin, mpc, 35.0, **settings)
    assert run.output[-1, 0] == pytest.approx(35.0, abs=0.05)

    def ends(duty: np.ndarray) -> np.ndarray:
        constant = simulate_closed_loop(
            twin, lambda t, r, y: jnp.asarray(duty), 35.0, **settings, quantised=False
        )
        return np.array([constant.range[-1], constant.run.temperatures[-1].mean()])

    held = run.duty[-300:].mean(axis=0)
    base = ends(held)
    slopes = [ends(held + step) - base for step in 0.02 * np.eye(2)]
    for sign in (-1, 1):  # along the line of the same mean
        other = held + sign * 0.03 * np.array([1.0, -slopes[0][1] / slopes[1][1]])
        assert ends(other)[0] > base[0] - 0.15


@pytest.mark.slow
def test_a_limit_of_a_channel_is_kept_beside_the_evenness():
    mpc = designed(RangeCost(), limits=(0, 1), temperature_limits={"a": (0, 28.0)})
    rows = followed(mpc, 32.0, 200)
    assert rows[:, :2].mean(axis=1).max() < 28.3
    assert mpc.channel_limits()["a"].highest == 28.0


@pytest.mark.slow
def test_references_of_the_horizon_are_those_of_now_where_they_do_not_change():
    with jax.enable_x64(True):
        mpc = designed(RangeCost(), limits=(0, 1))
        state = jax.tree.map(jnp.asarray, mpc.init(np.full(2, 0.3), np.full(4, 22.0)))
        one, _ = jax.jit(lambda s: mpc.step(s, jnp.array([30.0]), np.full(4, 22.0)))(state)
        many, _ = jax.jit(lambda s: mpc.step(s, jnp.full((30, 1), 30.0), np.full(4, 22.0)))(state)
    np.testing.assert_allclose(one, many, rtol=0, atol=1e-9)


def test_its_margins_are_not_those_of_a_linear_loop(twin: Twin):
    mpc = design_uniformity_mpc(linearize(twin, temperatures=40.0), limits=(0, 1))
    with pytest.raises(ControlError, match="expected one that is linear within its limits"):
        loop_margins(twin, mpc, 40.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 1, "control_horizon": 1}, "MPC: horizon: expected more samples than the del"),
        ({"horizon": 5, "control_horizon": 6}, "MPC: control_horizon: expected at most the hori"),
        ({"temperature_limits": {"T99": (0, 40)}}, "temperature_limits: unknown channel 'T99'"),
        ({"temperature_limits": {"a": (40, 30)}}, "a: expected the lowest and the highest"),
        ({"excess_deviation": 0}, "MPC: excess_deviation: expected a finite"),
        ({"order": 0}, "design_uniformity_mpc: order: expected a whole"),
        ({"limits": (1, 0)}, "MPC: limits: expected the lowest and the highest duty"),
    ],
)
def test_designs_that_make_no_sense_are_refused(arguments: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        design_uniformity_mpc(rod(delay_s=4.0), sample_time_s=2.0, **arguments)


@pytest.mark.parametrize("cost", [RangeCost, WorstPointCost, SquaresCost])
@pytest.mark.parametrize("price", [-1.0, np.nan])
def test_a_price_below_0_is_refused(cost: Any, price: Any):
    with pytest.raises(ControlError, match=f"{cost.__name__}: energy_price: expected"):
        cost(price)


@final
class MostPoints(AbstractEvennessCost):
    """The number of points that are too warm, which is not convex."""

    name = "most points"
    energy_price: float = 0.0


def test_a_cost_that_is_not_known_to_be_convex_is_refused():
    with pytest.raises(ControlError, match="expected one of the convex costs RangeCost, WorstPo"):
        designed(MostPoints())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": ["a"]}, "MPC: points: expected names of outputs of the model together with"),
        ({"evenness": RangeCost()}, "MPC: points: expected names of outputs"),
        ({"evenness": RangeCost(), "points": ["z"]}, "points: unknown output 'z'"),
        (
            {"evenness": RangeCost(), "points": ["a"], "point_errors": np.ones((2, 2))},
            r"MPC: point_errors: expected finite numbers of 1 points by 3 channels",
        ),
    ],
)
def test_points_of_an_mpc_are_checked(arguments: dict[str, Any], message: str):
    model: StateSpace = rod().discretise(2.0)
    with pytest.raises(ControlError, match=message):
        design_mpc(model, measured=[CHANNELS], **arguments)


@pytest.mark.slow
def test_a_model_without_elements_makes_its_channels_even():
    model = linearize(Twin("tclab"), temperatures=35.0)
    mpc = design_uniformity_mpc(model, limits=(0, 1))
    assert mpc.point_names == model.output_names
    assert isinstance(mpc.init(np.zeros(2), np.full(3, 23.0)), MPCState)
