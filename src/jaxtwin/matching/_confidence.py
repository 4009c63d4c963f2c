"""What a match is worth: from where a descent ended to the uncertainty of its values."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from ._autocovariance import Mixture, Series, fit_noise, noise_in_unknowns
from ._between_recordings import RecordingScore, spread_between_recordings
from ._descend import DescentResult
from ._estimate import NoiseModel, Residuals, beside_others
from ._noise import Noise
from ._uncertainty import Uncertainty, inverse_of_normal, uncertainty
from ._unknowns import Unknowns


def confidence(
    result: DescentResult,
    residuals: Residuals,
    unknowns: Unknowns,
    noise_model: NoiseModel,
    names: tuple[str, ...],
) -> tuple[Uncertainty, tuple[Noise, Noise]]:
    """The uncertainty of the matched values, and the noise of what each channel has alone and of
    what all share times the root of their number.

    The sizes of the camera's shapes, which the optimiser never saw, are unknowns here: what they
    take away from the residuals must be known before the noise is.
    """
    vector, precision = result.vector, unknowns.prior_weights()
    inside = (vector > unknowns.lower() + 1e-9) & (vector < unknowns.upper() - 1e-9)
    series, lift = _series(result, residuals, noise_model, inside)
    count, values = lift.shape
    camera = np.diag((np.arange(count) >= values).astype(float))
    normal = camera.copy()
    for one in series:
        at = np.ix_(one.entries, one.entries)
        normal[at] += np.tensordot(one.slopes, one.slopes, ([0, 1], [0, 1]))
    prior = np.zeros((count, count))
    prior[:values, :values] = np.diag(precision[inside] ** 2)
    mixtures, meat = fit_noise(series, inverse_of_normal(normal + prior)[0], camera + prior)
    scales = (noise_model.channel.effective, noise_model.common_mode.effective)
    noise = [one.noise(scale) for one, scale in zip(mixtures, scales, strict=True)]
    if all(one.kind == 1 for one in series):
        # Recordings of one channel: it has nothing alone.
        noise[0] = noise[1]
    found = uncertainty(
        unknowns.labels(names),
        lift.T @ normal @ lift,
        lift.T @ (meat + camera) @ lift,
        precision,
        np.where(
            precision > 0, 1 / np.where(precision > 0, precision, 1.0), unknowns.default_scales()
        ),
        unknowns.value_derivatives(vector),
        inside,
    )
    pull = np.zeros(count)
    pull[:values] = ((vector - unknowns.prior_means()) * precision**2)[inside]
    between = _between_recordings(series, mixtures, camera + prior, pull, unknowns, inside)
    found = replace(found, between_recordings=between)
    return found, (noise[0], noise[1])


def _series(
    result: DescentResult,
    residuals: Residuals,
    noise_model: NoiseModel,
    inside: Bool[np.ndarray, " unknowns"],
) -> tuple[list[Series], Float[np.ndarray, "all_unknowns values"]]:
    """The weighted residuals of all recordings with their derivatives in the values and in the
    sizes of the camera's shapes, counted in their standard deviations; and how all of these follow
    the values."""
    jacobian = result.jacobian()[:, inside]
    row, count = 0, jacobian.shape[1]
    lift, series = [np.eye(count)], []
    for group in result.objective.groups:
        blocks = []
        for part in (group.weights.channel, group.weights.common_mode, group.weights.size_weight):
            rows = jacobian[row : row + np.size(part)]
            blocks.append(rows.reshape(*np.shape(part), jacobian.shape[1]))
            row += len(rows)
        for number, position in enumerate(group.positions):
            counted = noise_model.channel_weights[position]
            times = slice(len(counted))  # without the samples that fill up their number
            weights = jax.tree.map(lambda leaf, at=number: np.asarray(leaf[at]), group.weights)
            of_channel, of_common, of_sizes = (block[number] for block in blocks)
            of_channel, of_common = of_channel[times], of_common[times]
            if (beside := beside_others(counted)).any():
                own = weights.channel[times] * residuals.channel[position]
                # Of the channels that count at a time, their mean takes one away.
                channels = float(beside.sum() / np.count_nonzero(beside.any(axis=1)))
                roots = np.sqrt(counted * beside)
                apart = (channels, channels - 1)
                series.append(_dependent_part(0, position, own, of_channel, roots, *apart))
            used = weights.shapes.any(axis=0)
            common_mode = weights.common_mode[times]
            shapes = weights.shapes[times] * common_mode[:, None] / weights.size_weight
            # The match has each value move the sizes too: undone here.
            slopes = np.zeros((len(shapes), 1, count + int(used.sum())))
            slopes[:, 0, : jacobian.shape[1]] = of_common + shapes @ of_sizes
            slopes[:, 0, count:] = -shapes[:, used]
            moments = np.sqrt(noise_model.common_mode_weights[position]) * counted.any(axis=1)
            shared = (common_mode * residuals.common_mode[position])[:, None]
            series.append(_dependent_part(1, position, shared, slopes, moments[:, None], 1.0, 1.0))
            lift.append(of_sizes[used])
            count += int(used.sum())
    return series, np.concatenate(lift)


def _between_recordings(
    series: list[Series],
    mixtures: tuple[Mixture, ...],
    prior: Float[np.ndarray, "all_unknowns all_unknowns"],
    pull: Float[np.ndarray, " all_unknowns"],
    unknowns: Unknowns,
    inside: Bool[np.ndarray, " unknowns"],
) -> Float[np.ndarray, " unknowns"]:
    """By how much each entry of the optimiser's vector differs between recordings, one standard
    deviation; 0 for what has no prior, and for what each recording has of its own."""
    size = len(prior)
    scores = [
        RecordingScore(np.zeros(size), np.zeros((size, size)), np.zeros((size, size)))
        for _ in range(unknowns.recordings)
    ]
    for one in series:
        of, at = scores[one.recording], np.ix_(one.entries, one.entries)
        of.score[one.entries] += np.tensordot(one.slopes, one.residuals, ([0, 1], [0, 1]))
        of.information[at] += np.tensordot(one.slopes, one.slopes, ([0, 1], [0, 1]))
        of.noise[at] += noise_in_unknowns(one, mixtures[one.kind])
    values = int(inside.sum())
    for number, of in enumerate(scores):
        # Each value of one recording alone is told by it and by its prior.
        own = [place for place in unknowns.layout.entry_indices()[number] if inside[place]]
        own = np.cumsum(inside)[[place for place in own if place >= len(unknowns.shared)]] - 1
        of.score[own] += pull[own]
        # The camera's sizes are solved for exactly.
        of.score[values:] = 0.0
    spreads = np.array([row.prior_spread or 0.0 for row in unknowns.entry_parameters])
    spreads[len(unknowns.shared) :] = 0.0
    is_shared = (np.arange(unknowns.size) < len(unknowns.shared)) & inside
    # The unknowns of the series are the entries inside their bounds, then the camera's sizes.
    shared = np.flatnonzero(is_shared[inside])
    return spreads * spread_between_recordings(scores, prior, shared, spreads[is_shared])


def _dependent_part(
    kind: int,
    recording: int,
    residuals: Float[np.ndarray, "times channels"],
    slopes: Float[np.ndarray, "times channels all_unknowns"],
    roots: Float[np.ndarray, "times channels"],
    channels: float,
    independent: float,
) -> Series:
    """A series with derivatives in those unknowns alone on which it depends."""
    entries = np.flatnonzero(slopes.any(axis=(0, 1)))
    at = (..., entries)
    return Series(kind, recording, residuals, slopes[at], entries, roots, channels, independent)
