"""Refits a twin, and decides whether the new one replaces the last."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from .._arguments import finite_number, of_kind, whole_number
from .._progress import announced
from .._result import AbstractResult, dataset, table
from ..control import AbstractController
from ..errors import MatchError
from ..io import Experiment, Recordings, as_experiments
from ..matching import Fit, divided, named_recordings
from ..monitoring import DAY, MonitorCalibration, monitor_observed
from ..observers import ProcessNoise, observe
from ..simulation import simulate
from ..twin_store import TwinStore, TwinVersion
from ._forgetting import session_prior
from ._gate import (
    GateCheck,
    check_changes,
    check_converged,
    check_coverage,
    check_forecast,
    check_likelihood,
    check_limits,
    check_loop,
    check_mistakes,
    check_plausible,
    check_readings,
    check_residuals,
    moved,
)
from ._held_out import replay, run_of_refit, split
from ._mistakes import BETTER, POSSIBLE, likely_mistakes, with_held_out_costs
from ._session_match import SessionMatch, match_session

if TYPE_CHECKING:
    import pandas
    import xarray


Decision = Literal["promoted", "unchanged", "rejected", "ask"]

# The time ahead of the forecasts that are compared, s.
LEAD = 60.0


@final
@dataclass(frozen=True, repr=False, eq=False)
class Refit(AbstractResult):
    """A refitted twin, and whether it replaces the last one.

    **Arguments:**

    - `decision`: `promoted` if the new twin passed the gate, `unchanged` if nothing has changed
      that is worth a promotion, `rejected` if a check failed, and `ask` if a person should decide.
    - `reason`: why, in a sentence.
    - `fit`: the new fit, whatever the decision; None if the recordings were not fit to be matched.
    - `last`: the fit before.
    - `checks`: the checks of the gate, in their order.
    - `changed`: the parameters that changed beyond the drift between sessions.
    """

    decision: Decision
    reason: str
    fit: Fit | None
    last: Fit
    checks: tuple[GateCheck, ...]
    changed: tuple[str, ...]

    @property
    def twin(self) -> Fit:
        """The fit to use from now on: the new one if it was promoted, otherwise the last."""
        return self.fit if self.decision == "promoted" and self.fit is not None else self.last

    @property
    def failed(self) -> tuple[GateCheck, ...]:
        """The checks that were not passed."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def is_alarm(self) -> bool:
        """Whether somebody should look at the rig."""
        return any(check.is_alarm for check in self.failed)

    @property
    def converged(self) -> bool:
        """Whether the match converged; true if nothing was matched."""
        return self.fit is None or self.fit.converged

    def summary(self) -> str:
        """The decision, and a line for each check."""
        lines = [f"{self.decision}: {self.reason}"]
        lines += [
            f"  {'ok ' if check.passed else 'NOT'} {check.name}: {check.sentence}"
            for check in self.checks
        ]
        return "\n".join(lines)

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.last.twin.rig.name,
            "decision": self.decision,
            "reason": self.reason,
            "changed": self.changed,
            "is_alarm": self.is_alarm,
            "converged": self.converged,
            "checks": [asdict(check) for check in self.checks],
            "fit": None if self.fit is None else self.fit.to_dict(),
        }

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each check, its name as index."""
        return table(self.checks, "name")

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the numbers of the checks: passed, value and limit (check)."""
        checks = self.to_dataframe()
        numbers = {name: ("check", checks[name]) for name in ("passed", "value", "limit")}
        attributes = {"decision": self.decision, "reason": self.reason}
        return dataset(numbers, attributes, check=checks.index)

    def _overview(self) -> "pandas.DataFrame":
        return self.to_dataframe().filter(["passed", "sentence"])

    def __repr__(self) -> str:
        return f"<Refit of {self.last.twin.rig.name}: {self.decision}: {self.reason}>"


