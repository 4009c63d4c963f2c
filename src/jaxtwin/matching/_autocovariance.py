r"""The autocovariance of the noise in the residuals of a match, and its effect on the values.

The noise of a kind is modelled as the sum of white noise and exponentially correlated noise with
time constants of 1, 2, 4, ... samples, up to a tenth of a recording:

$$\Gamma_{ts} = \sum_j \theta_j \rho_j^{|t - s|}, \qquad \theta_j \ge 0$$

The effect of this noise on the matched values is $J^T \Gamma J$, not $J^T J$ times a single
variance: a slow sensitivity is affected by the slow part of the noise, a fast one by the rest.

The residuals are not this noise. The match removes from them what its unknowns $u$, among them the
amplitudes of the camera's shapes, can imitate. With $A = J^T J + P$,

$$r = (1 - J A^{-1} J^T) \varepsilon + \text{(the same for the priors)}$$

and the slow part is reduced most. With a robust loss, the residuals are their influences $\psi(r)$,
which change with the unknowns by the loss's curvature $\psi'(r)$: not at all for an outlier of
Huber's loss. With $D$ the diagonal matrix of the curvatures, and the noise $\varepsilon$ that of
$\psi$ (Huber 1981, chapter 7),

$$A = J^T D J + P, \qquad \psi = (1 - D J A^{-1} J^T) \varepsilon$$

The variances $\theta$ are therefore estimated by comparing the periodogram of the residuals with
its expected value, which is linear in $\theta$ (debiased Whittle likelihood: Sykulski, Olhede,
Guillaumin, Lilly and Early, Biometrika 106 (2019) 251-266). The likelihood is maximised by scoring:
least squares with weights that follow from the last $\theta$.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ._noise_model import Noise

# The longest time constant as a part of the longest recording. Slower noise cannot be distinguished
# from a change of a parameter.
MAX_TIME_CONSTANT_FRACTION = 0.1

# The largest number of updates of the weights in the search for the variances; few are needed.
UPDATES = 50


@final
@dataclass(frozen=True, eq=False)
class ResidualSeries:
    r"""Weighted residuals of one recording whose noise is of one kind.

    - `kind`: the number of the kind. `recording`: the number of the recording.
    - `residuals`: the residuals, `(times, channels)`, with a robust loss $\psi(r)$.
    - `slopes`: derivatives of the residuals $r$ with respect to some of the unknowns.
    - `entries`: the positions of these unknowns in the vector.
    - `curvature`: the curvature of the loss; by Huber's, 0 for outliers and 1 for all others.
    - `roots`: square roots of the samples' weights from masks, by which residuals and slopes are
      multiplied.
    - `channels`: the number of channels at a time, averaged over the times that have any;
      `independent`: the number of independent channels that they amount to, one less where their
      mean was subtracted.
    """

    kind: int
    recording: int
    residuals: Float[np.ndarray, "times channels"]
    slopes: Float[np.ndarray, "times channels entries"]
    entries: Int[np.ndarray, " entries"]
    curvature: Float[np.ndarray, "times channels"]
    roots: Float[np.ndarray, "times channels"]
    channels: float
    independent: float

    @property
    def curved_slopes(self) -> Float[np.ndarray, "times channels entries"]:
        r"""$D J$: derivatives of $\psi(r)$ with respect to the unknowns."""
        return self.slopes * self.curvature[..., None]

    def dependent_part(self) -> "ResidualSeries":
        """Returns the series with derivatives only for the unknowns on which it depends."""
        depends = self.slopes.any(axis=(0, 1))
        return replace(self, slopes=self.slopes[..., depends], entries=self.entries[depends])


@final
@dataclass(frozen=True, eq=False)
class AutocorrelatedNoise:
    r"""White noise plus first-order autoregressive noise: the variances $\theta$ and the $\rho$ of
    its parts, 0 for the white one."""

    variances: Float[np.ndarray, " parts"]
    rho: Float[np.ndarray, " parts"]

    def noise(self, scale: float) -> Noise:
        """The standard deviation times `scale`, and the autocorrelation time, samples."""
        variance = float(self.variances.sum())
        density = float(self.variances @ ((1 + self.rho) / (1 - self.rho)))
        return Noise(scale * variance**0.5, density / variance if variance > 0 else 1.0)


def fit_noise(
    all_series: Sequence[ResidualSeries],
    inverse: Float[np.ndarray, "unknowns unknowns"],
    known: Float[np.ndarray, "unknowns unknowns"],
) -> tuple[tuple[AutocorrelatedNoise, ...], Float[np.ndarray, "unknowns unknowns"]]:
    r"""Estimates the noise of each kind, and computes $\sum J^T \Gamma J$ over all residuals.

    **Arguments:**

    - `all_series`: the residuals, at least one series.
    - `inverse`: $A^{-1}$.
    - `known`: $P$, the precision of the priors.
    """
    kinds = 1 + max(series.kind for series in all_series)
    rho = _fading(max(len(series.residuals) for series in all_series))
    # Each entry belongs to a kind and a part of its noise: J^T Gamma J for a variance of 1, and the
    # expected periodogram of all residuals.
    meats = np.zeros((kinds, len(rho), *known.shape))
    own = [np.zeros((len(rho), len(_bands(series)))) for series in all_series]
    for series, expected in zip(all_series, own, strict=True):
        _add_own(series, rho, inverse, meats[series.kind], expected)
    flat = meats.reshape(kinds * len(rho), *known.shape)  # no unknowns where all are at bounds
    passed = np.concatenate([flat, known[None]])
    passed = inverse @ passed @ inverse
    expected, observed, counts = [], [], []
    for series, direct in zip(all_series, own, strict=True):
        table = _through_unknowns(series, passed)
        table[series.kind * len(rho) : (series.kind + 1) * len(rho)] += direct
        expected.append(table)
        observed.append(_in_bands(_power(series.residuals), series))
        counts.append(series.independent * np.diff(np.append(_bands(series), _count(series))))
    theta = _variances(
        np.concatenate(expected, axis=1),
        np.concatenate(observed),
        np.concatenate(counts),
    )
    meat = np.tensordot(theta, flat, 1)
    return tuple(
        AutocorrelatedNoise(variances, rho) for variances in theta.reshape(kinds, -1)
    ), meat


def noise_in_unknowns(
    series: ResidualSeries, noise: AutocorrelatedNoise
) -> Float[np.ndarray, "entries entries"]:
    r"""$J^T \Gamma J$ of one series, for the unknowns on which it depends."""
    total = np.zeros((len(series.entries), len(series.entries)))
    present = noise.variances > 0
    answers = _autocorrelated(series, noise.rho[present])
    for variance, answer in zip(noise.variances[present], answers, strict=True):
        total += variance * np.tensordot(series.slopes, answer, ([0, 1], [0, 1]))
    return total


def apply_autocorrelation(
    rho: Float[np.ndarray, " parts"], table: Float[np.ndarray, "times ..."]
) -> Iterator[Float[np.ndarray, "times ..."]]:
    r"""Computes $\sum_s \rho^{|t - s|} x_s$ for each $\rho$ as a product of spectra. The table is
    padded so that its two ends do not interact."""
    times = len(table)
    length = 1 << (2 * times - 1).bit_length()
    lags = np.minimum(np.arange(length), length - np.arange(length))
    spectrum = np.fft.rfft(table, length, axis=0)
    for part in rho:
        if part == 0:
            yield table
            continue
        gain = np.fft.rfft(part**lags).real.reshape(-1, *[1] * (table.ndim - 1))
        yield np.fft.irfft(gain * spectrum, length, axis=0)[:times]


def _autocorrelated(
    series: ResidualSeries, rho: Float[np.ndarray, " parts"]
) -> Iterator[Float[np.ndarray, "times channels entries"]]:
    r"""$\Gamma J$ of one series, for noise of each $\rho$ with a variance of 1."""
    roots = series.roots[..., None]
    return (answer * roots for answer in apply_autocorrelation(rho, roots * series.slopes))


def _fading(times: int) -> Float[np.ndarray, " parts"]:
    memories = 2.0 ** np.arange(
        max(0, np.floor(np.log2(max(1.0, MAX_TIME_CONSTANT_FRACTION * times))) + 1)
    )
    return np.append(0.0, np.exp(-1 / memories))


def _add_own(
    series: ResidualSeries,
    rho: Float[np.ndarray, " parts"],
    inverse: Float[np.ndarray, "unknowns unknowns"],
    meats: Float[np.ndarray, "parts unknowns unknowns"],
    expected: Float[np.ndarray, "parts bands"],
) -> None:
    r"""Adds the $J^T \Gamma J$ of one series, and the contribution of its own noise to its expected
    periodogram: the direct term, and twice the cross term with the part that the unknowns
    absorb."""
    at = np.ix_(series.entries, series.entries)
    moved = np.fft.rfft(series.curved_slopes, axis=0) @ inverse[at]
    times = len(series.roots)
    overlap = np.fft.irfft(np.abs(np.fft.rfft(series.roots, 2 * times, axis=0)) ** 2, axis=0)
    overlap = overlap[:times].sum(axis=1) * series.independent / series.channels
    for number, (part, answer) in enumerate(zip(rho, _autocorrelated(series, rho), strict=True)):
        meats[number][at] += np.tensordot(series.slopes, answer, ([0, 1], [0, 1]))
        lags = overlap * part ** np.arange(times)
        # Folded: lag k and lag k - times meet at the frequencies of the recording.
        power = 2 * np.fft.rfft(lags).real - lags[0]
        crossed = np.sum(moved * np.fft.rfft(answer, axis=0).conj(), axis=(1, 2)).real
        expected[number] = _in_bands(power - 2 * crossed, series)


def _through_unknowns(
    series: ResidualSeries, covariances: Float[np.ndarray, "parts unknowns unknowns"]
) -> Float[np.ndarray, "parts bands"]:
    """The contribution of errors of the unknowns to the periodogram of a series."""
    spectra = np.fft.rfft(series.curved_slopes, axis=0)
    split = np.split(spectra, _bands(series)[1:])
    products = np.stack([np.tensordot(s.conj(), s, ([0, 1], [0, 1])).real for s in split])
    some = covariances[:, series.entries[:, None], series.entries[None, :]]
    return np.tensordot(some, products, ([1, 2], [1, 2]))


def _variances(
    expected: Float[np.ndarray, "rows bands"],
    observed: Float[np.ndarray, " bands"],
    counts: Float[np.ndarray, " bands"],
) -> Float[np.ndarray, " parts"]:
    r"""Finds the $\theta$ with the largest likelihood by iteratively reweighted least squares.

    The last row of `expected` is the contribution of the priors and has a factor of 1.
    """
    from scipy.optimize import nnls  # which takes a third of a second to import

    parts, known = np.maximum(expected[:-1], 0.0), np.maximum(expected[-1], 0.0)
    theta, model = np.zeros(len(parts)), np.maximum(observed, 1e-3 * observed.max())
    if not observed.any():
        return theta
    for _ in range(UPDATES):
        weights = np.sqrt(counts) / model
        before = theta
        theta, _ = nnls((parts * weights).T, (observed - known) * weights, maxiter=100 * len(parts))
        if np.abs(theta - before).max() <= 1e-6 * theta.max():
            break
        model = np.maximum(theta @ parts + known, 1e-9 * observed.max())
    return theta


def _power(residuals: Float[np.ndarray, "times channels"]) -> Float[np.ndarray, " frequencies"]:
    return np.sum(np.abs(np.fft.rfft(residuals, axis=0)) ** 2, axis=1)


def _count(series: ResidualSeries) -> int:
    return len(series.residuals) // 2 + 1


def _bands(series: ResidualSeries) -> Int[np.ndarray, " bands"]:
    """The first frequency of each band: bands of a single frequency at the low end, wider ones
    above."""
    growing = np.floor(1.12 ** np.arange(np.log(_count(series)) / np.log(1.12)))
    return np.unique(np.append(0, growing - 1)).astype(int)


def _in_bands(
    values: Float[np.ndarray, " frequencies"], series: ResidualSeries
) -> Float[np.ndarray, " bands"]:
    return np.add.reduceat(values, _bands(series))
