"""Tunes a controller on a new twin, and tries it there before anything reaches the rig."""

import math
import time
from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, of_kind, whole_number
from .._waiting import announced
from ..control.controllers._controller import AbstractController
from ..control.linear._margins import USUAL_PEAK
from ..control.loops._loop_margins import loop_margins
from ..control.loops._measures import Measure
from ..control.loops._references import reference_samples, sample_times
from ..control.tuning._objective import checked_objective
from ..control.tuning._tuning import Tuning
from ..control.tuning._tuning_problem import PEAK_TOLERANCE, tuning_problem
from ..errors import ControlError
from ..matching import Fit, posterior_draws
from ..matching._nominal_twin import nominal_twin
from ..physics import Twin
from ._retuned import Decision, Retuned
from ._scenarios import TrialScenario, usual_scenarios
from ._trial import Trial, Tried, check_limit

# The number of draws with which a controller is tuned: those of the trial are other ones.
TUNING_DRAWS = 8

# The descents of the search, and the rounds of each.
STARTS, ROUNDS = 2, 20

# The share of the draws whose sensitivity peak is within the limit.
PEAKS_WITHIN = 0.95

# How often the search is repeated with a lower limit, because the draws of the trial exceed it.
REPEATS = 3

# The part by which the cost is lower at least, so that a change of the controller is worth it.
WORTH = 0.05


