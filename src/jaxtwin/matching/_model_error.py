r"""The error of the model itself, which a covariance of its values does not contain.

A match knows how surely its readings determine the values of a network, not whether the network is
that of the device. How well it would have predicted tells: for several origins in a recording, the
values that the readings before the origin determine are one Gauss-Newton step from the match. With
$A_b$ the normal matrix of those readings, of the other recordings and of the priors, and $g_a$ the
gradient of the readings after the origin,

$$\delta = A_b^{-1} g_a, \qquad e_b(t) = e(t) + J(t) \delta, \qquad
\operatorname{var} e_b(t) = J(t) A_b^{-1} J(t)^T + \sigma^2.$$

What the squares of these errors exceed their expected variance by, over the time from the origin to
the end, is the growth of the model's error. Origins after which the values are known well count
most (leave-future-out validation; Buerkner, Gabry and Vehtari, Journal of Statistical Computation
and Simulation 90 (2020) 2499-2523).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float

from ._descent_result import DescentResult, MatchEstimate
from ._problem import MatchProblem
from ._residual_weights import RecordingErrors

# The origins of the predictions, as fractions of a recording.
ORIGINS = (0.5, 0.65, 0.8)

# The largest error of the model, in standard deviations of the readings: one that grows without
# limit would be useless.
MAX_SPREAD = 2.0


@final
@dataclass(frozen=True)
class ModelError:
    """What a network itself does not know of a device, learnt from predictions of known readings.

    **Arguments:**

    - `growth`: channel -> growth of the standard deviation of its error with time, K/s.
    - `largest`: channel -> the standard deviation at most, K.
    - `lowest`, `highest`: channel -> the temperatures that were matched, degC.
    - `extrapolation`: the part of the distance to these temperatures by which the error grows
      outside of them; 0 for a network that is given.
    """

    growth: Mapping[str, float] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)
    lowest: Mapping[str, float] = field(default_factory=dict)
    highest: Mapping[str, float] = field(default_factory=dict)
    extrapolation: float = 0.0

    def variance(
        self,
        ahead: Float[np.ndarray, " times"],
        temperatures: Float[np.ndarray, "times channels"],
        channels: Sequence[str],
    ) -> Float[np.ndarray, "times channels"]:
        """The variance of the error, K^2; 0 for channels that were not matched.

        **Arguments:**

        - `ahead`: the time since the last known reading, s.
        - `temperatures`: those that are predicted, degC.
        - `channels`: their names.
        """

        def of_channels(numbers: Mapping[str, float], default: float) -> np.ndarray:
            return np.array([numbers.get(name, default) for name in channels])

        largest = of_channels(self.largest, 0.0)
        grown = np.minimum(of_channels(self.growth, 0.0) * ahead[:, None], largest)
        outside = np.maximum(
            temperatures - of_channels(self.highest, np.inf),
            of_channels(self.lowest, -np.inf) - temperatures,
        )
        return grown**2 + (self.extrapolation * np.maximum(outside, 0.0)) ** 2


class _MatchedRecording(NamedTuple):
    """A recording at the match, without padding.

    - `errors`: the errors of the channels without that of the camera, K.
    - `jacobian`: derivatives of the readings by the entries that are not at a bound.
    - `residuals`, `slopes`: the weighted residuals at each time, and their derivatives.
    """

    channels: tuple[str, ...]
    time: Float[np.ndarray, " times"]
    sampled: Bool[np.ndarray, "times channels"]
    readings: Float[np.ndarray, "times channels"]
    errors: Float[np.ndarray, "times channels"]
    jacobian: Float[np.ndarray, "entries times channels"]
    residuals: Float[np.ndarray, "times parts"]
    slopes: Float[np.ndarray, "entries times parts"]


class _Excess(NamedTuple):
    """By how much the mean square error of a channel after an origin exceeds its expected variance.

    - `rate`: this excess divided by the squared time from the origin to the end, K^2/s^2.
    - `weight`: the reciprocal of the expected variance.
    """

    channel: str
    rate: float
    weight: float


def estimate_model_error(problem: MatchProblem, estimate: MatchEstimate) -> ModelError:
    """Estimates the error of a matched network from predictions of the recordings' later parts."""
    result = estimate.result
    inside = problem.unknowns.are_inside(result.vector)
    recordings = list(_recordings(problem, result, inside))
    prior = problem.prior_precision[np.ix_(inside, inside)]
    normals = [_normal(recording.slopes) for recording in recordings]
    total = prior + sum(normals)
    excesses: dict[str, list[_Excess]] = {}
    readings: dict[str, list[np.ndarray]] = {}
    for recording, normal in zip(recordings, normals, strict=True):
        others = total - normal
        for origin in ORIGINS:
            for excess in _excesses(recording, origin, others, result.mean_square):
                excesses.setdefault(excess.channel, []).append(excess)
        columns = zip(recording.readings.T, recording.sampled.T, strict=True)
        for name, (column, sampled) in zip(recording.channels, columns, strict=True):
            readings.setdefault(name, []).append(column[sampled])
    joined = {name: np.concatenate(columns) for name, columns in readings.items()}
    known = {name: column for name, column in joined.items() if len(column)}
    return ModelError(
        growth={name: _growth(excesses[name]) for name in known if name in excesses},
        largest={name: MAX_SPREAD * float(column.std()) for name, column in known.items()},
        lowest={name: float(column.min()) for name, column in known.items()},
        highest={name: float(column.max()) for name, column in known.items()},
    )


