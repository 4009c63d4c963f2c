"""The gate: checks that a refitted twin passes before it replaces the last one.

Each check is a function that gives a `GateCheck`. Checks of the recording and of the match reject;
checks of the loop may ask a person instead.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike

from ..control import USUAL_PEAK, AbstractController, loop_margins
from ..errors import ControlError
from ..matching import Fit
from ..monitoring import Monitored
from ..rig import unit_scale
from ..simulation import Run, exceeded_limits
from ._held_out import HeldOutReplay, block_errors
from ._mistakes import BETTER, POSSIBLE, Mistake
from ._session_match import SessionMatch

# The kinds of findings that no change of a rig explains.
BROKEN = ("frozen", "gone")

# The error of a part of a recording, at most, in errors of the last fit.
RESIDUALS = 3.0

# The factor by which a value changes at most on a rig that is still the same.
MAX_CHANGE_FACTOR = 4.0

# The units of heat capacities and Seebeck coefficients: they stay while the parts are the same.
UNITS_OF_MATTER = ("J/K", "V/K")

# The distance from the rig file's priors, at most, in standard deviations.
PRIORS = 3.5

# An error of forecasts that is larger by this factor is worse.
WORSE = 1.05

# The part of the readings that bands of 95 % contain, at least, if those of the last twin do.
MIN_COVERAGE = 0.7

# A new twin is worth a promotion if what was held out is more probable with it by this factor, by
# which one explanation is better than another everywhere else in the gate.
WORTH = 20.0

Verdict = Literal["reject", "ask", "keep"]


@final
@dataclass(frozen=True)
class GateCheck:
    """One check of the gate.

    - `name`: its name in a word, for programs. `passed`: whether it was passed.
    - `value`, `limit`: what was found and what is allowed, NaN where there is no number.
    - `sentence`: what was found, for people.
    - `verdict`: what follows if it is not passed: the new twin is rejected, a person is asked, or
      the last twin is kept because the new one is not worth a promotion.
    - `is_alarm`: whether somebody should look at the rig then.
    """

    name: str
    passed: bool
    value: float
    limit: float
    sentence: str
    verdict: Verdict = "reject"
    is_alarm: bool = False


def check_readings(monitored: Monitored) -> GateCheck:
    """Whether all channels are alive: a frozen one, or one that has gone to the room, is no
    change of the rig."""
    broken = [finding for finding in monitored.findings if finding.kind in BROKEN]
    text = f"{broken[0].detail} from {broken[0].since:.0f} s on" if broken else ""
    name = monitored.experiment.name or "the recording"
    return GateCheck(
        "readings",
        not broken,
        float(len(broken)),
        0.0,
        f"{name}: {text or 'every channel is alive'}",
        is_alarm=True,
    )


def check_mistakes(mistakes: Sequence[Mistake], match: SessionMatch, last: Fit) -> GateCheck:
    """Whether a change of the rig explains the recording better than a mistake of the recording.

    **Arguments:**

    - `mistakes`: those that explain it best, the best first.
    """
    gain = match.cost - mistakes[0].cost
    # Those that are about as good as the best, and not merely no worse than no mistake.
    least = BETTER if gain > BETTER else -BETTER
    likely = [
        mistake.sentence
        for mistake in mistakes
        if mistake.cost <= mistakes[0].cost + BETTER and match.cost - mistake.cost >= least
    ] or [mistakes[0].sentence]
    told = ", or ".join(likely)
    if gain > BETTER:
        text = f"the last twin explains the recording {told}"
    elif gain > -BETTER and match.changed:
        return GateCheck(
            "mistakes",
            False,
            gain,
            BETTER,
            f"either {moved(last, match.fit, match.changed)}, or the last twin is right {told}: "
            "both explain the recording about as well",
            "ask",
        )
    elif gain > POSSIBLE and not match.changed:
        text = (
            f"the recording would be {math.exp(gain):.2g} times as probable {likely[0]}, where "
            f"{math.exp(BETTER):.2g} times are needed to say so"
        )
    else:
        text = "no mistake of the recording explains it as well"
    return GateCheck("mistakes", gain <= BETTER, gain, BETTER, text)


def moved(last: Fit, new: Fit, names: Sequence[str]) -> str:
    """Says how values have changed."""
    each = [
        f"{name} changed from {last[name].value:.3g} to {new[name].value:.3g} {new[name].unit}"
        for name in names
    ]
    return ", ".join(cell.rstrip() for cell in each)


def check_converged(match: SessionMatch) -> GateCheck:
    """Whether the match ended at an optimum."""
    return GateCheck(
        "converged", match.fit.converged, math.nan, math.nan, f"the match: {match.fit.status}"
    )


def check_changes(match: SessionMatch, last: Fit) -> GateCheck:
    """Whether the session is explained by drift and by what changes on a rig that is still the
    same: few values, none of them many times, and no constant of its matter."""
    names = ", ".join(match.changed)
    result = match.explanation
    passed = result.is_enough
    text = f"{names or 'nothing'} changed beyond the drift between sessions"
    if not passed:
        if result.error > result.limit:
            why = (
                f"it leaves an error of {result.error:.3g} K, at most {result.limit:.3g} K is usual"
            )
        else:
            why = f"{result.next_name} would have to change too"
        text = (
            f"{names or 'drift'} alone does not explain the session, {why}: this looks like "
            "another rig, or one that changed meanwhile"
        )
    for name in match.changed:
        row, before = match.fit[name], last[name]
        change = f"{name} would have changed from {before.value:.3g} to {row.value:.3g} {row.unit}"
        if row.is_logarithmic and abs(math.log(row.value / before.value)) > math.log(
            MAX_CHANGE_FACTOR
        ):
            passed, text = (
                False,
                f"{change.rstrip()}, more than {MAX_CHANGE_FACTOR:g} times: another rig",
            )
        elif any(_measures(row.unit, unit) for unit in UNITS_OF_MATTER):
            passed, text = False, f"{change}, which rigs do not do by themselves: another rig"
    return GateCheck("changes", passed, result.error, result.limit, text)


def _measures(unit: str, other: str) -> bool:
    try:
        unit_scale(unit, other)
    except ValueError:
        return False
    return True


def check_residuals(runs: list[Run], last: Fit) -> GateCheck:
    """Whether the new twin follows every part of the recordings about as well as the last twin
    followed those of its match."""
    errors = np.concatenate([block_errors(run).ravel() for run in runs])
    worst, limit = float(np.nanmax(errors)), RESIDUALS * last.rmse
    return GateCheck(
        "residuals",
        worst <= limit,
        worst,
        limit,
        f"in the worst part of the recordings the new twin is {worst:.3g} K off, with at most "
        f"{limit:.3g} K allowed",
    )


def check_plausible(match: SessionMatch, last: Fit) -> GateCheck:
    """Whether the values are inside their bounds, and near what the rig file expects."""
    table, held, worst, name = last.twin.rig.parameters, [], 0.0, ""
    for row in match.fit.parameters.values():
        if not row.free:
            continue
        if row.at_bound and not last[row.name].at_bound:
            held.append(row.name)
        own = table[row.name]
        if row.scope != "recording" and own.standard_deviation is not None:
            centre = own.prior_value if own.prior_value is not None else own.value
            distance = (own.to_entry(row.value) - own.to_entry(centre)) / own.standard_deviation
            if abs(distance) > abs(worst):
                worst, name = distance, row.name
    if held:
        text = f"{', '.join(held)} ended at a bound"
        return GateCheck("plausible", False, abs(worst), PRIORS, text)
    text = f"{name} is {abs(worst):.1f} standard deviations from the rig file's prior"
    if not name:
        text = "the rig file has no prior of a free parameter"
    return GateCheck("plausible", abs(worst) <= PRIORS, abs(worst), PRIORS, text)


def check_limits(runs: list[Run]) -> GateCheck:
    """Whether the new twin stays below the limits of the rig in the recordings: a twin whose cells
    melt in a session that went well is wrong. A limit that the recorded readings exceed themselves
    says nothing about the twin."""
    result = [text for run in runs for text in _beyond_limits(run)]
    hottest = max(float(np.max(run.states)) for run in runs)
    text = result[0] if result else f"the hottest node of the new twin reaches {hottest:.1f} degC"
    return GateCheck("limits", not result, hottest, math.nan, text)


def _beyond_limits(run: Run) -> tuple[str, ...]:
    """The limits that a run exceeds and its recording does not."""
    readings = run.experiment.temperatures
    if run.twin is None or readings is None:
        return run.beyond_limits
    recorded = np.asarray(readings, float)
    hottest = np.max(recorded, initial=-math.inf, where=np.isfinite(recorded))
    return exceeded_limits(run, run.twin.rig, float(hottest))


def check_likelihood(last: HeldOutReplay, new: HeldOutReplay) -> GateCheck:
    """Whether readings that the new twin has not seen are so much more probable than for the last
    one that it is worth a promotion: 20 times.

    Readings that follow each other say the same where a twin is off, so that the logarithm of this
    ratio is divided by the autocorrelation time of the innovations of the new twin.
    """
    gain = (new.log_likelihood - last.log_likelihood) / new.correlation
    limit = math.log(WORTH)
    # No reader needs more digits, and a float has not more of them.
    factor, more = math.exp(min(abs(gain), 50.0)), "more" if gain >= 0 else "less"
    over = "over " if abs(gain) > 50.0 else ""
    independent = new.readings / new.correlation
    text = (
        f"the {new.readings} held-out readings, as {independent:.0f} independent ones, are "
        f"{over}{factor:.3g} times {more} probable"
    )
    if not gain >= limit:
        text += f"; a promotion takes {WORTH:g} times"
    verdict: Verdict = "keep" if gain > -limit else "reject"
    return GateCheck("likelihood", gain >= limit, gain, limit, text, verdict)


def check_forecast(last: HeldOutReplay, new: HeldOutReplay) -> GateCheck:
    """Whether the new twin forecasts them as well."""
    limit = WORSE * last.forecast.rmse
    text = (
        f"held-out readings were forecast {new.forecast.lead:g} s ahead to "
        f"{new.forecast.rmse:.3g} K, by the last twin to {last.forecast.rmse:.3g} K"
    )
    return GateCheck("forecast", new.forecast.rmse <= limit, new.forecast.rmse, limit, text)


def check_coverage(last: HeldOutReplay, new: HeldOutReplay) -> GateCheck:
    """Whether the 95 % bands contain 70 % of the readings, or as many as those of the last twin."""
    limit = min(MIN_COVERAGE, last.forecast.coverage)
    result = new.forecast.coverage
    text = f"bands of 95 % contain {100 * result:.0f} % of the held-out readings"
    return GateCheck("coverage", result >= limit, result, limit, text)


def check_loop(
    last: Fit, new: Fit, controller: AbstractController, reference: ArrayLike | float
) -> GateCheck:
    """Whether the loop of a controller is as safe on the new twin as it should be."""
    try:
        margins = loop_margins(new, controller, reference)
        before = loop_margins(last, controller, reference)
    except ControlError as problem:
        text = f"the loop of the controller cannot be judged: {problem}"
        return GateCheck("loop", False, math.nan, USUAL_PEAK, text, "ask")
    peak = margins.sensitivity_peak
    if not margins.is_stable:
        text = "the loop of the controller is not stable on the new twin"
        return GateCheck("loop", False, math.inf, USUAL_PEAK, text, "ask", is_alarm=True)
    limit = max(USUAL_PEAK, before.sensitivity_peak if before.is_stable else 0.0)
    text = f"the loop of the controller: {margins.summary()}"
    return GateCheck("loop", peak <= limit, peak, limit, text, "ask")