@announced("refit")
def refit(
    fit: Fit,
    recordings: Recordings,
    *,
    window: float | int | None = None,
    forgetting: float | int = 1.0,
    changes: int = 1,
    noise: ProcessNoise | None = None,
    calibration: MonitorCalibration | None = None,
    controller: AbstractController | None = None,
    reference: ArrayLike | float | int | None = None,
    lead: float | int = LEAD,
    max_iterations: int = 60,
) -> Refit:
    """Refits a twin to new recordings, and lets a gate decide whether it replaces the last one.

    The posterior of the last fit is the prior of the new one, with a step of the random walk that
    sessions take. If the values of the last fit do not explain a session, but for that drift, the
    value is released that explains it best, such as that of a contact. The new twin sees all
    recordings but the last, or the first two thirds of a single one. Both twins then predict what
    is held out, and the gate compares them: `docs/refits.md` describes its checks.

    **Arguments:**

    - `fit`: the last fit; its recordings are not needed.
    - `recordings`: recordings of one session or several, in the order of time, all of one group.
      Their `Experiment.glitches` are left out.
    - `window`: the time at the end of the recordings that counts, s; None for all of it.
    - `forgetting`: the step between sessions, in standard deviations between the recordings of the
      fit: 1 is what these say, 0 forgets nothing.
    - `changes`: the number of values that may have changed at once, beyond drift. After work on the
      rig more than one.
    - `noise`: the noise of the observers, as for `observe`.
    - `calibration`: what is healthy, for the test of frozen channels; as for `monitor`.
    - `controller`: the controller that runs on the twin. Its loop must be safe on the new one too.
    - `reference`: the reference at which its loop is judged, degC; by default the mean reading of
      what is held out.
    - `lead`: the time ahead of the forecasts that are compared, s.
    - `max_iterations`: the limit of each descent.

    **Returns:** a `Refit`. Nothing is written: `TwinStore` and `jaxtwin refit` do that.

    **Raises:** `MatchError` if a recording was already matched, if recordings are of several
    groups, too short, or have too few readings in what is held out; the errors of `match` and
    `observe`.
    """
    of_kind("refit: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    factor = finite_number("refit: forgetting", forgetting, MatchError, least=0)
    ahead = finite_number("refit: lead", lead, MatchError, above=0, unit="s")
    most = whole_number("refit: changes", changes, 0, MatchError)
    whole_number("refit: max_iterations", max_iterations, 1, MatchError)
    if controller is not None:
        of_kind("refit: controller", controller, AbstractController, "a controller", MatchError)
    several = as_experiments("refit: recordings", recordings, MatchError, fit.twin.rig)
    several, _ = divided(_in_window(several, window))
    _check_new(fit, several)
    # Nobody looks at the recordings of an unattended refit, and one glitch would move its values.
    several = [each.without_glitches() for each in several]
    _check_new(fit, several)
    parts = split(several, ahead, frozenset(name for names in fit.channels for name in names))
    last = [
        replay(fit, recording, since, noise, ahead)
        for recording, since in zip(parts.held_out, parts.since, strict=True)
    ]
    checks: list[GateCheck] = []
    for recording in several:
        known = [each.observed for each in last if each.observed.experiment is recording]
        observed = known[0] if known else observe(fit, recording, noise)
        checks.append(check_readings(monitor_observed(observed, fit, calibration, 30 * DAY)))
    if any(not check.passed for check in checks):
        return _decided(fit, None, checks)
    prior = session_prior(fit, several[0].group, factor)
    seen = named_recordings(fit.twin, parts.seen)
    match = match_session(fit, prior, seen, most, max_iterations)
    checks.append(check_converged(match))
    after = [
        replay(match.fit, recording, since, noise, ahead)
        for recording, since in zip(parts.held_out, parts.since, strict=True)
    ]
    rivals = likely_mistakes(fit, prior, match, seen)
    if (-BETTER if match.changed else POSSIBLE) < match.cost - rivals[0].cost <= BETTER:
        held_out = list(zip(parts.held_out, parts.since, after, strict=True))
        rivals = with_held_out_costs(rivals, fit, prior, seen, held_out, noise, ahead)
    checks.append(check_mistakes(rivals, match, fit))
    checks.append(check_changes(match, fit))
    whole = [run_of_refit(match.fit, recording, parts.seen) for recording in parts.held_out]
    runs = whole + [
        simulate(match.fit.twins[name], recording)
        for name, recording in seen.items()
        if len(parts.seen) > 1 or len(several) > 1
    ]
    checks.append(check_residuals(runs, fit))
    checks.append(check_plausible(match, fit))
    checks.append(check_limits(runs))
    for old, new in zip(last, after, strict=True):
        checks += [check_likelihood(old, new), check_forecast(old, new), check_coverage(old, new)]
    if controller is not None:
        at = _mean_reading(parts.held_out[-1]) if reference is None else reference
        checks.append(check_loop(fit, match.fit, controller, at))
    return _decided(fit, match, checks)


def _decided(last: Fit, match: SessionMatch | None, checks: list[GateCheck]) -> Refit:
    """The decision that follows from the checks: a rejection if one of them rejects, otherwise that
    of the first one that is not passed. A change that a mistake of the recording explains equally
    well is asked about first, before the checks that the new twin is worth a promotion."""
    new = None if match is None else match.fit
    changed = () if match is None else match.changed
    failed = [check for check in checks if not check.passed]
    rejecting = [check for check in failed if check.verdict == "reject"]
    of_predictions = {"likelihood", "forecast", "coverage"}

    def made(decision: Decision, reason: str) -> Refit:
        return Refit(decision, reason, new, last, tuple(checks), changed)

    if not changed and failed and {check.name for check in failed} <= of_predictions:
        return made(
            "unchanged",
            "nothing has changed beyond the drift between sessions, and the last twin predicts "
            "what was held out as well",
        )
    if rejecting:
        # A mistake that explains it as well is said before "another rig".
        first = failed[0] if failed[0].verdict == "ask" else rejecting[0]
        return made("rejected", first.sentence)
    if failed and failed[0].verdict == "keep":
        assert new is not None
        return made("unchanged", f"{moved(last, new, changed)}, but {failed[0].sentence}")
    if failed:
        return made("ask", failed[0].sentence)
    assert new is not None
    better = next(check.sentence for check in checks if check.name == "likelihood")
    what = moved(last, new, changed) or "nothing has changed beyond drift"
    return made("promoted", f"{what}, and {better}")


def _in_window(recordings: Sequence[Experiment], window: float | int | None) -> list[Experiment]:
    """The last `window` seconds of the recordings, all of them together."""
    if window is None:
        return list(recordings)
    left = finite_number("refit: window", window, MatchError, above=0, unit="s")
    kept: list[Experiment] = []
    for recording in reversed(recordings):
        if left <= 0:
            break
        kept.append(
            recording
            if recording.duration <= left
            else recording.between(recording.time[-1] - left, None)
        )
        left -= recording.duration
    return kept[::-1]


def _check_new(fit: Fit, recordings: Sequence[Experiment]) -> None:
    """Refuses recordings that the fit has seen, and those of several groups."""
    for recording in recordings:
        if recording.fingerprint in fit.fingerprints:
            raise MatchError(
                "refit: expected recordings that the fit has not seen, got "
                f"{recording.name!r}, which it was matched to"
            )
    groups = sorted({recording.group for recording in recordings})
    if len(groups) > 1:
        raise MatchError(
            f"refit: expected recordings of one group, got {', '.join(map(repr, groups))}; refit "
            "one group after the other"
        )


def _mean_reading(recording: Experiment) -> float:
    return float(np.nanmean(np.asarray(recording.temperatures)))


# Writes down in a store of twins what a refit has decided.

# Tags of the version that judged a recording: `refit` and the beginning of its fingerprint.
TAG = "refit"


def keep_refit(
    store: TwinStore, champion: TwinVersion, recording: Experiment, result: Refit
) -> TwinVersion:
    """Writes down what was decided: a promoted twin becomes the champion, and one of which a person
    is asked the challenger. The champion so far gets a tag that says what was decided.

    **Arguments:**

    - `store`: the store. `champion`: the version that was refitted.
    - `recording`: the recording to which it was refitted.
    - `result`: the refit.

    **Returns:** the champion from now on.
    """
    store.set_tag(
        champion.number,
        f"{TAG} {recording.fingerprint[:12]}",
        f"{result.decision}: {result.reason}",
    )
    if result.fit is None or result.decision not in ("promoted", "ask"):
        return champion
    added = store.add(
        result.fit,
        reason=result.reason,
        parent=champion.number,
        noise=champion.noise,
        aliases=["challenger"],
        controller=champion.controller_text,  # which goes on until it is tuned again
    )
    if result.decision == "ask":
        return champion
    return store.promote(added.number, reason=result.reason)
