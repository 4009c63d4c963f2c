r"""Finds the health of a rig from several sessions, each of which says something of a parameter by
itself: its estimate without the prior.

A match has priors: those of the rig file, or, in a refit, the posterior of the session before. They
draw the values of all sessions to one place and would hide a trend. With the variance $a =
(A^{-1})_{ii}$ of a parameter in the match, and its prior $N(\mu, p^2)$, the part $w = a / p^2$ of
the estimate $u$ is the prior. What remains without it is the maximum of the integrated likelihood,

$$u' = \frac{u - w \mu}{1 - w}, \qquad s'^2 = \frac{s^2 - w^2 p^2}{(1 - w)^2},$$

where $s^2$ is the variance of $u$ (that of the sandwich). This is the cavity of the prior in the
words of expectation propagation (Minka 2001), and exact for normal distributions. The other
parameters keep their priors: a session seldom determines all of them.

An observer has such a prior too: what it knows of a parameter before the first reading, which is
also what it would know at the end without any. Its session says where the parameter is at the end.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, date, datetime
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, mapping_of, names_of, of_kind
from .._jax_settings import own_settings
from .._name_suggestions import unknown_name
from ..errors import MatchError, ParameterError
from ..matching import Fit, FittedParameter
from ..monitoring import DAY
from ..observers import Observed
from ..rig import Rig
from ..twin_store import TwinStore, TwinVersion
from ._health import Health, ParameterHealth
from ._trend import MIN_SESSIONS, random_effects_trend

# A session of whose estimate the prior is a larger part than this says nothing of a parameter.
MAX_PRIOR = 0.9


@final
class SessionEstimate(NamedTuple):
    """An estimate and its standard error, of the logarithm if the parameter is matched by it."""

    value: float
    error: float


@final
class EstimatedSession(NamedTuple):
    """What a session says of its rig.

    - `free`: the parameters that were estimated. `estimates`: of those that the session determines.
    - `has_converged`: whether its match did; true for an observed session.
    """

    rig: Rig
    free: tuple[str, ...]
    estimates: dict[str, SessionEstimate]
    has_converged: bool


def session_of(session: Fit | Observed) -> EstimatedSession:
    """What a match, or an observer, found in a session."""
    if isinstance(session, Observed):
        rig = session.observer.model.twin.rig
        return EstimatedSession(
            rig, tuple(session.estimates.parameters), _observed(session, rig), True
        )
    free = (n for n, row in session.parameters.items() if row.free and row.scope != "recording")
    return EstimatedSession(session.twin.rig, tuple(free), _matched(session), session.converged)


def _matched(fit: Fit) -> dict[str, SessionEstimate]:
    """What the recordings of a fit say of each parameter that belongs to the rig, and not to a
    recording. Parameters that were held, ended at a bound or are undetermined are left out."""
    places = {label: place for place, label in enumerate(fit.uncertainty.labels)}
    result = {}
    for name, row in fit.parameters.items():
        if row.scope != "recording" and name in places and math.isfinite(row.standard_error):
            at = (places[name], places[name])
            estimate = _of_match(
                row,
                float(fit.uncertainty.vector_covariance[at]),
                float(fit.uncertainty.inverse_hessian[at]),
            )
            if estimate is not None:
                result[name] = estimate
    return result


def _observed(observed: Observed, rig: Rig) -> dict[str, SessionEstimate]:
    """What the readings say of the uncertain values of an observer at the end of the recording."""
    directions = observed.estimates.directions
    if directions is None:
        return {}
    with own_settings():
        spreads = np.asarray(directions.spreads(observed.noise))
    priors = np.linalg.norm(np.asarray(directions.matrix) * spreads, axis=1)
    moments, estimates = observed.estimates.moments.values, {}
    for number, name in enumerate(directions.names):
        change, spread = (float(part[-1, number]) for part in moments)
        estimate = _without_prior(change, spread**2, spread**2, 0.0, float(priors[number]))
        if estimate is not None:
            value = float(directions.values[number])
            is_logarithmic = directions.is_logarithmic[number]
            estimates[name] = _in_entries_of(rig, name, value, is_logarithmic, estimate)
    return estimates


def _in_entries_of(
    rig: Rig, name: str, value: float, is_logarithmic: bool, change: SessionEstimate
) -> SessionEstimate:
    """A change of a value as an estimate, of the logarithm if the rig's table has it so."""
    if rig.parameters[name].is_logarithmic:
        return SessionEstimate(math.log(value) + change.value, change.error)
    if is_logarithmic:
        result = value * math.exp(change.value)
        return SessionEstimate(result, result * change.error)
    return SessionEstimate(value + change.value, change.error)


