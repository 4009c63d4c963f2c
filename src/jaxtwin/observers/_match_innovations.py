r"""Matches a twin by what an observer expected of each reading: the prediction-error method.

An output-error match compares readings with a run that never sees them, so that whatever drives the
rig beside the twin becomes an error of its values. Here the values $u$ maximise

$$\sum_r \sum_k \log p(y_k \mid y_1 \dots y_{k-1}; u) + \log p(u),$$

the likelihood of the innovations of the filter (Ljung, *System Identification*, 1999, section 7.4;
ctsm does the same), with the priors, scopes and bounds of the match, and exact derivatives through
filter, steps and network. The curvature at the maximum is the information of the recordings.

Temperatures at the start and the room are states of the filter, so that their parameters keep the
values of the match. The distribution at the start is the same for all values.
"""

import dataclasses
import time
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arguments import of_kind, whole_number
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._progress import advanced, announced
from ..errors import ObserverError
from ..matching import Fit
from ..matching._descent import descend
from ..matching._descent_result import MatchEstimate, make_optimum
from ..matching._fit import solution_of
from ..matching._fitted_parameters import fitted_parameters
from ..matching._match import default_solver, make_fit
from ..matching._noise_model import update_noise_model
from ..matching._objective import make_objective
from ..matching._problem import MatchProblem
from ..matching._uncertainty import Uncertainty, VectorEntries, uncertainty
from ..matching._unknowns import VectorLayout
from ..physics import Twin
from ..simulation import Stepper
from ._augmented_model import AugmentedModel
from ._filter_run import FilterSamples, following, samples_of
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._observe import filter_for
from ._process_noise import ProcessNoise
from ._start import first_reading
from ._uncertain_values import start_parameters

# The step in which the curvature is found, in standard errors of the match.
CURVATURE_STEP = 0.1


class _InnovationRecording(NamedTuple):
    """What the likelihood needs of a recording, with the entries that it depends on."""

    kalman: ExtendedKalmanFilter
    samples: FilterSamples
    first: Float[np.ndarray, ""]
    entries: np.ndarray


@announced("match of innovations")
def match_innovations(fit: Fit, noise: ProcessNoise, *, max_iterations: int = 50) -> Fit:
    """Matches a twin again, by the likelihood of an observer's innovations.

    The start is a match, because the noise is found with one. `status` of the result says whether
    anything was gained: how much likelier the readings are, one sample ahead, than with the values
    of the match. Where that is no more than chance, take the match.

    **Arguments:**

    - `fit`: the match, with its recordings.
    - `noise`: the noise of rig and readings, from `jaxtwin.estimate_noise`. Parameters that drift
      (`names`) are taken as constant.
    - `max_iterations`: the limit of iterations.

    **Returns:** a `Fit` with the same recordings, priors, scopes and bounds.

    **Raises:** `ObserverError` if a level of the noise is not positive, or the likelihood is not
    finite at the values of the match.
    """
    from scipy.optimize import minimize

    began = time.perf_counter()
    of_kind("match_innovations: fit", fit, Fit, "a Fit", ObserverError)
    whole_number("match_innovations: max_iterations", max_iterations, 1, ObserverError)
    solution = solution_of(fit)
    problem, start = solution.problem, np.asarray(solution.vector, float)
    score = _Score(problem, fit, dataclasses.replace(noise, names=()))
    unknowns = problem.unknowns
    errors = np.sqrt(np.diag(fit.uncertainty.vector_covariance))
    scale = np.where(np.isfinite(errors) & (errors > 0), errors, unknowns.scales())
    held = score.is_held
    before, _ = score(start)
    if not np.isfinite(before):
        raise ObserverError(
            "match_innovations: expected noise and values with which the twin follows the "
            "recordings, got a likelihood that is not finite; estimate_noise finds the noise"
        )
    lower, upper = (np.asarray(b, float) for b in (unknowns.lower(), unknowns.upper()))

    def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = score(np.clip(start + scale * point, lower, upper))
        prior, of_prior = _prior(problem, start + scale * point)
        advanced(score.count)
        optimum = value + prior
        slopes = scale * (slope + of_prior)
        return (optimum, slopes) if np.isfinite(optimum) else (1e12, np.zeros_like(point))

    least, most = (np.where(held, 0.0, (b - start) / scale) for b in (lower, upper))
    optimum = minimize(
        objective,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(least, most, strict=True)),
        options={"maxiter": max_iterations, "ftol": 1e-9},
    )
    vector = np.clip(start + scale * optimum.x, lower, upper)
    after, slope = score(vector)
    gain, count = before - after, int(np.sum(~held))
    uncertain = _uncertainty(problem, score, vector, scale, slope, fit.uncertainty)
    result = _at(problem, fit, vector, began)
    return dataclasses.replace(
        result,
        parameters=fitted_parameters(problem, vector, uncertain),
        uncertainty=uncertain,
        status=_status(gain, count, score.readings, int(optimum.nit)),
        converged=bool(optimum.success),
    )


