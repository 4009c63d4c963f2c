r"""Finds the noise of a rig from recordings, by how well readings were expected.

The logarithms of the levels $\ell$ (of a mean: itself) maximise

$$\sum_r \Big( \frac{T_r}{h_1} \big\langle \log p(y_k \mid y_1 \dots y_{k-1}; \ell) \big\rangle
+ \sum_h \frac{T_r}{h} \big\langle \log p(y_k \mid y_1 \dots y_{k-m}; \ell) \big\rangle \Big)
- \tfrac12 \sum_i \Big(\frac{\log \ell_i - \log \ell_{0,i}}{s_i}\Big)^2 .$$

the means over all readings. The first density is that of the innovations, the others those of
readings which are expected a horizon $h$ before, of $m$ samples, with Huber's loss. Each counts as
often as the recording of length $T_r$ has independent horizons, that of the innovations as often as
it has the shortest ones: what makes the readings of the channels differ from what was expected is
mostly common to them. The likelihood of innovations alone would be larger by the number of samples
in a horizon: it finds the noise from one sample to the next, and a filter whose innovations are
white can still forecast badly, since no twin is exact.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._arguments import finite_number
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._lapack import one_blas_thread
from .._progress import advanced, announced
from ..errors import ObserverError
from ..io import Experiment, as_experiments
from ..matching import Fit, Huber
from ..matching._nominal_twin import nominal_twin
from ..matching._recordings import divided
from ..physics import Twin
from ._filter_run import FilterSamples, filtered, samples_of
from ._forecast import starts_of
from ._gaussian import LOG_TWO_PI
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._linear_filter import LinearisedPath, filter_path, forecasts_of_path, linearised_path
from ._observe import filter_for, started, usual_noise
from ._process_noise import SIGNED_LEVELS, SPREADS, ProcessNoise
from ._start import first_reading

# The default horizons of the forecasts, s.
HORIZONS = (60.0, 300.0)

# The number of forecasts that are judged for each time of a horizon in a recording: those that
# overlap by more tell little more. Rounded up to a power of 2, so that recordings share compiled
# programs.
FORECASTS_PER_HORIZON = 3

# The largest number of forecasts with the shortest horizon; of those with a longer one as many
# fewer as they are longer.
MAX_FORECASTS = 128

# The number of samples that are filtered for each trial of levels, times the square of the number
# of states. Of a longer recording, stretches count that are evenly spread: the levels of a rig's
# noise are the same all day.
MAX_WORK = 3.6e6

# A step of fewer states takes no less time.
MIN_STATES = 30

# The largest number of stretches: each needs time until it shows the levels that are tried.
MAX_STRETCHES = 4

# Lengths of stretches are multiples of this, so that recordings share compiled programs.
LENGTH_MULTIPLE = 128

# The number of standard deviations beyond which a wrong forecast counts less: a supply that is
# switched on late must not decide what the noise is.
HUBER_SIGMAS = 2.5

ITERATIONS = 20

# The number of iterations from each start; the best goes on. There are several maxima: what the
# twin does not explain can be taken as heat in the rig or as an error of the readings.
FIRST_ITERATIONS = 5

OF_RIG = ("heat", "command_time", "disturbance")
OF_READINGS = ("common", "channel")

# The step in which the curvature at the estimate is found, in standard deviations of the prior.
CURVATURE_STEP = 0.1


@announced("estimation of the noise")
@one_blas_thread()
def estimate_noise(
    fit: Twin | Fit,
    experiments: Experiment | Sequence[Experiment],
    *,
    names: Sequence[str] = (),
    horizons: Sequence[float] | float = HORIZONS,
    start: ProcessNoise | None = None,
) -> ProcessNoise:
    """Finds the levels of the noise from recordings.

    Each level has a log-normal prior about its start, so that a level which the recordings do not
    show stays there. The search begins at three places, because there are several maxima.

    **Arguments:**

    - `fit`: the fit, or a twin whose values are taken as exact.
    - `experiments`: recordings of the rig, such as those that were matched.
    - `names`: parameters above 0 that drift slowly beside the equations of the twin, such as an
      electrical resistance.
    - `horizons`: the times ahead at which forecasts are judged, s. A recording that is not longer
      than one of them does not count for it.
    - `start`: where to begin; None: levels from the rig file and the time between samples.

    **Returns:** the noise, for `jaxtwin.observe`, with the standard errors of its levels.

    **Raises:** `ObserverError` if a recording has no readings or is not longer than the shortest
    horizon, or for unknown names; `SimulationError` for a recording of another rig.
    """
    from scipy.optimize import minimize

    rig = nominal_twin("estimate_noise: fit", fit, ObserverError).rig
    several, _ = divided(
        as_experiments("estimate_noise: experiments", experiments, ObserverError, rig)
    )
    leads = _times(horizons)
    if start is None:
        start = usual_noise(fit, several, names)
    recordings = [_Stretches.of(fit, experiment, start, leads) for experiment in several]
    # A level has an effect if it has one on any of the recordings, whose channels may differ.
    effective = {name for recording in recordings for name in _estimated(recording.kalman)}
    estimated = tuple(name for name in SPREADS if name in effective)
    levels = start.levels()
    is_signed = np.isin(estimated, SIGNED_LEVELS)
    started = np.array([levels[name] for name in estimated])
    centre = np.where(is_signed, started, np.log(np.where(is_signed, 1.0, started)))
    spread = np.array([SPREADS[name] for name in estimated])
    count = 0

    def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal count
        value, slope = 0.5 * float(point @ point), point.copy()
        for recording in linearised:
            with own_settings():
                of, gradient = _scored(
                    recording,
                    estimated,
                    tuple(int(lead.counts.max()) for lead in recording.leads),
                    centre + spread * point,
                )
            value -= float(of)
            slope -= spread * np.asarray(gradient)
        count += 1
        advanced(count)
        return (value, slope) if np.isfinite(value) else (1e12, np.zeros_like(slope))

    def descend(start: np.ndarray, iterations: int) -> Any:
        return minimize(
            objective,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(-4.0, 4.0)] * len(start),
            options={"maxiter": iterations, "ftol": 1e-4},
        )

    def levels_at(point: np.ndarray) -> dict[str, float]:
        with own_settings():
            values = np.asarray(_levels_at(centre + spread * point, is_signed))
        return dict(zip(estimated, values.tolist(), strict=True))

    def linearised_with(noise: ProcessNoise) -> list[_LinearisedStretches]:
        with own_settings():
            return [recording.linearised(noise) for recording in recordings]

    linearised = linearised_with(start)
    first = [descend(point, FIRST_ITERATIONS) for point in _starts(estimated)]
    best = min(first, key=lambda descent: descent.fun).x
    # The states of the run depend on the levels, where the twin is far from its rig.
    linearised = linearised_with(dataclasses.replace(start, **levels_at(best)))
    optimum = descend(best, ITERATIONS)
    errors = spread * _standard_errors(lambda point: objective(point)[1], optimum.x, optimum.jac)
    standard_errors = dict(zip(estimated, errors.tolist(), strict=True))
    return dataclasses.replace(
        start, **_predictive(levels_at(optimum.x), standard_errors), standard_errors=standard_errors
    )


def _predictive(levels: dict[str, float], errors: dict[str, float]) -> dict[str, float]:
    """The levels for readings to come: the next jump of a camera differs from the estimated mean by
    the error of that mean too."""
    if "jump_mean" not in levels:
        return levels
    return levels | {"jump": float(np.hypot(levels["jump"], errors["jump_mean"]))}


def _times(horizons: Sequence[float] | float) -> list[float]:
    """The horizons, ascending."""
    where = "estimate_noise: horizons"
    several = horizons if isinstance(horizons, Iterable) else [horizons]
    times = sorted(finite_number(where, horizon, ObserverError) for horizon in several)
    if not times or times[0] <= 0:
        raise ObserverError(f"{where}: expected one time above 0 s or more, got {horizons!r}")
    return times


def _starts(names: Sequence[str]) -> list[Float[np.ndarray, " levels"]]:
    """Where the search begins, in standard deviations of the prior: at the start, where heat in the
    rig explains more and errors of the readings less, and the other way round."""
    rig, readings = (
        np.array([name in part for name in names], float) for part in (OF_RIG, OF_READINGS)
    )
    return [np.zeros(len(names)), rig - readings, readings - rig]


def _standard_errors(
    slope: Callable[[np.ndarray], np.ndarray],
    at: Float[np.ndarray, " levels"],
    here: Float[np.ndarray, " levels"],
) -> Float[np.ndarray, " levels"]:
    """The standard errors of a maximum of a posterior, by the curvature there (Laplace). The prior
    has the curvature 1. `here` is the slope there."""
    unit = np.eye(len(at))
    hessian = np.stack([(slope(at + CURVATURE_STEP * row) - here) / CURVATURE_STEP for row in unit])
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
    return np.sqrt(np.sum(vectors**2 / np.maximum(values, 1.0), axis=1))


class _Lead(NamedTuple):
    """The forecasts of a recording with a horizon: the rows of the samples that are expected, the
    number of steps of each, and how much all of them count."""

    ends: Int[np.ndarray | Array, " forecasts"]
    counts: Int[np.ndarray | Array, " forecasts"]
    weight: Float[np.ndarray | Array, ""]


@dataclasses.dataclass(frozen=True)
class _Stretches:
    """A recording of which stretches of equal length count.

    - `rows`: the numbers of the samples of each stretch; those beyond the last are padding.
    - `counts`: whether the innovations of a sample count, which they do not where a stretch begins
      within the recording and still shows the levels that the filter had before it.
    """

    kalman: ExtendedKalmanFilter
    samples: FilterSamples
    first: Float[np.ndarray, ""]
    rows: Int[np.ndarray, "stretches samples"]
    counts: Bool[np.ndarray, "stretches samples"]
    leads: tuple[_Lead, ...]

    @classmethod
    def of(
        cls, fit: Twin | Fit, experiment: Experiment, noise: ProcessNoise, horizons: Sequence[float]
    ) -> "_Stretches":
        """Chooses the stretches and the forecasts."""
        kalman = filter_for(fit, experiment, noise)
        samples, is_sample = samples_of(kalman, experiment)
        time = np.cumsum(samples.dt)
        forecasts = [(horizon, *starts_of(samples, is_sample, horizon)) for horizon in horizons]
        forecasts = [of_horizon for of_horizon in forecasts if len(of_horizon[1])]
        if not forecasts:
            raise ObserverError(
                f"{experiment.name or 'experiment'}: expected a recording longer than the horizon "
                f"of {horizons[0]:g} s, got {experiment.duration:g} s"
            )
        longest = max(int(steps.max()) for _, _, steps in forecasts)
        size = max(kalman.model.layout.size, MIN_STATES)
        rows = _stretches(len(time), round(MAX_WORK / size**2), longest)
        last = len(time) - 1
        is_settled = time[np.minimum(rows, last)] - time[rows[:, :1]] >= horizons[0]
        counts = (rows <= last) & (is_settled | (rows[:, :1] == 0))
        place = np.full(len(time), -1)
        place[rows[rows <= last]] = np.flatnonzero(rows.ravel() <= last)
        seconds = float(samples.dt[rows[counts]].sum())
        leads = []
        for horizon, ends, steps in forecasts:
            begin = ends - steps
            # Within one stretch, and from a state of which the innovations count.
            usable = (place[begin] >= 0) & (place[ends] - place[begin] == steps)
            usable &= counts.ravel()[place[begin]]
            number = _forecasts(seconds, horizon, horizons[0])
            if usable.any():
                at = np.linspace(0, usable.sum() - 1, number).astype(int)
                weight = np.asarray(experiment.duration / horizon)
                leads.append(_Lead(place[ends[usable]][at], steps[usable][at], weight))
        first = np.asarray(first_reading(experiment))
        return cls(kalman, samples, first, rows, counts, tuple(leads))

    def linearised(self, noise: ProcessNoise) -> "_LinearisedStretches":
        """Linearises the stretches along the states that a filter with this noise has."""
        kalman = eqx.tree_at(lambda k: k.model.noise, self.kalman, noise.as_arrays())
        start = started(kalman, self.first, np.zeros_like(self.samples.duty[0]))
        states = filtered(kalman, start, self.samples).states
        is_padding = self.rows > len(self.samples.dt) - 1
        kept = np.where(is_padding, len(self.samples.dt) - 1, self.rows)
        before = jax.tree.map(
            lambda initial, later: np.concatenate([np.asarray(initial)[None], later])[kept.ravel()],
            start,
            states,
        )
        chosen = jax.tree.map(lambda leaf: np.asarray(leaf)[kept.ravel()], self.samples)
        of_padding = is_padding.ravel()
        chosen = chosen._replace(
            dt=np.where(of_padding, 0.0, chosen.dt),
            readings=np.where(of_padding[:, None], np.nan, chosen.readings),
            ambient=np.where(of_padding, np.nan, chosen.ambient),
        )
        path, befores = jax.tree.map(
            lambda leaf: np.asarray(leaf).reshape(*kept.shape, *leaf.shape[1:]),
            (linearised_path(kalman, before, chosen), before),
        )
        starts = jax.tree.map(lambda leaf: leaf[:, 0], befores)
        return _LinearisedStretches(kalman, path, starts, self.counts, self.leads)


class _LinearisedStretches(NamedTuple):
    """The stretches of a recording, linearised.

    - `path`: the first axes of each leaf are the stretches and their samples.
    - `starts`: the filter's states before the stretches.
    - `counts`, `leads`: those of the recording.
    """

    kalman: ExtendedKalmanFilter
    path: LinearisedPath
    starts: KalmanState
    counts: Bool[Array | np.ndarray, "stretches samples"]
    leads: tuple[_Lead, ...]


def _forecasts(seconds: float, horizon: float, shortest: float) -> int:
    """The number of forecasts with a horizon that are judged in stretches of this length."""
    wanted = np.ceil(np.log2(max(FORECASTS_PER_HORIZON * seconds / horizon, 1.0)))
    return int(min(2.0**wanted, np.ceil(MAX_FORECASTS * shortest / horizon)))


def _stretches(samples: int, most: int, longest: int) -> Int[np.ndarray, "stretches samples"]:
    """The numbers of the samples of stretches that are evenly spread over a recording, in a shape
    that most recordings share; numbers beyond the end of the recording are padding.

    **Arguments:**

    - `samples`: the number of samples of the recording. `most`: the number of all stretches.
    - `longest`: the number of steps of the longest forecast.
    """
    # A forecast needs what is before it, and a stretch some room for more than one.
    length = max(most // MAX_STRETCHES, 2 * longest) if samples > most else samples
    length = -(-length // LENGTH_MULTIPLE) * LENGTH_MULTIPLE
    number = max(1, min(most, samples) // length)
    first = np.linspace(0, max(samples - length, 0), number).astype(int)
    return first[:, None] + np.arange(length)


def _estimated(kalman: ExtendedKalmanFilter) -> tuple[str, ...]:
    """The names of the levels that have an effect on a filter."""
    model = kalman.model
    parts = {
        "channel": model.layout.channels,
        "jump": model.interval,
        "jump_mean": model.interval,
        "twin": model.directions is not None and model.directions.count - model.directions.slow,
    }
    return tuple(name for name in SPREADS if parts.get(name.removesuffix("_time"), True))


@persistent_jit
def _scored(
    recording: _LinearisedStretches,
    names: tuple[str, ...],
    longest: tuple[int, ...],
    point: Float[Array | np.ndarray, " levels"],
) -> tuple[Float[Array, ""], Float[Array, " levels"]]:
    """The weighted log density of the readings of a recording, one sample and horizons ahead, and
    its derivative with respect to the logarithms of the levels, or themselves (`SIGNED_LEVELS`)."""
    kalman, path, starts, counted, leads = recording
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), path)
    readings = kalman.model.from_degC(flat.readings)
    there = jnp.isfinite(readings)

    def of(point: Array) -> Array:
        levels: Any = dict(
            zip(names, _levels_at(point, np.isin(names, SIGNED_LEVELS)), strict=True)
        )
        noise = dataclasses.replace(kalman.model.noise, **levels)
        changed = eqx.tree_at(lambda k: k.model.noise, kalman, noise)
        begun = _started_with(changed, kalman, starts)
        run = jax.vmap(partial(filter_path, changed))(path, begun)
        is_counted = jnp.asarray(counted)[..., None] & jnp.isfinite(path.readings)
        density = jnp.where(counted, run.states.log_likelihood, 0.0).sum() / is_counted.sum()
        score = jnp.asarray(leads[0].weight) * density
        run = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), run)
        for (ends, counts, weight), most in zip(leads, longest, strict=True):
            expected = forecasts_of_path(changed, flat, run, ends, counts, most)
            deviation = (readings[ends] - expected.mean) / expected.spread
            cost = jax.vmap(jax.vmap(Huber(HUBER_SIGMAS).cost))(deviation)
            density = -cost - 0.5 * LOG_TWO_PI - jnp.log(expected.spread)
            is_there = there[ends]
            mean = jnp.where(is_there, density, 0.0).sum() / is_there.sum()
            score = score + jnp.asarray(weight) * mean
        return score

    return jax.value_and_grad(of)(jnp.asarray(point))


def _started_with(
    changed: ExtendedKalmanFilter, kalman: ExtendedKalmanFilter, starts: KalmanState
) -> KalmanState:
    """The states before the stretches, of which the first is the start of the recording: there the
    changed levels are all that is known of the errors."""
    after, before = changed.model.start_spreads() ** 2, kalman.model.start_spreads() ** 2
    covariance = jnp.asarray(starts.covariance).at[0].add(jnp.diag(after - before))
    return eqx.tree_at(lambda state: state.covariance, starts, covariance)


def _levels_at(
    point: Float[Array | np.ndarray, " levels"], is_signed: Bool[np.ndarray, " levels"]
) -> Float[Array, " levels"]:
    """The levels whose logarithms, or which themselves if they may be below 0, are given."""
    values = jnp.asarray(point)
    return jnp.where(is_signed, values, jnp.exp(jnp.where(is_signed, 0.0, values)))
