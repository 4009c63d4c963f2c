"""The noise of residuals: what a match assumes, and its estimation from the residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ._camera_error import detect_events
from ._loss import LossWeights, influence_variance, loss_weights
from ._problem import MatchProblem
from ._residual_weights import RecordingErrors


@final
@dataclass(frozen=True)
class Noise:
    """The noise of residuals of one kind, over all recordings.

    - `standard_deviation`: the standard deviation of a single sample, K.
    - `autocorrelation_time`: the integrated autocorrelation time in samples, 1 plus twice the sum
      of the autocorrelations: the number of samples with the information of one independent sample.
    """

    standard_deviation: float
    autocorrelation_time: float

    @property
    def effective(self) -> float:
        """Standard deviation of independent samples with the same information, K."""
        return self.standard_deviation * float(np.sqrt(self.autocorrelation_time))


# The noise before the first round: 0.25 K, correlated over a minute.
INITIAL_NOISE = Noise(0.25, 64.0)

# The relative change of the loss's weights below which they are final.
WEIGHT_TOLERANCE = 0.1


@final
@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The assumed noise of the residuals, and the weights that follow from it.

    - `channel`: the noise of each channel without the common mode.
    - `common_mode`: the noise of the common mode, times the square root of the number of channels.
    - `events`: times of the camera's corrections in each recording, s.
    - `channel_weights`, `common_mode_weights`: weights of the samples of each recording, 0 to 1,
      from masks and from the loss.
    - `channel_curvature`, `common_mode_curvature`: the curvature of the loss at these residuals, 1
      for plain squares. None in a saved fit, whose uncertainty is in its file.
    """

    channel: Noise
    common_mode: Noise
    events: tuple[tuple[float, ...], ...]
    channel_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    common_mode_weights: tuple[Float[np.ndarray, " _times"], ...]
    channel_curvature: tuple[Float[np.ndarray, "_times _channels"], ...] | None = None
    common_mode_curvature: tuple[Float[np.ndarray, " _times"], ...] | None = None


