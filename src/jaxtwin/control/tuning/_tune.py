"""Tunes controllers by derivatives of the whole closed loop."""

import time
from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from ..._arguments import whole_number
from ..._progress import announced
from ...errors import ControlError
from ...matching import Fit
from ...physics import Twin
from ..controllers._controller import AbstractController
from ..loops._measures import Measure
from ._tuning import Tuning
from ._tuning_problem import tuning_problem, twin_first


@twin_first
@announced("tuning")
def tune(
    twin: Twin | Fit,
    controller: AbstractController,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    tuned: Iterable[str] | Mapping[str, tuple[float, float]] | None = None,
    objective: str | Mapping[str, float] | Measure = "integral_absolute_error",
    draws: int | Mapping[str, ArrayLike] | None = None,
    tail_weight: float | int = 0.5,
    sensitivity_limit: float | int | None = 2.0,
    starts: int = 4,
    rounds: int = 30,
    seed: int = 0,
    workers: int | None = None,
    **settings: Any,
) -> Tuning:
    r"""Tunes a controller by the derivatives of its closed loop.

    ```python
    pid = jaxtwin.control.PID(Kp=0.05, Ki=0.0005, limits=(0, 1))
    tuning = jt.tune(twin, pid, 40, duration=900, objective={
        "integral_absolute_error": 1.0, "energy": 1e-3,
    })
    tuning.controller, tuning.plot()
    ```

    The objective is a weighted sum of measures of the loop that `simulate_closed_loop` simulates,
    with the nonlinear plant, limits, delay, lag and noise. Its derivatives are exact. A limit on
    the sensitivity peak, $M_s = \max_\omega |S(j \omega)|$ of the linearised loop, keeps the loop
    robust against changes of the plant that the draws do not contain: 1.4 is cautious, 2 is usual.
    The sensitivity peak includes delay, lag and sample time exactly, and is computed at the steady
    state of the last references.

    With draws of the plant, the objective is the weighted sum of the mean over all draws and the
    mean over the worst 5 % (`tail_weight`); the limit holds for every draw.

    The search is sequential quadratic programming from several starts: the given controller, and
    random controllers within the bounds whose linear loop satisfies the limit. It finds a local
    optimum. The duty is not rounded to the driver's counts, because rounding has no derivative.

    **Arguments:**

    - `controller`: the start of the search. Parameters that are not tuned keep their values.
    - `twin`: the twin, or a fit (`Fit.mean_twin`).
    - `references`, `duration`: as in `simulate_closed_loop`.
    - `tuned`: the parameters of the controller that are tuned, name -> (lowest, highest); or
      names, whose bounds are then a thirtieth and thirty times their values. None for the gains
      above 0 of a `PID` or a `DecoupledPI`, and for the deviations and the noise of the readings
      with which an `LQI` or an `MPC` was designed. The search uses the logarithm of a parameter
      whose bounds are above 0.
    - `objective`: the name of a measure of `jaxtwin.control.MEASURES`; name -> weight, in the
      inverse of the measure's unit; or a JAX function of a `ClosedLoop`.
    - `draws`: draws of the plant's parameters, name -> values `(draws,)`; or, for a fit, the number
      of posterior draws (`jaxtwin.matching.posterior_draws`). None for the twin without draws.
    - `tail_weight`: the weight of the worst draws in the objective, 0 to 1.
    - `sensitivity_limit`: the limit of $M_s$, above 1; None for no limit. Stability is then not
      checked.
    - `starts`: the number of descents, which run side by side.
    - `rounds`: the number of rounds, in each of which every descent evaluates one controller.
    - `seed`: the seed of starts, posterior draws, noise and faults.
    - `workers`: the number of threads, None for one for each core.
    - `settings`: the further keywords of `jaxtwin.control.scenario`.

    **Returns:** a `Tuning` with the tuned controller, its measures before and after, and the
    history of the search.

    **Raises:** `ControlError` if arguments do not fit each other, and if the search finds no
    controller within the bounds whose loops are finite and satisfy the limit.
    """
    began = time.perf_counter()
    problem = tuning_problem(
        "tune",
        controller,
        twin,
        references,
        duration,
        tuned=tuned,
        objective=objective,
        draws=draws,
        tail_weight=tail_weight,
        sensitivity_limit=sensitivity_limit,
        starts=whole_number("tune: starts", starts, 1, ControlError),
        seed=whole_number("tune: seed", seed, 0, ControlError),
        workers=workers,
        settings=settings,
    )
    return problem.solved(whole_number("tune: rounds", rounds, 1, ControlError), began)
