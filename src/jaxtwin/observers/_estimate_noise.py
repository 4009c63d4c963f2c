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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._arguments import finite_number
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._waiting import advanced, announced
from ..errors import ObserverError
from ..io import Experiment
from ..io._experiment import as_experiments
from ..matching import Fit, Huber
from ..matching._recordings import divided
from ..physics import Twin
from ._filter_run import FilterSamples, following, samples_of
from ._forecast_run import expected_at, starts_of
from ._gaussian import LOG_TWO_PI
from ._kalman_filter import ExtendedKalmanFilter
from ._observe import filter_for, usual_noise
from ._process_noise import SIGNED_LEVELS, SPREADS, ProcessNoise
from ._start import first_reading

# The default horizons of the forecasts, s.
HORIZONS = (60.0, 300.0)

# The number of forecasts of a recording that are judged at the shortest horizon, evenly spaced;
# those of a longer one are as many fewer as they are longer.
FORECASTS = 128

# A forecast that is wrong by more than so many standard deviations counts less: a supply that is
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

    several, _ = divided(as_experiments("estimate_noise: experiments", experiments, ObserverError))
    leads = _times(horizons)
    if start is None:
        start = usual_noise(fit, several, names)
    recordings = [_Stretches.of(fit, experiment, start, leads) for experiment in several]
    estimated = _estimated(recordings[0].kalman, start)
    levels = start.levels()
    is_signed = np.isin(estimated, SIGNED_LEVELS)
    started = np.array([levels[name] for name in estimated])
    centre = np.where(is_signed, started, np.log(np.where(is_signed, 1.0, started)))
    spread = np.array([SPREADS[name] for name in estimated])
    count = 0

    def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal count
        value, slope = 0.5 * float(point @ point), point.copy()
        for recording in recordings:
            with own_settings():
                of, gradient = _scored(
                    recording.kalman,
                    recording.samples,
                    recording.first,
                    recording.leads,
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

    first = [descend(start, FIRST_ITERATIONS) for start in _starts(estimated)]
    optimum = descend(min(first, key=lambda one: one.fun).x, ITERATIONS)
    with own_settings():
        values = np.asarray(_levels_at(centre + spread * optimum.x, is_signed))
    errors = spread * _standard_errors(lambda point: objective(point)[1], optimum.x, optimum.jac)
    found_levels = dict(zip(estimated, values.tolist(), strict=True))
    standard_errors = dict(zip(estimated, errors.tolist(), strict=True))
    return dataclasses.replace(
        start, **_predictive(found_levels, standard_errors), standard_errors=standard_errors
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
    """The forecasts of a recording with a horizon: the numbers of the samples that are expected,
    the number of steps of each, and how much all of them count."""

    ends: Int[np.ndarray | Array, " forecasts"]
    counts: Int[np.ndarray | Array, " forecasts"]
    weight: Float[np.ndarray | Array, ""]


@dataclasses.dataclass(frozen=True)
class _Stretches:
    """What the objective needs of a recording."""

    kalman: ExtendedKalmanFilter
    samples: FilterSamples
    first: Float[Array | np.ndarray, ""]
    leads: tuple[_Lead, ...]

    @classmethod
    def of(
        cls, fit: Twin | Fit, experiment: Experiment, noise: ProcessNoise, horizons: Sequence[float]
    ) -> "_Stretches":
        """Prepares a recording."""
        kalman = filter_for(fit, experiment, noise)
        samples, is_sample = samples_of(kalman, experiment)
        leads = []
        for horizon in horizons:
            ends, counts = starts_of(samples, is_sample, horizon)
            if len(ends):
                number = round(FORECASTS * horizons[0] / horizon)
                chosen = np.linspace(0, len(ends) - 1, number).astype(int)
                weight = np.asarray(experiment.duration / horizon)
                leads.append(_Lead(ends[chosen], counts[chosen], weight))
        if not leads:
            raise ObserverError(
                f"{experiment.name or 'experiment'}: expected a recording longer than the horizon "
                f"of {horizons[0]:g} s, got {experiment.duration:g} s"
            )
        first = np.asarray(first_reading(experiment))
        return cls(kalman, samples, first, tuple(leads))


def _estimated(kalman: ExtendedKalmanFilter, noise: ProcessNoise) -> tuple[str, ...]:
    """The names of the levels that have an effect."""
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
    kalman: ExtendedKalmanFilter,
    samples: FilterSamples,
    first: Float[Array | np.ndarray, ""],
    leads: tuple[_Lead, ...],
    names: tuple[str, ...],
    longest: tuple[int, ...],
    point: Float[Array | np.ndarray, " levels"],
) -> tuple[Float[Array, ""], Float[Array, " levels"]]:
    """The weighted log density of the readings of a recording, one sample and horizons ahead, and
    its derivative with respect to the logarithms of the levels, or themselves (`SIGNED_LEVELS`)."""

    def of(point: Array) -> Array:
        levels: Any = dict(
            zip(names, _levels_at(point, np.isin(names, SIGNED_LEVELS)), strict=True)
        )
        noise = dataclasses.replace(kalman.model.noise, **levels)
        changed = eqx.tree_at(lambda k: k.model.noise, kalman, noise)
        start = changed.init(first, jnp.zeros(samples.duty.shape[1]))
        result, taken = following(changed, start, samples)
        there = jnp.isfinite(samples.readings)
        score = jnp.asarray(leads[0].weight) * result.states.log_likelihood.sum() / there.sum()
        steps = jax.tree.map(lambda leaf: leaf[1:], taken)
        for (ends, counts, weight), most in zip(leads, longest, strict=True):
            expected = expected_at(changed, result.states, samples, steps, ends, counts, most)
            deviation = (samples.readings[ends] - expected.mean) / expected.spread
            cost = jax.vmap(jax.vmap(Huber(HUBER_SIGMAS).cost))(deviation)
            density = -cost - 0.5 * LOG_TWO_PI - jnp.log(expected.spread)
            is_there = there[ends]
            mean = jnp.where(is_there, density, 0.0).sum() / is_there.sum()
            score = score + jnp.asarray(weight) * mean
        return score

    return jax.value_and_grad(of)(jnp.asarray(point))


def _levels_at(
    point: Float[Array | np.ndarray, " levels"], is_signed: Bool[np.ndarray, " levels"]
) -> Float[Array, " levels"]:
    """The levels whose logarithms, or which themselves if they may be below 0, are given."""
    values = jnp.asarray(point)
    return jnp.where(is_signed, values, jnp.exp(jnp.where(is_signed, 0.0, values)))