def _of_match(
    row: FittedParameter, variance: float, model_variance: float
) -> SessionEstimate | None:
    value = math.log(row.value) if row.is_logarithmic else row.value
    if row.prior_value is None or row.prior_spread is None:
        return SessionEstimate(value, math.sqrt(variance)) if variance > 0 else None
    prior = math.log(row.prior_value) if row.is_logarithmic else row.prior_value
    spread = math.hypot(row.prior_spread, row.group_spread or 0.0)
    return _without_prior(value, variance, model_variance, prior, spread)


def _without_prior(
    value: float, variance: float, model_variance: float, prior: float, spread: float
) -> SessionEstimate | None:
    """The estimate without a prior of this mean and standard deviation; None if the prior is most
    of it."""
    part = model_variance / spread**2 if spread > 0 else 1.0
    if not 0 < part < MAX_PRIOR:
        return None
    # Nothing becomes surer without its prior: rounding, and noise below that of the match, could
    # otherwise say so.
    left = max(variance - (part * spread) ** 2, variance * (1 - part) ** 2)
    return SessionEstimate((value - part * prior) / (1 - part), math.sqrt(left) / (1 - part))


Time = float | int | str | date

SESSION = "a Fit of this session by itself, or an Observed recording"


@final
class _Sessions(NamedTuple):
    """The sessions by name, and what is known of their times."""

    found: dict[str, EstimatedSession]
    made: tuple[datetime, ...] | None


def health(
    sessions: TwinStore | Mapping[str, Fit | Observed] | Sequence[Fit | Observed],
    times: Sequence[Time] | None = None,
    *,
    limits: Mapping[str, float | int] | None = None,
    within: float | int | None = None,
    names: Iterable[str] | None = None,
) -> Health:
    r"""Finds how the parameters of a rig change over sessions.

    For each parameter the trend over the sessions is found, with its standard error, and how much
    sessions differ from it beyond their own errors (`jaxtwin.prognostics`). What a session says is
    counted without the priors of its match. With a limit, the result says with which probability
    the trend passes it within a time.

    **Arguments:**

    - `sessions`: three or more, in the order of time: session -> fit, where each fit is that of a
      session by itself, such as those of `match_many`; or fits, which are named by their
      recordings. A session may also be one that `observe` followed, with the parameters that drift
      in its `noise`; it says where they are at its end. Of a store of twins the champion and the
      versions before it, by their parents.
    - `times`: when the sessions were: dates, texts such as `"2026-01-31"` (ISO 8601), or numbers of
      days. By default the times when the versions of a store were made, and 1, 2, 3, ... for fits.
    - `limits`: name -> a value that the parameter should not pass. It is above or below what is
      healthy; the trend at the first session is taken for healthy.
    - `within`: how far ahead limits are looked at, in days, or in sessions without times; by
      default as far as the sessions reach back.
    - `names`: the parameters to look at; by default all that are free.

    **Returns:** a `Health`.

    **Raises:** `MatchError` for fewer than three sessions, those of several rigs, times that do not
    increase, sessions that determine nothing, and a limit of a parameter that they do not
    determine; `ParameterError` for an unknown name.
    """
    known = _sessions(sessions)
    rig = next(iter(known.found.values())).rig
    rows = rig.parameters
    when, unit = _times(times, known)
    ahead = (
        when[-1] - when[0]
        if within is None
        else finite_number("health: within", within, MatchError, least=0)
    )
    bounds = _limits(limits, rig)
    estimates = [session.estimates for session in known.found.values()]
    free = dict.fromkeys(name for session in known.found.values() for name in session.free)
    wanted = list(free) if names is None else list(names_of("health: names", names, MatchError))
    for name in (*wanted, *bounds):
        if name not in rows:
            raise ParameterError(f"health: {unknown_name('parameter', name, rows)}")
    result, undetermined = [], []
    for name in dict.fromkeys([*wanted, *bounds]):
        row = _parameter(rig, name, when, [each.get(name) for each in estimates])
        if row is None and name in bounds:
            raise MatchError(
                f"health: limits: {name}: expected a parameter that {MIN_SESSIONS} sessions "
                "determine, "
                "got one that fewer do"
            )
        if row is None:
            undetermined.append(name)
        else:
            result.append(replace(row, limit=bounds.get(name)))
    if not result:
        raise MatchError(
            f"health: expected a parameter that {MIN_SESSIONS} sessions determine, got none among "
            f"{', '.join(wanted) or '(none)'}"
        )
    return Health(
        rig=rig.name,
        sessions=tuple(known.found),
        times=when,
        time_unit=unit,
        converged=tuple(session.has_converged for session in known.found.values()),
        parameters={row.name: row for row in _by_change(result)},
        undetermined=tuple(undetermined),
        within=ahead,
    )


