r"""The uncertainty of the matched values: covariance, correlations and identifiability.

Let $J$ be the Jacobian of the weighted residuals, $\Gamma$ the covariance of their noise, and $P$
the precision of the priors. Then

$$A = J^T J + P, \qquad \operatorname{cov} = A^{-1} (J^T \Gamma J + P) A^{-1}$$

This is the sandwich estimator (Huber 1967, White 1982): $A^{-1}$ is its bread and $J^T \Gamma J +
P$ its meat. The match weights its residuals as if they were independent. This makes the estimate
less efficient, but the covariance remains valid because it contains $\Gamma$. `_autocovariance`
estimates $\Gamma$, and `_between_recordings` how much the rig itself differs between recordings.
The information of the recordings alone is $J^T J (J^T \Gamma J)^{-1} J^T J$ (Godambe 1960), the
inverse of that covariance without $P$.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ._autocovariance import AutocorrelatedNoise, ResidualSeries, fit_noise, noise_in_unknowns
from ._descent_result import MatchEstimate
from ._group_values import RecordingScore, estimate_heterogeneity
from ._loss import influence_variance
from ._noise_model import Noise, beside_others
from ._problem import MatchProblem
from ._unknowns import Unknowns

# Pairs of values with a larger absolute correlation are reported.
CORRELATED_ABOVE = 0.95


@final
@dataclass(frozen=True)
class UnidentifiableDirection:
    """A combination of parameters about which the recordings say less than the prior.

    It is practically unidentifiable in the sense of Raue and others, Bioinformatics 25 (2009)
    1923-1929: the likelihood alone is flat along it.

    - `weights`: label -> share in the direction, largest first. Each parameter is measured in its
      prior's standard deviations (positive parameters without a prior: relative to their value).
    - `prior_to_data_ratio`: the prior's standard deviation along the direction divided by the one
      that the recordings alone would give. Below 1 the recordings say less than the prior.
    """

    weights: dict[str, float]
    prior_to_data_ratio: float

    def __str__(self) -> str:
        terms = " ".join(f"{weight:+.2f} {label}" for label, weight in self.weights.items())
        return f"{terms} (ratio {self.prior_to_data_ratio:.2g})"


@final
@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of the matched values.

    **Arguments:**

    - `labels`: names of the matched values; a value of a single recording is `name[recording]`.
    - `covariance`: the covariance of the values in their units. NaN where a value was held at a
      bound; the variance of an undetermined value is infinite.
    - `correlation`: the correlations of the same values.
    - `prior_to_data_ratio`: for each value, the prior's standard deviation divided by the one that
      the recordings alone would give if all other values were known; 0 for insensitive parameters.
    - `singular_values`: those of the recordings' sensitivity matrix with each column scaled by the
      prior's standard deviation, largest first. Below 1 a direction is determined by the prior.
    - `unidentifiable`: the directions with a singular value below 1.
    - `insensitive`: labels of values on which no sample depends.
    - `collinear`: pairs whose correlation is above 0.95 in size, with the correlation.
    - `vector_covariance`: the covariance of the optimiser's vector, in which positive parameters
      are logarithms.
    - `inverse_hessian`: $A^{-1}$, the covariance that this vector would have if the weighted
      residuals were independent with a standard deviation of 1; NaN where a value was held at a
      bound.
    - `between_recordings`: standard deviations of the rig's own values between recordings, on the
      scale of the vector; see `_between_recordings`.
    """

    labels: tuple[str, ...]
    covariance: Float[np.ndarray, "values values"]
    correlation: Float[np.ndarray, "values values"]
    prior_to_data_ratio: Float[np.ndarray, " values"]
    singular_values: Float[np.ndarray, " directions"]
    unidentifiable: tuple[UnidentifiableDirection, ...]
    insensitive: tuple[str, ...]
    collinear: tuple[tuple[str, str, float], ...]
    vector_covariance: Float[np.ndarray, "values values"]
    inverse_hessian: Float[np.ndarray, "values values"]
    between_recordings: Float[np.ndarray, " values"]

    @property
    def standard_errors(self) -> dict[str, float]:
        """Label -> standard error in the parameter's unit."""
        errors = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.labels, errors.tolist(), strict=True))

    def report(self, replaced: Collection[str] = ()) -> str:
        """The directions and parameters that the recordings do not determine, as text.

        `replaced` are the parameters for which the recordings hold measured values instead.
        """
        measured = [label for label in self.insensitive if label.split("[")[0] in replaced]
        insensitive = [label for label in self.insensitive if label not in measured]
        weak = [row for row in self.unidentifiable if not row.weights.keys() <= {*measured}]
        count = len(self.singular_values) - len(self.unidentifiable) + len(weak)
        space = f"of {count} directions in the space of the parameters"
        lines = [
            f"{space}, the recordings determine {len(weak) or 'none'} less well than the priors"
        ]
        if weak:
            lines.append(
                "ratio: the standard deviation of the prior over that of an estimate from the "
                "recordings alone; below 1 the prior says more"
            )
        lines += [f"insensitive: {', '.join(insensitive)}"] * bool(insensitive)
        lines += [f"replaced by what was recorded: {', '.join(measured)}"] * bool(measured)
        lines += [f"unidentifiable: {direction}" for direction in weak]
        lines += [f"correlated: {a} and {b}, {value:.3f}" for a, b, value in self.collinear]
        return "\n".join(lines)


