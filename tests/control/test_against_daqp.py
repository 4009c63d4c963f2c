"""Quadratic programs against DAQP, an active-set solver in C that ends at the vertex itself
(Arnström, Bemporad and Axehill, IEEE Trans. Automat. Contr. 67 (2022) 4362-4369)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Twin, linearize, simulate_closed_loop
from jaxtwin._quadratic_program import QuadraticProgram, minimised
from jaxtwin.control import design_mpc

pytestmark = pytest.mark.daqp

minimum = jax.jit(minimised)


def by_daqp(program: QuadraticProgram) -> tuple[np.ndarray, int]:
    """The minimum, and how many limits it lies at. The excess over a soft limit is an unknown."""
    import daqp

    H, f, M, low, high = (np.asarray(part, float) for part in program[:5])
    softness = np.broadcast_to(np.asarray(program.softness, float), low.shape)
    soft = np.flatnonzero(softness)
    size, rows = len(f), len(low)
    excess = np.zeros((rows, len(soft)))
    excess[soft, np.arange(len(soft))] = 1.0
    hessian = np.diag(np.r_[np.zeros(size), 1 / softness[soft]])
    hessian[:size, :size] = H
    free = np.full(rows, 1e30)
    found, _, flag, info = daqp.solve(
        hessian,
        np.r_[f, np.zeros(len(soft))],
        np.vstack([np.hstack([M, excess]), np.hstack([M, -excess])]),
        np.r_[np.where(softness > 0, free, high), high],
        np.r_[low, np.where(softness > 0, -free, low)],
        primal_tol=1e-10,
        dual_tol=1e-12,
    )
    assert flag == 1
    return np.asarray(found)[:size], int(np.sum(np.abs(info["lam"]) > 1e-9))


def cost(program: QuadraticProgram, plan: np.ndarray) -> float:
    """The cost of a plan; infinite beyond a hard limit."""
    H, f, M, low, high = (np.asarray(part, float) for part in program[:5])
    softness = np.broadcast_to(np.asarray(program.softness, float), low.shape)
    excess = np.maximum(np.maximum(M @ plan - high, low - M @ plan), 0)
    if np.any(excess[softness == 0] > 1e-9):
        return np.inf
    soft = softness > 0
    return float(
        0.5 * plan @ H @ plan + f @ plan + 0.5 * np.sum(excess[soft] ** 2 / softness[soft])
    )


@pytest.mark.parametrize("decades", [0, 2, 4])
def test_random_programs_have_daqp_s_minimum(decades: int):
    """Boxes, limits of differences and soft limits, a third of them active."""
    size, soft = 16, 8
    random = np.random.default_rng(decades)
    matrix = np.vstack([np.eye(size), np.eye(size) - np.eye(size, k=-2), np.zeros((soft, size))])
    active = 0
    with jax.enable_x64(True):
        for _ in range(40):
            turn = np.linalg.qr(random.normal(size=(size, size)))[0]
            H = turn.T @ np.diag(np.logspace(0, -decades, size)) @ turn
            matrix[-soft:] = random.normal(size=(soft, size)) / np.sqrt(size)
            middle = random.normal(size=soft)
            low = np.r_[-np.ones(size), np.full(size, -0.5), middle - 0.2]
            high = np.r_[np.ones(size), np.full(size, 0.5), middle + 0.2]
            softness = np.r_[np.zeros(2 * size), 10 ** random.uniform(-2, 1, soft)]
            parts = H, -H @ random.normal(0, 2, size), matrix, low, high, softness
            program = QuadraticProgram(*map(jnp.asarray, parts))
            expected, limits = by_daqp(program)
            np.testing.assert_allclose(minimum(program), expected, rtol=0, atol=1e-6)
            active += limits
    assert active > 40 * size / 3


@pytest.mark.long
def test_the_programs_of_a_run_have_daqp_s_minimum(twin: Twin):
    """Those of an MPC on `dual-cell` while it warms up, at the limits of the duty, of its rate and
    of a temperature."""
    model = linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(1.0)
    settings: dict[str, Any] = {
        "measured": ["TAM", "TCM"],
        "horizon": 20,
        "limits": (0, 1),
        "rate_limit": 0.05,
        "temperature_limits": {"T11": (0, 41.0)},
    }
    mpc = design_mpc(model, **settings).for_rig(twin.rig)
    run = simulate_closed_loop(twin, mpc, "0:40/37,120:30", duration=180)
    with jax.enable_x64(True):

        def sample(state: Any, row: Any) -> Any:
            program = mpc._problem(state, *row)[1]
            duty, later = mpc.step(state, *row)
            return later, (program, minimised(program), duty)

        rows = jnp.asarray(run.reference), jnp.asarray(run.loop.measurement)
        start = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), run.loop.measurement[0]))
        _, (programs, plans, duty) = jax.jit(lambda: jax.lax.scan(sample, start, rows))()
    # The samples of the run, by what it commanded: rounded to counts.
    np.testing.assert_allclose(duty, run.duty, rtol=0, atol=0.5 / 255 + 1e-9)
    at_limits = set()
    for n, plan in enumerate(np.asarray(plans)):
        program = jax.tree.map(lambda leaf, n=n: leaf[n], programs)
        expected, limits = by_daqp(program)
        # Limits that are only just reached leave the interior point a millionth away, at any
        # sample of the plan: the cost is flat there. So the cost itself is compared too.
        np.testing.assert_allclose(plan, expected, rtol=0, atol=1e-5, err_msg=str(n))
        np.testing.assert_allclose(plan[:2], expected[:2], rtol=0, atol=1e-6, err_msg=str(n))
        np.testing.assert_allclose(
            cost(program, plan), cost(program, expected), rtol=1e-9, err_msg=str(n)
        )
        at_limits.add(limits)
    assert len(at_limits) > 10
    assert max(at_limits) > 20