@announced("retuning")
def retune(
    fit: Fit,
    controller: AbstractController,
    references: float | int | str | np.ndarray,
    *,
    duration: float | int,
    objective: str | Mapping[str, float] | Measure = "integral_absolute_error",
    scenarios: Iterable[TrialScenario] | None = None,
    draws: int = 100,
    allowance: float | int = 0.1,
    seed: int = 0,
    workers: int | None = None,
) -> Retuned:
    r"""Tunes a controller on a new twin, and tries the candidate there beside the present one.

    ```python
    found = jt.retune(fit, pid, "0:30,300:45,600:30", duration=900)
    print(found.summary())
    found.controller
    ```

    The search is that of `tune`, over draws of the posterior. The candidate then runs in scenarios
    that would be unsafe to try on the rig, over other draws. It is accepted if, in all of them, the
    limits of temperature are kept in 99 % of the draws, and its cost is not above that of the
    present controller by more than `allowance`; and if the sensitivity peak is at most 2 in 95 % of
    the draws. Its limits of duty are always those of the present controller.

    **Arguments:**

    - `fit`: the new fit.
    - `controller`: the present controller, where the search begins.
    - `references`, `duration`: the steps for which it is tuned and tried, as in `tune`.
    - `objective`: as in `tune`; weights are not below 0.
    - `scenarios`: those of the trial, the first of which is the usual one; None for
      `jaxtwin.retuning.usual_scenarios`.
    - `draws`: the number of draws of the trial.
    - `allowance`: the part by which the candidate may be worse than the present controller in a
      scenario.
    - `seed`: the seed of draws, starts and noise.
    - `workers`: the number of threads, None for one for each core.

    **Returns:** a `Retuned`. Nothing is written: `keep_retuned` and `jaxtwin retune` do that.

    **Raises:** `ControlError` if arguments do not fit each other, if the references are out of
    reach, and for a rig without a limit of temperature.
    """
    began = time.perf_counter()
    where = "retune"
    of_kind(f"{where}: fit", fit, Fit, "a Fit, as match gives it", ControlError)
    count = whole_number(f"{where}: draws", draws, 1, ControlError)
    least = whole_number(f"{where}: seed", seed, 0, ControlError)
    part = finite_number(f"{where}: allowance", allowance, ControlError)
    if part < 0:
        raise ControlError(f"{where}: allowance: expected a number of at least 0, got {part:g}")
    twin = nominal_twin(f"{where}: fit", fit, ControlError)
    aim = checked_objective(where, objective, 0.0, twin.rig)
    if (aim.weights < 0).any():
        name = list(aim.measures)[int(np.argmin(aim.weights))]
        raise ControlError(
            f"{where}: objective: {name}: expected a weight of at least 0, because less of it is "
            f"better, got {aim.weights.min():g}"
        )
    check_limit(twin)
    present = controller.for_rig(twin.rig)
    trial = Trial(
        twin,
        posterior_draws(fit, count, seed=least + 1),
        references,
        duration,
        aim,
        part,
        least,
        workers,
    )
    chosen = usual_scenarios(twin, present, float(duration)) if scenarios is None else scenarios
    several = tuple(chosen)
    if not several:
        raise ControlError(f"{where}: scenarios: expected at least one, got none")

    def made(
        decision: Decision,
        reason: str,
        tuning: Tuning | None = None,
        tried: Tried | None = None,
        peak: float = math.nan,
    ) -> Retuned:
        return Retuned(
            rig=twin.rig.name,
            decision=decision,
            reason=reason,
            present=present,
            candidate=None if tuning is None else tuning.controller,
            tuning=tuning,
            trials=() if tried is None else tried.trials,
            sensitivity_peak=peak,
            band=None if tried is None else tried.band,
            wall_time=time.perf_counter() - began,
        )

    levels = _levels(references, duration, present, twin)
    limit, tuning, peak = USUAL_PEAK, None, math.nan
    for _ in range(REPEATS):
        problem = tuning_problem(
            where,
            present,
            fit,
            references,
            duration,
            tuned=None,
            objective=objective,
            draws=TUNING_DRAWS,
            tail_weight=0.5,
            sensitivity_limit=limit if present.is_linear else None,
            starts=STARTS,
            seed=least,
            workers=workers,
            settings={},
        )
        try:
            tuning = problem.solved(ROUNDS, time.perf_counter())
        except ControlError as error:
            return made("rejected", str(error))
        peak = _peak(twin, tuning.controller, levels, trial.draws)
        if not peak > USUAL_PEAK * (1 + PEAK_TOLERANCE):
            break
        # About what the excess asks for, and at most half of what there was.
        limit = 1 + (limit - 1) * max(0.98 * (USUAL_PEAK - 1) / (peak - 1), 0.5)
    assert tuning is not None
    candidate = tuning.controller
    same = ("limits", "sample_time_s")
    if any(getattr(candidate, name) != getattr(present, name) for name in same):
        return made(
            "rejected", "the candidate has other limits than the present controller", tuning
        )
    tried = trial.of(present, candidate, several)
    failed = [one for one in tried.trials if not one.passed]
    if failed:
        first = failed[0]
        more = f", and {len(failed) - 1} more scenarios" if len(failed) > 1 else ""
        reason = f"{first.scenario.name}: {first.sentence}{more}"
        return made("rejected", reason, tuning, tried, peak)
    if peak > USUAL_PEAK * (1 + PEAK_TOLERANCE):
        reason = (
            f"the sensitivity peak is up to {peak:.3g} in {100 * PEAKS_WITHIN:g} % of the draws, "
            f"where {USUAL_PEAK:g} is allowed"
        )
        return made("rejected", reason, tuning, tried, peak)
    before, after = tried.trials[0].present.cost, tried.trials[0].candidate.cost
    count = len(tried.trials)
    old_peak = _peak(twin, present, levels, trial.draws)
    if old_peak > USUAL_PEAK * (1 + PEAK_TOLERANCE):  # a fragile loop is replaced at any cost
        better = f"the sensitivity peak is up to {peak:.3g} in place of {old_peak:.3g}"
        reason = f"{better}, and all {count} scenarios were passed"
        return made("accepted", reason, tuning, tried, peak)
    if not after <= (1 - WORTH) * before:
        reason = (
            f"the cost would be {after:.4g}, that of the present controller is {before:.4g}; a "
            f"change takes {100 * WORTH:g} % less"
        )
        return made("unchanged", reason, tuning, tried, peak)
    count = len(tried.trials)
    reason = (
        f"the cost is {after:.4g} in place of {before:.4g}, and all {count} scenarios were passed"
    )
    return made("accepted", reason, tuning, tried, peak)


def _levels(
    references: float | int | str | np.ndarray,
    duration: float | int,
    controller: AbstractController,
    twin: Twin,
) -> list[Float[np.ndarray, " outputs"]]:
    """The lowest and the highest references, at which the margins are judged."""
    times = sample_times("retune", duration, controller.sample_time_s)
    outputs = len(controller.output_weights(twin.channels))
    rows = reference_samples("retune: references", references, times, outputs)
    mean = rows.mean(axis=1)
    return [rows[number] for number in {int(np.argmin(mean)), int(np.argmax(mean))}]


def _peak(
    twin: Twin,
    controller: AbstractController,
    levels: Iterable[Float[np.ndarray, " outputs"]],
    draws: Mapping[str, Float[np.ndarray, " draws"]],
) -> float:
    """The sensitivity peak that 95 % of the draws do not exceed; infinite if one is not stable, NaN
    if the controller is not linear."""
    if not controller.averaged.is_linear:
        return math.nan
    several = [loop_margins(twin, controller, level, draws=dict(draws)) for level in levels]
    if not all(one.is_stable for one in several):
        return math.inf
    return max(float(np.quantile(one.sensitivity_peaks, PEAKS_WITHIN)) for one in several)
