"""A match through optimistix's own least-squares solvers: the same optimum, the same bounds."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from jaxtwin import Experiment, Fit, Twin, match, simulate
from jaxtwin.matching._unknowns import SearchSpace

TRUTH = {"C_load": 24.0, "T_amb": 20.0, "T_start": 18.5}
TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def recording() -> Experiment:
    """Two minutes of a known single cell, with white noise."""
    drive = Experiment.schedule("0:0.4,60:-0.3", duration=120, channels=("T",))
    seen = simulate(Twin("single-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * np.random.default_rng(0).standard_normal(seen.shape)
    return Experiment(
        drive.time, drive.duty, channels=drive.channels, temperatures=seen, name="bench"
    )


@pytest.fixture(scope="module")
def ours(recording: Experiment) -> Fit:
    return match(Twin("single-cell"), recording, free=[*TRUTH])


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [pytest.param(optx.LevenbergMarquardt, marks=pytest.mark.long), optx.Dogleg]
)
def test_another_solver_ends_at_the_same_optimum(
    recording: Experiment, ours: Fit, kind: type[optx.AbstractLeastSquaresSolver]
):
    shown: list[int] = []
    fit = match(
        Twin("single-cell"),
        recording,
        free=[*TRUTH],
        solver=kind(TOLERANCE, TOLERANCE),  # pyright: ignore[reportCallIssue]
        on_progress=lambda iteration: shown.append(iteration.number),
    )
    assert fit.converged
    assert fit.status == f"{kind.__name__}: converged"
    # Optimistix has readings by JAX, ours are by C where there is a compiler, 6e-5 K from them: of
    # the logarithm of the likelihood that is a hundredth.
    assert abs(fit.cost - ours.cost) < 0.03
    for name in TRUTH:
        assert abs(fit[name].value - ours[name].value) < 1e-3 * ours[name].standard_error
        assert fit[name].standard_error == pytest.approx(ours[name].standard_error, rel=1e-3)
    # Three rounds; optimistix shows of each where it began and where it ended.
    assert len(shown) == 6
    assert [step.number for step in fit.history] == [0, shown[-1]]


@pytest.mark.slow
def test_another_solver_stays_inside_the_bounds(recording: Experiment):
    solver = optx.LevenbergMarquardt(TOLERANCE, TOLERANCE)
    bounds = {"C_load": (26.0, 60.0)}
    start = Twin("single-cell", {"C_load": 40.0})
    fit = match(start, recording, free=[*TRUTH], bounds=bounds, solver=solver)
    # The truth is below: the optimum is on the bound, where the transform is flat.
    assert 26.0 <= fit["C_load"].value < 26.01


@pytest.mark.usefixtures("float64")
def test_the_transform_without_walls_is_exact_and_reaches_its_bounds():
    inf = np.inf
    space = SearchSpace(
        np.array([-1.0, -inf, 0.0, -inf]),
        np.array([3.0, inf, inf, 2.0]),
        np.array([1.0, 4.0, 2.0, 1.0]),
    )
    vector = np.array([0.5, -7.0, 0.3, 1.5])
    there = space.to_unbounded(vector)
    np.testing.assert_allclose(space.from_unbounded(jnp.asarray(there)), vector, rtol=1e-12)
    far = np.linspace(-50, 50, 4001)[:, None] * np.ones(4)
    reached = np.array([space.from_unbounded(jnp.asarray(point)) for point in far[::40]])
    assert np.all((reached >= space.lower) & (reached <= space.upper))
    top = space.from_unbounded(jnp.asarray(np.array([np.pi / 2, 0.0, 0.0, 9.0])))
    np.testing.assert_allclose(top, [3.0, 0.0, 0.0, 2.0])
    # A start on a wall is moved inside, where the transform moves.
    assert abs(space.to_unbounded(np.array([3.0, 0.0, 0.0, 0.0]))[0]) < np.pi / 2