@final
@dataclass(frozen=True, eq=False)
class VectorEntries:
    """The entries of the optimiser's vector, without the information of the recordings.

    - `labels`: their names.
    - `precision`: the inverse of the priors' covariance, 0 for entries without a prior.
    - `scale`: the unit in which each entry is measured: its prior's standard deviation, or a
      default for entries without a prior.
    - `slopes`: derivatives of the values, in their units, with respect to the entries.
    - `inside`: whether each entry is not at a bound.
    """

    labels: tuple[str, ...]
    precision: Float[np.ndarray, "values values"]
    scale: Float[np.ndarray, " values"]
    slopes: Float[np.ndarray, " values"]
    inside: Bool[np.ndarray, " values"]


def estimate_uncertainty(
    problem: MatchProblem, estimate: MatchEstimate
) -> tuple[Uncertainty, tuple[Noise, Noise]]:
    """Estimates the uncertainty of the matched values, and the noise of the channels and of the
    common mode (times the root of the number of channels).

    The amplitudes of the camera's shapes, which the optimiser does not see, are unknowns here: the
    noise can be estimated only if the part of the residuals that they absorb is known.
    """
    unknowns, (result, noise_model) = problem.unknowns, estimate
    vector, precision = result.vector, problem.prior_precision
    inside = unknowns.are_inside(vector)
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
    solution = uncertainty(entries, lift.T @ normal @ lift, lift.T @ (meat + camera) @ lift)
    pull = np.zeros(count)
    linear = problem.linear_prior
    away = (vector - unknowns.prior_means()) * problem.prior_weights**2
    away += linear.matrix.T @ (linear.matrix @ vector - linear.values)
    pull[:values] = away[inside]
    between = _between_recordings(all_series, mixtures, camera + prior, pull, unknowns, inside)
    return replace(solution, between_recordings=between), (noise[0], noise[1])


