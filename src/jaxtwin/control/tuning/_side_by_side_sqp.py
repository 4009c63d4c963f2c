r"""Sequential quadratic programming in the unit box, several descents side by side.

Each descent minimises $f(z)$ under $c(z) \le 0$ and $0 \le z \le 1$ by steps $d$ from

$$\min_d g^T d + \tfrac12 d^T B d, \quad a^T d \le -c, \quad \lVert d \rVert_\infty \le \Delta$$

with $B$ Powell's damped BFGS approximation of the Lagrangian's Hessian (Nocedal and Wright,
*Numerical Optimization*, 2006, chapter 18). A step is accepted if the merit $f + \mu \max(c, 0)$
falls, otherwise the trust region $\Delta$ shrinks. All descents request their next point in the
same round, because a batch of loops costs less than single loops. None of the libraries in use
(SciPy, optimistix, optax) runs several descents with bounds and a constraint in this way.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..._progress import advanced

Vector = Float[np.ndarray, " unknowns"]

FIRST_STEP, LONGEST_STEP, SHORTEST_STEP = 0.1, 0.4, 1e-3
"""Step lengths relative to the width of the box. A step of the shortest length changes a parameter
whose bounds differ by a factor of 1000 by 0.7 %."""

# The part of the predicted decrease of the merit that a step has to reach to be accepted.
SUFFICIENT_DECREASE = 1e-4

# The predicted decrease of the merit, relative to the objective, at which a descent ends.
NEGLIGIBLE_DECREASE = 1e-4


class CandidateEvaluation(NamedTuple):
    """The objective `f` and the constraint `c` at a point, with their gradients. They are infinite
    if the loop of the point fails."""

    f: float
    g: Vector
    c: float
    a: Vector

    @property
    def is_finite(self) -> bool:
        numbers = np.concatenate([[self.f, self.c], self.g, self.a])
        return bool(np.isfinite(numbers).all())


class Round(NamedTuple):
    """A point that a descent requested.

    - `start`: the number of the descent.
    - `number`: the number of the round, 0 for the start.
    - `accepted`: whether the descent moved to the point.
    """

    start: int
    number: int
    point: Vector
    evaluation: CandidateEvaluation
    accepted: bool


Evaluate = Callable[[Sequence[Vector]], list[CandidateEvaluation]]


def descents(evaluate: Evaluate, starts: Sequence[Vector], *, rounds: int) -> list[Round]:
    """Runs a descent from each start, and returns all points in the order of the requests."""
    history: list[Round] = []
    running: dict[int, _Descent] = {}
    for start, (point, evaluation) in enumerate(zip(starts, evaluate(starts), strict=True)):
        history.append(Round(start, 0, point, evaluation, evaluation.is_finite))
        if evaluation.is_finite:
            running[start] = _Descent(point, evaluation)
    for number in range(1, rounds + 1):
        advanced(number - 1, rounds)
        asked = {start: descent.ask() for start, descent in running.items()}
        asked = {start: point for start, point in asked.items() if point is not None}
        running = {start: running[start] for start in asked}
        if not asked:
            break
        for (start, point), evaluation in zip(
            asked.items(), evaluate(list(asked.values())), strict=True
        ):
            accepted = running[start].receive(evaluation)
            history.append(Round(start, number, point, evaluation, accepted))
    return history


@final
class _Descent:
    """A single descent, which requests points and receives their evaluations."""

    def __init__(self, point: Vector, evaluation: CandidateEvaluation):
        self._z, self._at = point, evaluation
        self._scale = max(abs(evaluation.f), 1e-300)
        self._hessian = np.eye(len(point)) * self._scale
        self._reach, self._weight, self._multiplier = FIRST_STEP, 0.0, 0.0
        self._step = np.zeros_like(point)
        self._is_first = True

    def ask(self) -> Vector | None:
        """Returns the next point; None at the end of the descent."""
        if self._reach < SHORTEST_STEP:
            return None
        z, at = self._z, self._at
        low = np.maximum(-z, -self._reach)
        high = np.minimum(1 - z, self._reach)
        # If no step brings the constraint to 0, as far down as a step can bring it.
        lowest = float(np.minimum(at.a * low, at.a * high).sum())
        room = max(-at.c, 0.9 * lowest)
        self._step = _quadratic_minimum(self._hessian, at.g, at.a, room, low, high)
        self._multiplier = self._estimated_multiplier(low, high)
        self._weight = max(self._weight, 2 * self._multiplier, self._scale)
        if self._predicted() < NEGLIGIBLE_DECREASE * max(
            abs(at.f), NEGLIGIBLE_DECREASE * self._scale
        ):
            return None
        return z + self._step

    def receive(self, evaluation: CandidateEvaluation) -> bool:
        """Takes the evaluation of the requested point, and returns whether the descent moves
        there."""
        fall = self._merit(self._at) - self._merit(evaluation) if evaluation.is_finite else -np.inf
        if not fall > SUFFICIENT_DECREASE * self._predicted():
            self._reach = 0.4 * min(self._reach, float(np.abs(self._step).max()))
            return False
        if fall > 0.7 * self._predicted():
            self._reach = min(2 * self._reach, LONGEST_STEP)
        self._update_hessian(evaluation)
        self._z, self._at = self._z + self._step, evaluation
        return True

    def _merit(self, at: CandidateEvaluation) -> float:
        return at.f + self._weight * max(at.c, 0.0)

    def _predicted(self) -> float:
        d, at = self._step, self._at
        model = float(at.g @ d + 0.5 * d @ self._hessian @ d)
        after = max(at.c + float(at.a @ d), 0.0)
        return -model + self._weight * (max(at.c, 0.0) - after)

    def _estimated_multiplier(self, low: Vector, high: Vector) -> float:
        """Estimates the multiplier of the constraint from the entries that are not at a bound."""
        d, a = self._step, self._at.a
        is_free = (d > low + 1e-9) & (d < high - 1e-9)
        if self._at.c + a @ d < -1e-9 * (1 + abs(self._at.c)) or not (a[is_free] ** 2).sum() > 0:
            return 0.0
        slope = (self._at.g + self._hessian @ d)[is_free]
        return max(-float(slope @ a[is_free]) / float(a[is_free] @ a[is_free]), 0.0)

    def _update_hessian(self, evaluation: CandidateEvaluation) -> None:
        """Updates the approximation of the Hessian by Powell's damped BFGS formula."""
        d, was = self._step, self._at
        y = evaluation.g - was.g + self._multiplier * (evaluation.a - was.a)
        if self._is_first and float(d @ y) > 0:
            self._hessian = np.eye(len(d)) * float(y @ y) / float(d @ y)
        self._is_first = False
        Bd = self._hessian @ d
        curvature = float(d @ Bd)
        share = float(d @ y)
        if share < 0.2 * curvature:
            damping = 0.8 * curvature / (curvature - share)
            y = damping * y + (1 - damping) * Bd
        self._hessian = self._hessian - np.outer(Bd, Bd) / curvature + np.outer(y, y) / float(d @ y)


def _quadratic_minimum(
    hessian: Float[np.ndarray, "n n"], g: Vector, a: Vector, room: float, low: Vector, high: Vector
) -> Vector:
    """Minimises $g^T d + d^T B d / 2$ between bounds, with $a^T d$ at most `room`."""
    from scipy.optimize import minimize

    size = float(np.abs(g).max()) or 1.0
    H, slope = hessian / size, g / size
    length = float(np.abs(a).max()) or 1.0
    limit = {
        "type": "ineq",
        "fun": lambda d: (room - a @ d) / length,
        "jac": lambda d: -a / length,
    }
    start = np.clip(np.zeros_like(g), low, high)
    result = minimize(
        lambda d: float(slope @ d + 0.5 * d @ H @ d),
        start,
        jac=lambda d: slope + H @ d,
        bounds=list(zip(low, high, strict=True)),
        constraints=[limit] if a.any() else [],
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-12},
    )
    return np.clip(result.x, low, high)