def _parameter(
    rig: Rig,
    name: str,
    when: Float[np.ndarray, " sessions"],
    estimates: Sequence[SessionEstimate | None],
) -> ParameterHealth | None:
    """A parameter over sessions; None if fewer than three at different times determine it."""
    entries = np.array([np.nan if estimate is None else estimate.value for estimate in estimates])
    errors = np.array([np.nan if estimate is None else estimate.error for estimate in estimates])
    there = np.isfinite(entries)
    if there.sum() < MIN_SESSIONS or np.ptp(when[there]) == 0:
        return None
    row = rig.parameters[name]
    at, seen, sure = when[there], entries[there], errors[there]
    distance, chance = np.nan, np.nan
    if there[-1] and len(at) > MIN_SESSIONS and np.ptp(at[:-1]) > 0:
        before = random_effects_trend(at[:-1], seen[:-1], sure[:-1])
        distance, chance = before.distance(float(at[-1]), float(seen[-1]), float(sure[-1]))
    return ParameterHealth(
        name=name,
        unit=row.unit,
        is_logarithmic=row.is_logarithmic,
        values=np.exp(entries) if row.is_logarithmic else entries,
        errors=errors,
        trend=random_effects_trend(at, seen, sure),
        span=(float(when[0]), float(when[-1])),
        p_value=np.nan,
        last_distance=distance,
        last_p_value=chance,
        limit=None,
    )


def _by_change(rows: Sequence[ParameterHealth]) -> list[ParameterHealth]:
    """The rows with the p-values of Holm, the clearest trend first."""
    ordered = sorted(rows, key=lambda row: row.trend.p_value)
    count = len(ordered)
    raised = [(count - place) * row.trend.p_value for place, row in enumerate(ordered)]
    corrected = np.minimum(np.maximum.accumulate(raised), 1.0)
    return [
        replace(row, p_value=float(value)) for row, value in zip(ordered, corrected, strict=True)
    ]


