r"""The autocovariance of the noise behind the residuals of a match, and what it does to the values.

Noise of a kind is a sum of white noise and of noise that fades with memories of 1, 2, 4, ...
samples, up to a tenth of a recording:

$$\Gamma_{ts} = \sum_j \theta_j \rho_j^{|t - s|}, \qquad \theta_j \ge 0$$

A sensitivity that is slow meets such noise where it is strong, one that is fast meets the rest of
it: what the noise does to the matched values is $J^T \Gamma J$, not $J^T J$ times one number.

The residuals are not that noise. A match takes away from them what its unknowns $u$, the sizes of
the camera's shapes among them, can imitate: with $A = J^T J + P$

$$r = (1 - J A^{-1} J^T) \varepsilon + \text{(the same for what is known beforehand)}$$

and what is slow suffers most. The variances $\theta$ are therefore found by comparing the
residuals' periodogram with the one that is expected of such residuals, which is linear in
$\theta$ (debiased Whittle likelihood: Sykulski, Olhede, Guillaumin, Lilly and Early, Biometrika
106 (2019) 251-266), by scoring: least squares whose weights follow from the last $\theta$.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ._noise import Noise

LONGEST = 0.1
"""Of the longest recording: noise that stays for longer cannot be told from a parameter."""

UPDATES = 50
"""Of the weights in the search for the variances, at most; few are needed."""


@final
@dataclass(frozen=True, eq=False)
class Series:
    """Weighted residuals of one recording whose noise is of one kind.

    - `kind`: number of the kind. `recording`: number of the recording.
    - `residuals`: `(times, channels)`.
    - `slopes`: their derivatives in some of the unknowns; `entries`: which those are.
    - `roots`: of the weights of the samples, by which residuals and slopes are multiplied.
    - `channels`: how many there are at a time, on average over the times at which there is more
      than nothing; `independent`: how many independent ones they amount to, one less where their
      mean was taken away.
    """

    kind: int
    recording: int
    residuals: Float[np.ndarray, "times channels"]
    slopes: Float[np.ndarray, "times channels entries"]
    entries: Int[np.ndarray, " entries"]
    roots: Float[np.ndarray, "times channels"]
    channels: float
    independent: float

    def dependent_part(self) -> "Series":
        """The same series with derivatives in those unknowns alone on which it depends."""
        depends = self.slopes.any(axis=(0, 1))
        return replace(self, slopes=self.slopes[..., depends], entries=self.entries[depends])


@final
@dataclass(frozen=True, eq=False)
class Mixture:
    """Noise of one kind: variances $\\theta$ and $\\rho$ of its parts, 0 for the white one."""

    variances: Float[np.ndarray, " parts"]
    rho: Float[np.ndarray, " parts"]

    def noise(self, scale: float) -> Noise:
        """Its standard deviation times `scale`, and how many samples count as one."""
        variance = float(self.variances.sum())
        density = float(self.variances @ ((1 + self.rho) / (1 - self.rho)))
        return Noise(scale * variance**0.5, density / variance if variance > 0 else 1.0)


def fit_noise(
    all_series: Sequence[Series],
    inverse: Float[np.ndarray, "unknowns unknowns"],
    known: Float[np.ndarray, "unknowns unknowns"],
) -> tuple[tuple[Mixture, ...], Float[np.ndarray, "unknowns unknowns"]]:
    r"""The noise of each kind, and $\sum J^T \Gamma J$ over all residuals.

    **Arguments:**

    - `all_series`: the residuals, at least one.
    - `inverse`: $A^{-1}$.
    - `known`: $P$, one over the variances of what is known beforehand.
    """
    kinds = 1 + max(series.kind for series in all_series)
    rho = _fading(max(len(series.residuals) for series in all_series))
    # One part of the noise of one kind each: J^T Gamma J for a variance of 1, and the periodogram
    # that is expected of all residuals.
    meats = np.zeros((kinds, len(rho), *known.shape))
    own = [np.zeros((len(rho), len(_bands(series)))) for series in all_series]
    for series, expected in zip(all_series, own, strict=True):
        _add_own(series, rho, inverse, meats[series.kind], expected)
    flat = meats.reshape(kinds * len(rho), *known.shape)  # no unknowns where all are at bounds
    passed = np.concatenate([flat, known[None]])
    passed = inverse @ passed @ inverse
    expected, seen, counts = [], [], []
    for series, direct in zip(all_series, own, strict=True):
        table = _through_unknowns(series, passed)
        table[series.kind * len(rho) : (series.kind + 1) * len(rho)] += direct
        expected.append(table)
        seen.append(_in_bands(_power(series.residuals), series))
        counts.append(series.independent * np.diff(np.append(_bands(series), _count(series))))
    theta = _variances(
        np.concatenate(expected, axis=1),
        np.concatenate(seen),
        np.concatenate(counts),
    )
    meat = np.tensordot(theta, flat, 1)
    return tuple(Mixture(variances, rho) for variances in theta.reshape(kinds, -1)), meat


def noise_in_unknowns(series: Series, noise: Mixture) -> Float[np.ndarray, "entries entries"]:
    r"""$J^T \Gamma J$ of one series, in the unknowns on which it depends."""
    total = np.zeros((len(series.entries), len(series.entries)))
    for variance, rho in zip(noise.variances, noise.rho, strict=True):
        if variance > 0:
            answer = (
                apply_autocorrelation(rho, series.roots[..., None] * series.slopes)
                * series.roots[..., None]
            )
            total += variance * np.tensordot(series.slopes, answer, ([0, 1], [0, 1]))
    return total


def apply_autocorrelation(
    rho: float, table: Float[np.ndarray, "times ..."]
) -> Float[np.ndarray, "times ..."]:
    r"""$\sum_s \rho^{|t - s|} x_s$: a product of spectra, over so many times that no end of the
    table meets the other."""
    if rho == 0:
        return table
    times = len(table)
    length = 1 << (2 * times - 1).bit_length()
    lags = np.minimum(np.arange(length), length - np.arange(length))
    gain = np.fft.rfft(rho**lags).real.reshape(-1, *[1] * (table.ndim - 1))
    return np.fft.irfft(gain * np.fft.rfft(table, length, axis=0), length, axis=0)[:times]


def _fading(times: int) -> Float[np.ndarray, " parts"]:
    memories = 2.0 ** np.arange(max(0, np.floor(np.log2(max(1.0, LONGEST * times))) + 1))
    return np.append(0.0, np.exp(-1 / memories))


def _add_own(
    series: Series,
    rho: Float[np.ndarray, " parts"],
    inverse: Float[np.ndarray, "unknowns unknowns"],
    meats: Float[np.ndarray, "parts unknowns unknowns"],
    expected: Float[np.ndarray, "parts bands"],
) -> None:
    """Adds one series' $J^T \\Gamma J$, and to its expected periodogram what its own noise does
    there: once directly and twice crossed with what the unknowns take away."""
    at = np.ix_(series.entries, series.entries)
    moved = np.fft.rfft(series.slopes, axis=0) @ inverse[at]
    times = len(series.roots)
    overlap = np.fft.irfft(np.abs(np.fft.rfft(series.roots, 2 * times, axis=0)) ** 2, axis=0)
    overlap = overlap[:times].sum(axis=1) * series.independent / series.channels
    for number, part in enumerate(rho):
        answer = (
            apply_autocorrelation(part, series.roots[..., None] * series.slopes)
            * series.roots[..., None]
        )
        meats[number][at] += np.tensordot(series.slopes, answer, ([0, 1], [0, 1]))
        lags = overlap * part ** np.arange(times)
        # Folded: lag k and lag k - times meet at the frequencies of the recording.
        power = 2 * np.fft.rfft(lags).real - lags[0]
        crossed = np.sum(moved * np.fft.rfft(answer, axis=0).conj(), axis=(1, 2)).real
        expected[number] = _in_bands(power - 2 * crossed, series)


def _through_unknowns(
    series: Series, covariances: Float[np.ndarray, "parts unknowns unknowns"]
) -> Float[np.ndarray, "parts bands"]:
    """The periodogram that a series gets from unknowns that are off."""
    spectra = np.fft.rfft(series.slopes, axis=0)
    split = np.split(spectra, _bands(series)[1:])
    products = np.stack([np.tensordot(s.conj(), s, ([0, 1], [0, 1])).real for s in split])
    some = covariances[:, series.entries[:, None], series.entries[None, :]]
    return np.tensordot(some, products, ([1, 2], [1, 2]))


def _variances(
    expected: Float[np.ndarray, "rows bands"],
    seen: Float[np.ndarray, " bands"],
    counts: Float[np.ndarray, " bands"],
) -> Float[np.ndarray, " parts"]:
    """$\\theta$ with the largest likelihood, by least squares with weights that follow from it.

    The last row of `expected` is what is known beforehand and has a factor of 1.
    """
    from scipy.optimize import nnls  # which takes a third of a second to import

    parts, known = np.maximum(expected[:-1], 0.0), np.maximum(expected[-1], 0.0)
    theta, model = np.zeros(len(parts)), np.maximum(seen, 1e-3 * seen.max())
    if not seen.any():
        return theta
    for _ in range(UPDATES):
        weights = np.sqrt(counts) / model
        before = theta
        theta, _ = nnls((parts * weights).T, (seen - known) * weights, maxiter=100 * len(parts))
        if np.abs(theta - before).max() <= 1e-6 * theta.max():
            break
        model = np.maximum(theta @ parts + known, 1e-9 * seen.max())
    return theta


def _power(residuals: Float[np.ndarray, "times channels"]) -> Float[np.ndarray, " frequencies"]:
    return np.sum(np.abs(np.fft.rfft(residuals, axis=0)) ** 2, axis=1)


def _count(series: Series) -> int:
    return len(series.residuals) // 2 + 1


def _bands(series: Series) -> Int[np.ndarray, " bands"]:
    """First frequency of each band: single ones where they are low, wider ones above."""
    growing = np.floor(1.12 ** np.arange(np.log(_count(series)) / np.log(1.12)))
    return np.unique(np.append(0, growing - 1)).astype(int)


def _in_bands(
    values: Float[np.ndarray, " frequencies"], series: Series
) -> Float[np.ndarray, " bands"]:
    return np.add.reduceat(values, _bands(series))