def estimate_noise(
    series: Sequence[Float[np.ndarray, "_times _channels"]], samples: float | int | None = None
) -> Noise:
    """Estimates standard deviation and autocorrelation time of several series of residuals about
    zero.

    The sum of autocorrelations ends before the first two neighbours whose sum is not positive
    (Geyer 1992, initial positive sequence), because later ones are only noise.

    **Arguments:**

    - `series`: a series for each recording, times the square roots of the samples' weights.
    - `samples`: the sum of these weights; by default all are 1.
    """
    longest = max(len(residuals) for residuals in series)
    covariances = np.zeros(longest)
    counted = sum(residuals.size for residuals in series) if samples is None else samples
    for residuals in series:
        times = len(residuals)
        padded = np.fft.rfft(residuals, 2 * times, axis=0)
        covariances[:times] += np.fft.irfft(np.abs(padded) ** 2, axis=0)[:times].sum(axis=1)
    if covariances[0] <= 0:
        return Noise(0.0, 1.0)
    pairs = (covariances[: longest // 2 * 2] / covariances[0]).reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    total = 2 * pairs[: ends[0] if ends.size else len(pairs)].sum() - 1
    return Noise(float(np.sqrt(covariances[0] / counted)), float(max(1.0, total)))


def initial_noise_model(problem: MatchProblem) -> NoiseModel:
    """The noise model of the first round."""
    noise = INITIAL_NOISE if problem.is_weighted else Noise(1.0, 1.0)
    moments = tuple(np.ones(len(weights)) for weights in problem.sample_weights)
    return NoiseModel(
        channel=noise,
        common_mode=noise,
        events=problem.events or tuple(() for _ in problem.experiments),
        channel_weights=problem.sample_weights,
        common_mode_weights=moments,
        channel_curvature=tuple(np.ones(weights.shape) for weights in problem.sample_weights),
        common_mode_curvature=moments,
    )


def update_noise_model(
    problem: MatchProblem, noise_model: NoiseModel, errors: Sequence[RecordingErrors]
) -> NoiseModel:
    """Updates the noise model with the residuals of a round: corrections of the camera, noise,
    outliers.

    **Arguments:**

    - `noise_model`: the noise model of that round, whose noise is kept if all residuals are 0.
    - `errors`: the residuals of each recording.
    """
    events = noise_model.events
    if problem.common_error is not None and problem.events is None:
        events = tuple(
            detect_events(
                experiment.time,
                -of_recording.mean_over_channels(weights),  # recorded less simulated
                np.count_nonzero(weights, axis=1) > 0,
            )
            for experiment, of_recording, weights in zip(
                problem.experiments, errors, problem.sample_weights, strict=True
            )
        )
    pairs = list(zip(problem.sample_weights, errors, strict=True))
    of_channels = [
        # A single channel is its own common mode; no sample then counts beside others.
        loss_weights(problem.loss, of_recording.channel, beside_others(weights))
        for weights, of_recording in pairs
    ]
    of_common_mode = [
        loss_weights(problem.loss, of_recording.common_mode, weights.sum(axis=1) > 0)
        for weights, of_recording in pairs
    ]
    channel, common_mode = _residual_noise(problem, errors, of_channels, of_common_mode)
    return NoiseModel(
        channel=channel if channel.standard_deviation > 0 else noise_model.channel,
        common_mode=common_mode if common_mode.standard_deviation > 0 else noise_model.common_mode,
        events=events,
        channel_weights=tuple(
            samples * result.weights
            for samples, result in zip(problem.sample_weights, of_channels, strict=True)
        ),
        common_mode_weights=tuple(result.weights for result in of_common_mode),
        channel_curvature=tuple(result.curvature for result in of_channels),
        common_mode_curvature=tuple(result.curvature for result in of_common_mode),
    )


def has_settled(before: NoiseModel, after: NoiseModel) -> bool:
    """Whether an update changed the loss weight of no sample by more than `WEIGHT_TOLERANCE`."""
    pairs = [
        *zip(before.channel_weights, after.channel_weights, strict=True),
        *zip(before.common_mode_weights, after.common_mode_weights, strict=True),
    ]
    return all(np.allclose(old, new, rtol=WEIGHT_TOLERANCE, atol=0.0) for old, new in pairs)


def beside_others(
    weights: Float[np.ndarray, "times channels"],
) -> Bool[np.ndarray, "times channels"]:
    """The samples that have another counted sample at the same time. A single one equals its common
    mode."""
    counted = weights > 0
    return counted & (counted.sum(axis=1, keepdims=True) > 1)


def _residual_noise(
    problem: MatchProblem,
    errors: Sequence[RecordingErrors],
    of_channels: Sequence[LossWeights],
    of_common_mode: Sequence[LossWeights],
) -> tuple[Noise, Noise]:
    """The noise of the channels and of the common mode. If no two channels count at the same time,
    both have the noise of the common mode.

    A robust loss limits the influence of residuals. The standard deviations are those of normally
    distributed residuals before it does (Huber's proposal 2)."""
    scale = influence_variance(problem.loss) ** -0.5
    several, counted = [], 0.0
    for of_recording, samples, loss in zip(
        errors, problem.sample_weights, of_channels, strict=True
    ):
        beside = beside_others(samples)
        if beside.any():
            # Deviations from a mean of n channels vary less than the channels do, by (n - 1) / n.
            n = np.maximum(beside.sum(axis=1, keepdims=True), 2)
            roots = np.sqrt(samples * beside * n / (n - 1))
            several.append(scale * of_recording.channel * loss.weights * roots)
            counted += float(np.sum(samples * beside))
    common_modes = [
        (
            scale
            * of_recording.common_mode
            * moments.weights
            * np.sqrt((samples * loss.weights).sum(axis=1))
        )[:, None]
        for of_recording, samples, loss, moments in zip(
            errors, problem.sample_weights, of_channels, of_common_mode, strict=True
        )
    ]
    # Samples without weight are left out.
    times = [samples.sum(axis=1) > 0 for samples in problem.sample_weights]
    common_mode_noise = estimate_noise(common_modes, float(sum(part.sum() for part in times)))
    if not several:
        return common_mode_noise, common_mode_noise
    return estimate_noise(several, counted), common_mode_noise