def _sessions(
    given: TwinStore | Mapping[str, Fit | Observed] | Sequence[Fit | Observed],
) -> _Sessions:
    dates = None
    if isinstance(given, TwinStore):
        versions = _line(given)
        several: dict[str, Fit | Observed] = {f"version {v.number}": v.fit() for v in versions}
        dates = tuple(datetime.fromisoformat(version.made) for version in versions)
    elif isinstance(given, Mapping):
        several = dict(given)
    else:
        if isinstance(given, str | bytes | Fit | Observed) or not isinstance(given, Iterable):
            raise MatchError(
                "health: sessions: expected a store of twins, or fits or observed recordings of "
                f"sessions, got {given!r}"
            )
        several = _named(list(given))
    for name, session in several.items():
        of_kind(f"health: {name}", session, (Fit, Observed), SESSION, MatchError)
    if len(several) < MIN_SESSIONS:
        raise MatchError(
            f"health: sessions: expected {MIN_SESSIONS} or more, because two always lie on a "
            "line, got "
            f"{len(several)}"
        )
    result = {name: session_of(session) for name, session in several.items()}
    rigs = dict.fromkeys(session.rig.name for session in result.values())
    if len(rigs) > 1:
        raise MatchError(f"health: sessions: expected those of one rig, got {', '.join(rigs)}")
    return _Sessions(result, dates)


def _named(several: Sequence[Fit | Observed]) -> dict[str, Fit | Observed]:
    """Sessions by the names of their recordings; a name that occurs again gets a number."""
    result: dict[str, Fit | Observed] = {}
    for number, fit in enumerate(several, start=1):
        of_kind(f"health: session {number}", fit, (Fit, Observed), SESSION, MatchError)
        names = [fit.experiment.name] if isinstance(fit, Observed) else fit.recordings
        name = ", ".join(names) or "session"
        result[f"{name} ({number})" if name in result else name] = fit
    return result


def _line(store: TwinStore) -> list[TwinVersion]:
    """The champion of a store and the versions before it, by their parents, the first one first."""
    version = store.version("champion")
    versions = [version]
    while version.parent is not None:
        version = store.version(version.parent)
        versions.append(version)
    return versions[::-1]


def _times(
    given: Sequence[Time] | None, sessions: _Sessions
) -> tuple[Float[np.ndarray, " sessions"], str]:
    """The times of sessions, and their unit."""
    count = len(sessions.found)
    if given is None and sessions.made is None:
        return np.arange(1.0, count + 1.0), "session"
    several = list(sessions.made or ()) if given is None else list(given)
    if len(several) != count:
        raise MatchError(
            f"health: times: expected one for each of {count} sessions, got {len(several)}"
        )
    stamps = [_day(number, session) for number, session in enumerate(several, start=1)]
    kinds = {isinstance(stamp, int | float) for stamp in several}
    if len(kinds) > 1:
        raise MatchError("health: times: expected all dates or all numbers, got both")
    when = np.array(stamps) - (0.0 if kinds == {True} else stamps[0])
    if np.any(np.diff(when) < 0) or when[-1] == when[0]:
        raise MatchError(
            "health: times: expected times that increase, because sessions are in the order of "
            f"time, got {', '.join(map(str, several))}"
        )
    return when, "day"


def _day(number: int, time: object) -> float:
    """A time in days."""
    if isinstance(time, str):
        try:
            time = datetime.fromisoformat(time)
        except ValueError:
            raise MatchError(
                f"health: times: session {number}: expected a date such as '2026-01-31', got "
                f"{time!r}"
            ) from None
    if isinstance(time, date) and not isinstance(time, datetime):
        time = datetime(time.year, time.month, time.day)
    if isinstance(time, datetime):
        return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp() / DAY
    return finite_number(f"health: times: session {number}", time, MatchError)


def _limits(given: Mapping[str, float | int] | None, rig: Rig) -> dict[str, float]:
    named = mapping_of("health: limits", given or {}, "parameter -> limit", MatchError)
    result = {}
    for name, limit in named.items():
        row = rig.parameters.get(name)
        above = 0.0 if row is not None and row.is_logarithmic else None
        result[name] = finite_number(f"health: limits: {name}", limit, MatchError, above=above)
    return result
