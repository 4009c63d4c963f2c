"""The noise that a match assumes for its residuals, and its estimation from these residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ._camera_error import detect_events
from ._noise import Noise, estimate_noise
from ._problem import MatchProblem
from ._recording_errors import RecordingErrors
from ._robust_loss import huber_weights, limited_variance

INITIAL_NOISE = Noise(0.25, 64.0)
"""The noise before the first round: 0.25 K, correlated over a minute."""

SETTLED = 0.1
"""The relative change of Huber's weights below which they are final."""


@final
@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The assumed noise of the residuals, and the weights that follow from it.

    - `channel`: the noise of each channel without the common mode.
    - `common_mode`: the noise of the common mode, times the square root of the number of channels.
    - `events`: times of the camera's corrections in each recording, s.
    - `channel_weights`, `common_mode_weights`: weights of the samples of each recording, 0 to 1,
      from masks and from Huber's loss.
    """

    channel: Noise
    common_mode: Noise
    events: tuple[tuple[float, ...], ...]
    channel_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    common_mode_weights: tuple[Float[np.ndarray, " _times"], ...]


def initial_noise_model(problem: MatchProblem) -> NoiseModel:
    """The noise model of the first round."""
    noise = INITIAL_NOISE if problem.is_weighted else Noise(1.0, 1.0)
    return NoiseModel(
        channel=noise,
        common_mode=noise,
        events=problem.events or tuple(() for _ in problem.experiments),
        channel_weights=problem.sample_weights,
        common_mode_weights=tuple(np.ones(len(weights)) for weights in problem.sample_weights),
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
    channel_huber = tuple(np.ones(of_recording.channel.shape) for of_recording in errors)
    common_mode_huber = tuple(np.ones(len(of_recording.common_mode)) for of_recording in errors)
    if problem.robust is not None:
        pairs = list(zip(problem.sample_weights, errors, strict=True))
        channel_huber = tuple(
            huber_weights(of_recording.channel, problem.robust, beside_others(weights))
            if weights.shape[1] > 1  # a single channel is its own common mode
            else np.ones(weights.shape)
            for weights, of_recording in pairs
        )
        common_mode_huber = tuple(
            huber_weights(of_recording.common_mode, problem.robust, weights.sum(axis=1) > 0)
            for weights, of_recording in pairs
        )
    channel, common_mode = _residual_noise(problem, errors, channel_huber, common_mode_huber)
    return NoiseModel(
        channel=channel if channel.standard_deviation > 0 else noise_model.channel,
        common_mode=common_mode if common_mode.standard_deviation > 0 else noise_model.common_mode,
        events=events,
        channel_weights=tuple(map(np.multiply, problem.sample_weights, channel_huber)),
        common_mode_weights=common_mode_huber,
    )


def has_settled(before: NoiseModel, after: NoiseModel) -> bool:
    """Whether an update changed the limits of outliers little."""
    pairs = [
        *zip(before.channel_weights, after.channel_weights, strict=True),
        *zip(before.common_mode_weights, after.common_mode_weights, strict=True),
    ]
    return all(np.allclose(old, new, rtol=SETTLED, atol=0.0) for old, new in pairs)


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
    channel_huber: Sequence[Float[np.ndarray, "_times _channels"]],
    common_mode_huber: Sequence[Float[np.ndarray, " _times"]],
) -> tuple[Noise, Noise]:
    """The noise of the channels and of the common mode. If no two channels count at the same time,
    both have the noise of the common mode.

    Huber's loss limits the residuals. The standard deviations are those of normally distributed
    residuals before they are limited (Huber's proposal 2)."""
    scale = 1.0 if problem.robust is None else limited_variance(problem.robust) ** -0.5
    several, counted = [], 0.0
    for of_recording, samples, huber in zip(
        errors, problem.sample_weights, channel_huber, strict=True
    ):
        beside = beside_others(samples)
        if beside.any():
            # Deviations from a mean of n channels vary less than the channels do, by (n - 1) / n.
            n = np.maximum(beside.sum(axis=1, keepdims=True), 2)
            roots = np.sqrt(samples * beside * n / (n - 1))
            several.append(scale * of_recording.channel * huber * roots)
            counted += float(np.sum(samples * beside))
    common_modes = [
        (scale * of_recording.common_mode * moments * np.sqrt((samples * huber).sum(axis=1)))[
            :, None
        ]
        for of_recording, samples, huber, moments in zip(
            errors, problem.sample_weights, channel_huber, common_mode_huber, strict=True
        )
    ]
    # Samples without weight are left out.
    times = [samples.sum(axis=1) > 0 for samples in problem.sample_weights]
    of_common_mode = estimate_noise(common_modes, float(sum(part.sum() for part in times)))
    if not several:
        return of_common_mode, of_common_mode
    return estimate_noise(several, counted), of_common_mode