def uncertainty(
    entries: VectorEntries,
    normal: Float[np.ndarray, "free free"],
    meat: Float[np.ndarray, "free free"],
) -> Uncertainty:
    r"""Computes the uncertainty of a match.

    **Arguments:**

    - `entries`: the entries of the optimiser's vector.
    - `normal`, `meat`: $J^T J$ and $J^T \Gamma J$ for the entries that are not at a bound.

    **Returns:** the uncertainty of values that are the same in all recordings.
    """
    labels, free = entries.labels, np.flatnonzero(entries.inside)
    n = len(labels)
    prior = entries.precision[np.ix_(free, free)]
    inverse, lost = inverse_of_normal(normal + prior)
    sandwich = inverse @ (meat + prior) @ inverse
    vector_covariance = np.full((n, n), np.nan)
    vector_covariance[np.ix_(free, free)] = sandwich
    inverse_hessian = np.full((n, n), np.nan)
    inverse_hessian[np.ix_(free, free)] = inverse
    undetermined = np.zeros(n, dtype=bool)
    undetermined[free[lost]] = True
    covariance, correlation = physical_covariance(vector_covariance, entries.slopes, undetermined)
    # The information of the recordings alone, in units of the priors.
    singular, directions, lengths = _singular(normal, meat, entries.scale[free])
    prior_to_data_ratio = np.full(n, np.nan)
    prior_to_data_ratio[free] = lengths
    names = [labels[int(number)] for number in free]
    unidentifiable = [
        UnidentifiableDirection(_largest(names, direction), float(value))
        for value, direction in zip(singular, directions.T, strict=True)
        if value < 1
    ]
    return Uncertainty(
        labels=labels,
        covariance=covariance,
        correlation=correlation,
        prior_to_data_ratio=prior_to_data_ratio,
        singular_values=singular[::-1],
        unidentifiable=tuple(unidentifiable),
        insensitive=insensitive_labels(labels, prior_to_data_ratio),
        collinear=close_pairs(labels, correlation),
        vector_covariance=vector_covariance,
        inverse_hessian=inverse_hessian,
        between_recordings=np.zeros(n),
    )


def physical_covariance(
    vector_covariance: Float[np.ndarray, "values values"],
    slopes: Float[np.ndarray, " values"],
    undetermined: Bool[np.ndarray, " values"],
) -> tuple[Float[np.ndarray, "values values"], Float[np.ndarray, "values values"]]:
    """Covariance and correlation of the values in their units.

    **Arguments:**

    - `vector_covariance`: the covariance of the optimiser's vector.
    - `slopes`: derivatives of the values with respect to the vector's entries.
    - `undetermined`: which values are undetermined: their variances are infinite.
    """
    covariance = vector_covariance * np.outer(slopes, slopes)
    covariance[undetermined, undetermined] = np.inf
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return covariance, covariance / np.outer(errors, errors)


def insensitive_labels(
    labels: Sequence[str], prior_to_data_ratio: Float[np.ndarray, " values"]
) -> tuple[str, ...]:
    """Labels of the values on which no sample depends."""
    return tuple(
        label for label, ratio in zip(labels, prior_to_data_ratio, strict=True) if ratio < 1e-9
    )


def close_pairs(
    labels: Sequence[str], correlation: Float[np.ndarray, "values values"]
) -> tuple[tuple[str, str, float], ...]:
    """Pairs of labels whose correlation is above 0.95 in size, closest first."""
    pairs = [
        (labels[a], labels[b], float(correlation[a, b]))
        for a in range(len(labels))
        for b in range(a)
        if abs(correlation[a, b]) > CORRELATED_ABOVE
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))


def inverse_of_normal(
    normal: Float[np.ndarray, "n n"],
) -> tuple[Float[np.ndarray, "n n"], Bool[np.ndarray, " n"]]:
    """$A^{-1}$ along the directions in which A is more than rounding, and which entries lie along
    the others."""
    lengths = np.sqrt(np.diag(normal))
    alive = lengths > 0
    unit = np.where(alive, lengths, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(unit, unit))
    open_ = values <= 1e-13 * values.max(initial=0.0)
    inverse = (vectors * np.where(open_, 0.0, 1 / np.where(open_, 1.0, values))) @ vectors.T
    inverse /= np.outer(unit, unit)
    return inverse, np.any(np.abs(vectors[:, open_]) > 1e-3, axis=1) | ~alive