def _status(gain: float, values: int, readings: int, iterations: int) -> str:
    """What was gained, in a sentence. Twice the logarithm of the likelihood's maximum over the
    values is above that of the true ones by a number whose distribution is chi square (S. S. Wilks,
    Ann. Math. Statist. 9 (1938) 60-62)."""
    from scipy.stats import chi2

    of_all = f"of {readings} readings rises by {gain:.1f}"
    by_chance = float(chi2.ppf(0.95, max(values, 1))) / 2
    if gain > by_chance:
        verdict = f"more than the {by_chance:.1f} of chance"
    else:
        verdict = f"nothing is gained: {by_chance:.1f} may be chance"
    return (
        f"match of innovations, {iterations} iterations: the log-likelihood {of_all} from the "
        f"values of the match, {verdict}"
    )


class _Score:
    """The negative logarithm of the likelihood of all innovations, and its derivative."""

    def __init__(self, problem: MatchProblem, fit: Fit, noise: ProcessNoise):
        self._problem = problem
        self._layout: VectorLayout = problem.unknowns.layout
        self.count = 0
        """The number of evaluations."""
        starts = start_parameters(fit.twin.rig)
        entries = problem.unknowns.entry_parameters
        self.is_held = np.array([row.name in starts for row in entries])
        """Whether a value is that of the match, because the filter has a state for it."""
        places = self._layout.entry_indices()
        self._recordings: list[_InnovationRecording] = []
        for number, experiment in enumerate(problem.experiments):
            kalman = filter_for(fit.twin_for(experiment), experiment, noise)
            samples, is_sample = samples_of(kalman, experiment)
            readings = np.array(samples.readings)
            weights = np.asarray(problem.sample_weights[number])
            readings[is_sample] = np.where(weights > 0, readings[is_sample], np.nan)
            first = np.asarray(first_reading(experiment))
            recording = _InnovationRecording(
                kalman, samples._replace(readings=readings), first, places[number]
            )
            self._recordings.append(recording)
        self.readings = sum(
            int(np.isfinite(recording.samples.readings).sum()) for recording in self._recordings
        )

    def __call__(
        self, vector: Float[np.ndarray, " unknowns"]
    ) -> tuple[float, Float[np.ndarray, " unknowns"]]:
        value, slope = 0.0, np.zeros(len(vector))
        for recording in self._recordings:
            with own_settings():
                of, gradient = _scored(
                    self._problem.twin,
                    self._layout,
                    recording.kalman,
                    recording.samples,
                    recording.first,
                    tuple(np.asarray(recording.kalman.model.columns).tolist()),
                    recording.kalman.longest_seconds,
                    float(recording.kalman.model.room_spread),
                    vector[recording.entries],
                )
            value -= float(of)
            np.subtract.at(slope, recording.entries, np.asarray(gradient))
        self.count += 1
        return value, np.where(self.is_held, 0.0, slope)


@persistent_jit
def _scored(
    twin: Twin,
    layout: VectorLayout,
    kalman: ExtendedKalmanFilter,
    samples: FilterSamples,
    first: Float[Array | np.ndarray, ""],
    columns: tuple[int, ...],
    step: float,
    room_spread: float,
    local: Float[Array | np.ndarray, " entries"],
) -> tuple[Float[Array, ""], Float[Array, " entries"]]:
    """The log-likelihood of a recording's innovations, and its derivative."""

    def of(local: Array) -> Array:
        of_recording = twin.with_values(layout.local_values(local))
        # The filter keeps the commands in the driver's delay itself: the stepper's own queue, which
        # is never filled, may be short.
        stepper, noise = Stepper(of_recording, step, longest_delay=step), kalman.model.noise
        model = AugmentedModel(of_recording, None, noise, columns, stepper, room_spread)
        changed = eqx.tree_at(lambda k: k.model, kalman, model)
        start = kalman.init(first, jnp.zeros(samples.duty.shape[1]))
        start = _carried(start, kalman.model, model)
        return following(changed, start, samples)[0].states.log_likelihood.sum()

    return jax.value_and_grad(of)(jnp.asarray(local))