def _growth(excesses: Sequence[_Excess]) -> float:
    rates = [excess.rate for excess in excesses]
    return float(np.sqrt(np.average(rates, weights=[excess.weight for excess in excesses])))


def _recordings(
    problem: MatchProblem, result: DescentResult, inside: Bool[np.ndarray, " unknowns"]
) -> Iterator[_MatchedRecording]:
    errors: list[RecordingErrors] = result.recording_errors()
    indices = result.objective.layout.entry_indices()
    batches = zip(result.objective.same_shape_batches, result.evaluation.jacobians, strict=True)
    for batch, jacobians in batches:
        for row, position in enumerate(batch.positions):
            experiment, of_recording = problem.experiments[position], errors[position]
            times = slice(len(experiment.time))
            local = np.zeros((len(inside), *np.shape(jacobians)[2:]))
            local[indices[position]] = np.asarray(jacobians[row])
            local = local[inside]
            weights = batch.weights_of(row)
            slopes = weights.weighted(local)
            common_mode = weights.common_mode[times] * of_recording.common_mode
            channel = weights.channel[times] * of_recording.channel
            yield _MatchedRecording(
                experiment.channels,
                experiment.time,
                experiment.sampled & (problem.sample_weights[position] > 0),
                np.nan_to_num(np.asarray(experiment.temperatures)),
                of_recording.channel + of_recording.common_mode[:, None],
                local[:, times],
                np.concatenate([channel, common_mode[:, None]], axis=1),
                np.concatenate([slopes.channel, slopes.common_mode[..., None]], axis=2)[:, times],
            )


def _excesses(
    recording: _MatchedRecording,
    origin: float,
    others: Float[np.ndarray, "entries entries"],
    variance: float,
) -> list[_Excess]:
    """The excess of each channel that has readings after an origin.

    **Arguments:**

    - `others`: the normal matrix of the priors and of the other recordings.
    - `variance`: of a reading about the match, K^2.
    """
    time = recording.time
    span = (1 - origin) * float(time[-1] - time[0])
    later = time > time[-1] - span
    sampled = recording.sampled & later[:, None]
    counts = np.maximum(sampled.sum(axis=0), 1)
    known = others + _normal(recording.slopes[:, ~later])
    after = _flat(recording.slopes[:, later])
    covariance = np.linalg.pinv(known, hermitian=True)
    step = covariance @ (after @ recording.residuals[later].ravel())
    errors = recording.errors + np.tensordot(step, recording.jacobian, 1)
    squares = (errors**2).sum(axis=0, where=sampled) / counts
    result = []
    for place in np.flatnonzero(sampled.any(axis=0)):
        slopes = recording.jacobian[:, sampled[:, place], place]
        expected = variance + float(np.sum(slopes * (covariance @ slopes))) / counts[place]
        # The step is linear: far from the match it says only that the error is large.
        column = recording.readings[recording.sampled[:, place], place]
        square = min(float(squares[place]), float(column.var()))
        rate = max(square - expected, 0.0) / span**2
        result.append(_Excess(recording.channels[place], rate, 1 / expected))
    return result


def _normal(
    slopes: Float[np.ndarray, "entries times parts"],
) -> Float[np.ndarray, "entries entries"]:
    flat = _flat(slopes)
    return flat @ flat.T


def _flat(slopes: Float[np.ndarray, "entries times parts"]) -> Float[np.ndarray, "entries _"]:
    # Also without entries, where all values are at a bound.
    return slopes.reshape(len(slopes), slopes.shape[1] * slopes.shape[2])