def _singular(
    normal: Float[np.ndarray, "free free"],
    meat: Float[np.ndarray, "free free"],
    scale: Float[np.ndarray, " free"],
) -> tuple[Float[np.ndarray, " free"], Float[np.ndarray, "free free"], Float[np.ndarray, " free"]]:
    r"""Singular values of the scaled sensitivities, their directions, and lengths of the columns.

    Sensitivities are rows whose products are $J^T J (J^T \Gamma J)^{-1} J^T J$.
    """
    size = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(normal * size)
    root = np.sqrt(np.maximum(values, 0.0))
    shown = root > 1e-7 * root.max(initial=0.0)
    back = np.where(shown, 1 / np.where(shown, root, 1.0), 0.0)
    # The variance of the noise along each direction, as a multiple of that of the match's weights.
    stronger = (vectors * back).T @ (meat * size) @ (vectors * back)
    stronger += np.diag(~shown).astype(float)
    information = (vectors * root) @ np.linalg.pinv(stronger, hermitian=True) @ (vectors * root).T
    values, directions = np.linalg.eigh(information)
    # Rounding must not make an insensitive parameter look sensitive.
    lengths = np.sqrt(np.where(np.diag(normal * size) > 1e-18, np.abs(np.diag(information)), 0.0))
    return np.sqrt(np.maximum(values, 0.0)), directions, lengths


def _largest(names: Sequence[str], direction: Float[np.ndarray, " values"]) -> dict[str, float]:
    """The largest entries of a unit vector with nine tenths of its square, at most six."""
    order = np.argsort(-np.abs(direction))
    share = np.cumsum(direction[order] ** 2)
    count = int(np.searchsorted(share, 0.9)) + 1
    sign = np.sign(direction[order[0]])
    return {names[int(n)]: float(sign * direction[n]) for n in order[: min(count, 6)]}


def _series(
    problem: MatchProblem, estimate: MatchEstimate, inside: Bool[np.ndarray, " unknowns"]
) -> tuple[list[ResidualSeries], Float[np.ndarray, "all_unknowns values"]]:
    """The weighted residuals of all recordings in units of their standard deviations, with their
    derivatives with respect to the values and to the amplitudes of the camera's shapes, and the
    matrix by which all of these follow from the values.

    The match multiplies residuals and derivatives by the square roots of the loss's weights. Here
    the residuals are multiplied by the weights themselves, which makes them the influence, and the
    derivatives are not weighted by the loss.
    """
    result, noise_model = estimate
    assert noise_model.channel_curvature is not None
    assert noise_model.common_mode_curvature is not None
    errors = result.recording_errors()
    jacobian = result.jacobian()[:, inside]
    row, count = 0, jacobian.shape[1]
    lift, all_series = [np.eye(count)], []
    for batch in result.objective.same_shape_batches:
        blocks = []
        for part in (batch.weights.channel, batch.weights.common_mode, batch.weights.sizes):
            rows = jacobian[row : row + np.size(part)]
            blocks.append(rows.reshape(*np.shape(part), jacobian.shape[1]))
            row += len(rows)
        for number, position in enumerate(batch.positions):
            counted = problem.sample_weights[position]
            times = slice(len(counted))  # without the samples that fill up their number
            weights = batch.weights_of(number)
            d_channel, d_common_mode, d_sizes = (block[number] for block in blocks)
            d_channel, d_common_mode = d_channel[times], d_common_mode[times]
            if (beside := beside_others(counted)).any():
                loss = _ratio(noise_model.channel_weights[position], counted)
                of_channels = weights.channel[times] * errors[position].channel
                # Subtracting the mean of the channels leaves one independent channel less.
                channels = float(beside.sum() / np.count_nonzero(beside.any(axis=1)))
                roots = np.sqrt(counted * beside)
                series = ResidualSeries(
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
            series = ResidualSeries(
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
    all_series: list[ResidualSeries],
    mixtures: tuple[AutocorrelatedNoise, ...],
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
