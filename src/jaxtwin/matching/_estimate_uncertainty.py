"""Estimates the uncertainty of a match at the end of its descent."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from ._autocovariance import Mixture, Series, fit_noise, noise_in_unknowns
from ._between_recordings import RecordingScore, estimate_heterogeneity
from ._loss import influence_variance
from ._noise import Noise
from ._noise_model import beside_others
from ._problem import MatchProblem
from ._reweighted_least_squares import Estimate
from ._uncertainty import Uncertainty, VectorEntries, inverse_of_normal, uncertainty
from ._unknowns import Unknowns


def estimate_uncertainty(
    problem: MatchProblem, estimate: Estimate
) -> tuple[Uncertainty, tuple[Noise, Noise]]:
    """Estimates the uncertainty of the matched values, and the noise of the channels and of the
    common mode (times the root of the number of channels).

    The amplitudes of the camera's shapes, which the optimiser does not see, are unknowns here: the
    noise can be estimated only if the part of the residuals that they absorb is known.
    """
    unknowns, (result, noise_model) = problem.unknowns, estimate
    vector, precision = result.vector, problem.prior_precision
    inside = (vector > unknowns.lower() + 1e-9) & (vector < unknowns.upper() - 1e-9)
    all_series, lift = _series(problem, estimate, inside)
    count, values = lift.shape
    camera = np.diag((np.arange(count) >= values).astype(float))
    normal = camera.copy()
    for series in all_series:
        at = np.ix_(series.entries, series.entries)
        normal[at] += np.tensordot(series.curved_slopes, series.slopes, ([0, 1], [0, 1]))
    prior = np.zeros((count, count))
    prior[:values, :values] = precision[np.ix_(inside, inside)]
    mixtures, meat = fit_noise(all_series, inverse_of_normal(normal + prior)[0], camera + prior)
    limited = influence_variance(problem.loss) ** 0.5
    scales = (
        noise_model.channel.effective / limited,
        noise_model.common_mode.effective / limited,
    )
    noise = [mixture.noise(scale) for mixture, scale in zip(mixtures, scales, strict=True)]
    if all(series.kind == 1 for series in all_series):
        # A recording of one channel has only a common mode.
        noise[0] = noise[1]
    slopes = unknowns.value_derivatives(vector)
    entries = VectorEntries(problem.labels, precision, unknowns.scales(), slopes, inside)
    found = uncertainty(entries, lift.T @ normal @ lift, lift.T @ (meat + camera) @ lift)
    pull = np.zeros(count)
    linear = problem.linear_prior
    away = (vector - unknowns.prior_means()) * problem.prior_weights**2
    away += linear.matrix.T @ (linear.matrix @ vector - linear.values)
    pull[:values] = away[inside]
    between = _between_recordings(all_series, mixtures, camera + prior, pull, unknowns, inside)
    return replace(found, between_recordings=between), (noise[0], noise[1])


def _series(
    problem: MatchProblem, estimate: Estimate, inside: Bool[np.ndarray, " unknowns"]
) -> tuple[list[Series], Float[np.ndarray, "all_unknowns values"]]:
    """The weighted residuals of all recordings in units of their standard deviations, with their
    derivatives with respect to the values and to the amplitudes of the camera's shapes, and the
    matrix by which all of these follow from the values.

    The match multiplies residuals and derivatives by the square roots of the loss's weights. Here
    the residuals have the whole weights, which makes them the influence of the residuals, and the
    derivatives none.
    """
    result, noise_model = estimate
    assert noise_model.channel_curvature is not None
    assert noise_model.common_mode_curvature is not None
    errors = result.recording_errors()
    jacobian = result.jacobian()[:, inside]
    row, count = 0, jacobian.shape[1]
    lift, all_series = [np.eye(count)], []
    for group in result.objective.groups:
        blocks = []
        for part in (group.weights.channel, group.weights.common_mode, group.weights.sizes):
            rows = jacobian[row : row + np.size(part)]
            blocks.append(rows.reshape(*np.shape(part), jacobian.shape[1]))
            row += len(rows)
        for number, position in enumerate(group.positions):
            counted = problem.sample_weights[position]
            times = slice(len(counted))  # without the samples that fill up their number
            weights = jax.tree.map(lambda leaf, at=number: np.asarray(leaf[at]), group.weights)
            d_channel, d_common_mode, d_sizes = (block[number] for block in blocks)
            d_channel, d_common_mode = d_channel[times], d_common_mode[times]
            if (beside := beside_others(counted)).any():
                loss = _ratio(noise_model.channel_weights[position], counted)
                of_channels = weights.channel[times] * errors[position].channel
                # Subtracting the mean of the channels leaves one independent channel less.
                channels = float(beside.sum() / np.count_nonzero(beside.any(axis=1)))
                roots = np.sqrt(counted * beside)
                series = Series(
                    kind=0,
                    recording=position,
                    residuals=np.sqrt(loss) * of_channels,
                    slopes=d_channel / np.sqrt(loss)[..., None],
                    entries=np.arange(d_channel.shape[-1]),
                    curvature=noise_model.channel_curvature[position],
                    roots=roots,
                    channels=channels,
                    independent=channels - 1,
                )
                all_series.append(series.dependent_part())
            used = weights.shapes.any(axis=0)
            common_mode = weights.common_mode[times]
            shapes = weights.shapes[times] * common_mode[:, None] / weights.sizes
            # The Jacobian of the match includes the change of the amplitudes; it is removed here.
            slopes = np.zeros((len(shapes), 1, count + int(used.sum())))
            slopes[:, 0, : jacobian.shape[1]] = d_common_mode + shapes @ d_sizes
            slopes[:, 0, count:] = -shapes[:, used]
            loss = noise_model.common_mode_weights[position][:, None]
            shared = (common_mode * errors[position].common_mode)[:, None]
            series = Series(
                kind=1,
                recording=position,
                residuals=np.sqrt(loss) * shared,
                slopes=slopes / np.sqrt(loss)[..., None],
                entries=np.arange(slopes.shape[-1]),
                curvature=noise_model.common_mode_curvature[position][:, None],
                roots=(counted.max(axis=1, keepdims=True) > 0).astype(float),
                channels=1.0,
                independent=1.0,
            )
            all_series.append(series.dependent_part())
            lift.append(d_sizes[used])
            count += int(used.sum())
    return all_series, np.concatenate(lift)


def _ratio(
    weights: Float[np.ndarray, "times channels"], samples: Float[np.ndarray, "times channels"]
) -> Float[np.ndarray, "times channels"]:
    """The part of the loss in the weights of samples; 1 for samples without weight."""
    return np.divide(weights, samples, out=np.ones_like(samples), where=samples > 0)


def _between_recordings(
    all_series: list[Series],
    mixtures: tuple[Mixture, ...],
    prior: Float[np.ndarray, "all_unknowns all_unknowns"],
    pull: Float[np.ndarray, " all_unknowns"],
    unknowns: Unknowns,
    inside: Bool[np.ndarray, " unknowns"],
) -> Float[np.ndarray, " unknowns"]:
    """The standard deviation of each entry of the optimiser's vector between recordings; 0 for
    entries without a prior, and for values that belong to a single recording."""
    size = len(prior)
    scores = [
        RecordingScore(np.zeros(size), np.zeros((size, size)), np.zeros((size, size)))
        for _ in range(unknowns.recordings)
    ]
    for series in all_series:
        of, at = scores[series.recording], np.ix_(series.entries, series.entries)
        of.score[series.entries] += np.tensordot(series.slopes, series.residuals, ([0, 1], [0, 1]))
        of.information[at] += np.tensordot(series.curved_slopes, series.slopes, ([0, 1], [0, 1]))
        of.noise[at] += noise_in_unknowns(series, mixtures[series.kind])
    values = int(inside.sum())
    behind = unknowns.size - len(unknowns.per_recording) * unknowns.recordings
    for number, of in enumerate(scores):
        # A value of a single recording depends on this recording and on its prior alone.
        own = [place for place in unknowns.layout.entry_indices()[number] if inside[place]]
        own = np.cumsum(inside)[[place for place in own if place >= behind]] - 1
        of.score[own] += pull[own]
        # The camera's amplitudes are solved for exactly.
        of.score[values:] = 0.0
    standard_deviations = np.array([row.prior_spread or 0.0 for row in unknowns.entry_parameters])
    standard_deviations[len(unknowns.shared) :] = 0.0
    is_shared = (np.arange(unknowns.size) < len(unknowns.shared)) & inside
    # The unknowns of the series are the entries inside their bounds, then the amplitudes.
    shared = np.flatnonzero(is_shared[inside])
    return standard_deviations * estimate_heterogeneity(
        scores, prior, shared, standard_deviations[is_shared]
    )
