"""Tunes a controller on a new twin, and tries it there before anything reaches the rig."""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from functools import cache

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, of_kind, whole_number
from .._jax_settings import own_settings
from .._progress import announced
from ..control import (
    PEAK_TOLERANCE,
    ROUNDING,
    USUAL_PEAK,
    AbstractController,
    Measure,
    SampledLoops,
    Tuning,
    checked_objective,
    reference_samples,
    sample_times,
    sampled_loops,
    tuning_problem,
)
from ..errors import ControlError
from ..matching import Fit, nominal_twin, posterior_draws
from ..physics import Twin
from ._retuned import Decision, Retuned
from ._scenarios import TrialScenario, usual_scenarios
from ._trial import ControllerTrial, ScenarioTrial, check_limit

# The number of draws with which a controller is tuned: those of the trial are other ones.
TUNING_DRAWS = 8

# The descents of the search, and the rounds of each.
STARTS, ROUNDS = 2, 20

# The share of the draws whose sensitivity peak is within the limit.
PEAKS_WITHIN = 0.95

# The peak that counts as one within the limit, and the limit below which the search is not
# repeated, though the draws of the trial exceed it.
HIGHEST_PEAK = USUAL_PEAK * (1 + PEAK_TOLERANCE)
LOWEST_LIMIT = 1.5

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
) -> Retuned:
    r"""Tunes a controller on a new twin, and tries the candidate there beside the present one.

    ```python
    retuned = jt.retune(fit, pid, "0:30,300:45,600:30", duration=900)
    print(retuned.summary())
    retuned.controller
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

    **Returns:** a `Retuned`. Nothing is written: `keep_retuned` and `jaxtwin retune` do that.

    **Raises:** `ControlError` if arguments do not fit each other, if the references are out of
    reach, and for a rig without a limit of temperature.
    """
    began = time.perf_counter()
    where = "retune"
    of_kind(f"{where}: fit", fit, Fit, "a Fit, as match gives it", ControlError)
    count = whole_number(f"{where}: draws", draws, 1, ControlError)
    seed = whole_number(f"{where}: seed", seed, 0, ControlError)
    worse = finite_number(f"{where}: allowance", allowance, ControlError, least=0)
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
    drawn = posterior_draws(fit, count, seed=seed + 1)
    trial = ControllerTrial(twin, drawn, references, duration, aim, worse, seed)
    usual = scenarios is None
    cases = usual_scenarios(twin, present, float(duration)) if usual else tuple(scenarios)
    if not cases:
        raise ControlError(f"{where}: scenarios: expected at least one, got none")

    levels = _levels(references, duration, present, twin)

    @cache
    def plants() -> list[SampledLoops]:
        weights = np.asarray(present.output_weights(twin.channels), float)
        first, drawn = present.averaged, dict(trial.draws)
        with own_settings():
            return [sampled_loops(twin, drawn, first, weights, level) for level in levels]

    def peak_of(tried: AbstractController) -> float:
        return _peak(plants(), tried.averaged) if tried.averaged.is_linear else math.nan

    tuning, peak, trials, band = None, math.nan, (), None
    try:
        tuning, peak = _tuned(fit, present, trial, objective, peak_of)
        trials, band = trial.of(present, tuning.controller, cases)
        decision, reason = _decided(present, tuning.controller, trials, peak, peak_of)
    except NotTunedError as error:
        decision, reason = "rejected", str(error)
    return Retuned(
        rig=twin.rig.name,
        decision=decision,
        reason=reason,
        present=present,
        candidate=None if tuning is None else tuning.controller,
        tuning=tuning,
        trials=trials,
        sensitivity_peak=peak,
        band=band,
        wall_time=time.perf_counter() - began,
    )


class NotTunedError(Exception):
    """The search has found no controller."""


def _tuned(
    fit: Fit,
    present: AbstractController,
    trial: ControllerTrial,
    objective: str | Mapping[str, float] | Measure,
    peak_of: Callable[[AbstractController], float],
) -> tuple[Tuning, float]:
    """Tunes the controller, and returns the sensitivity peak in the draws of the trial too. The
    search is repeated with a lower limit where these exceed it.

    **Raises:** `NotTunedError` for a match that has not converged, and if no controller satisfies
    the limit.
    """
    if not fit.converged:
        raise NotTunedError(f"the match of the twin has not converged: {fit.status}")
    limit = USUAL_PEAK
    while True:
        problem = tuning_problem(
            "retune",
            present,
            fit,
            trial.references,
            trial.duration,
            tuned=None,
            objective=objective,
            draws=TUNING_DRAWS,
            tail_weight=0.5,
            sensitivity_limit=limit if present.is_linear else None,
            starts=STARTS,
            seed=trial.seed,
            workers=None,
            settings={},
        )
        try:
            tuning = problem.solved(ROUNDS, time.perf_counter())
        except ControlError as error:
            raise NotTunedError(str(error)) from None
        peak = peak_of(tuning.controller)
        if not peak > HIGHEST_PEAK or limit < LOWEST_LIMIT:
            return tuning, peak
        # About what the excess asks for, and at most half of what there was.
        limit = 1 + (limit - 1) * max(0.98 * (USUAL_PEAK - 1) / (peak - 1), 0.5)


def _decided(
    present: AbstractController,
    candidate: AbstractController,
    trials: tuple[ScenarioTrial, ...],
    peak: float,
    peak_of: Callable[[AbstractController], float],
) -> tuple[Decision, str]:
    """The decision about a candidate, and its reason."""
    for name in ("limits", "sample_time_s"):
        if getattr(candidate, name) != getattr(present, name):
            return "rejected", f"the {name} of the candidate are not those of the controller in use"
    failed = [trial for trial in trials if not trial.passed]
    if failed:
        more = f", and {len(failed) - 1} more scenarios" if len(failed) > 1 else ""
        return "rejected", f"{failed[0].scenario.name}: {failed[0].sentence}{more}"
    if peak > HIGHEST_PEAK:
        share = f"{100 * PEAKS_WITHIN:g} % of the draws"
        return "rejected", (
            f"the sensitivity peak is up to {peak:.3g} in {share}, where {USUAL_PEAK:g} is allowed"
        )
    passed = f"all {sum(trial.is_tried for trial in trials)} scenarios were passed"
    if (old := peak_of(present)) > HIGHEST_PEAK:  # a fragile loop is replaced at any cost
        return "accepted", (
            f"the sensitivity peak is up to {peak:.3g} in place of {old:.3g}, and {passed}"
        )
    before, after = trials[0].present.cost, trials[0].candidate.cost
    if after <= (1 - WORTH) * before:
        return "accepted", f"the cost is {after:.4g} in place of {before:.4g}, and {passed}"
    return "unchanged", (
        f"the cost would be {after:.4g}, with the present controller it is {before:.4g}; a change "
        f"takes {100 * WORTH:g} % less"
    )


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


def _peak(plants: Iterable[SampledLoops], controller: AbstractController) -> float:
    """The sensitivity peak that 95 % of the draws do not exceed; infinite if one is not stable."""
    with own_settings():
        loops = [plant.with_controller(controller) for plant in plants]
        if not all(loop.growth() < 1 + ROUNDING for loop in loops):
            return math.inf
        return max(float(np.quantile(loop.peaks(), PEAKS_WITHIN)) for loop in loops)