def _carried(start: KalmanState, before: AugmentedModel, model: AugmentedModel) -> KalmanState:
    """The start of a filter in the modes of another twin: the same temperatures, with the same
    covariance."""
    modes, block = model.stepper.field.modes, model.layout.of("modes")
    # Temperatures have fixed amplitudes in modes that are held where the derivative is taken.
    amplitudes = jax.lax.stop_gradient(modes).amplitudes
    into = jax.vmap(amplitudes, in_axes=1, out_axes=1)(before.shapes)
    whole = jnp.eye(model.layout.size, dtype=into.dtype).at[block, block].set(into)
    moved = before.stepper.reference - model.stepper.reference
    everywhere = amplitudes(jnp.full(into.shape[0], moved))
    mean = (whole @ start.mean).at[block].add(everywhere).at[model.layout.of("room")].add(moved)
    return dataclasses.replace(start, mean=mean, covariance=whole @ start.covariance @ whole.T)


def _prior(
    problem: MatchProblem, vector: Float[np.ndarray, " unknowns"]
) -> tuple[float, Float[np.ndarray, " unknowns"]]:
    """The negative logarithm of the priors, but for a constant, and its derivative."""
    away = (vector - problem.unknowns.prior_means()) * problem.prior_weights
    linear = problem.linear_prior
    together = linear.matrix @ vector - linear.values
    slope = away * problem.prior_weights + linear.matrix.T @ together
    return 0.5 * float(away @ away + together @ together), slope


def _uncertainty(
    problem: MatchProblem,
    score: _Score,
    vector: Float[np.ndarray, " unknowns"],
    scale: Float[np.ndarray, " unknowns"],
    slope: Float[np.ndarray, " unknowns"],
    of_match: Uncertainty,
) -> Uncertainty:
    """The uncertainty by the curvature of the likelihood."""
    unknowns = problem.unknowns
    rows = []
    # Away from the nearer bound.
    middle = (unknowns.lower() + unknowns.upper()) / 2
    inward = np.where(np.isfinite(middle) & (vector > middle), -1.0, 1.0)
    for row, is_held in zip(np.diag(CURVATURE_STEP * scale * inward), score.is_held, strict=True):
        moved = slope if is_held else score(vector + row)[1]
        rows.append((moved - slope) / row.sum())
    hessian = np.stack(rows)
    if not np.isfinite(hessian).all():
        raise ObserverError(
            "match_innovations: the likelihood beside its maximum is not finite; expected values "
            "further from where the twin has no meaning"
        )
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2 * np.outer(scale, scale))
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T / np.outer(scale, scale)
    # What the match says of the values that are held.
    of_held = 1 / np.diag(of_match.vector_covariance) - np.diag(problem.prior_precision)
    information += np.diag(np.where(score.is_held, np.nan_to_num(np.maximum(of_held, 0.0)), 0.0))
    inside = unknowns.are_inside(vector)
    entries = VectorEntries(
        problem.labels,
        problem.prior_precision,
        unknowns.scales(),
        unknowns.value_derivatives(vector),
        inside,
    )
    own = information[np.ix_(inside, inside)]
    result = uncertainty(entries, own, own)
    return dataclasses.replace(result, between_recordings=of_match.between_recordings)


def _at(
    problem: MatchProblem, fit: Fit, vector: Float[np.ndarray, " unknowns"], began: float
) -> Fit:
    """The fit with given unknowns: its runs, errors and noise."""
    noise_model = solution_of(fit).noise_model
    space = problem.unknowns.search_space()
    objective = make_objective(problem, noise_model)
    (result,) = descend([problem], [objective], default_solver(problem), [vector], space, 0)
    if noise_model.channel_curvature is None:  # the fit comes from a file
        noise_model = update_noise_model(problem, noise_model, result.recording_errors())
    optimum = make_optimum(problem, result, 0, result)
    return make_fit(problem, MatchEstimate(result, noise_model), 0, (optimum,), began)
