r"""The generalised likelihood ratio of Willsky and Jones (IEEE Trans. Automatic Control 21 (1976)
108-112): size and onset of all faults from the innovations of one healthy filter.

A multiple $m$ of a fault from some time on moves the error of the filter by $m e$ and the whitened
innovations by $m g$,

$$e \leftarrow F e + b, \qquad g = S e + W d, \qquad e \leftarrow e - K g,$$

with the steps $F$, the gains $K$ and the whitened slopes $S$ of the filter, and what the fault adds
to a step, $b$, and to the readings, $d$ (`_signatures`). For innovations $w$ with
$D = \sum g^T w$ and $C = \sum g^T g$ the estimate of $m$ is $D / C$ with the variance $1 / C$. With
a normal prior of variance $\sigma^2$ the logarithm of the ratio of the likelihoods with and without
the fault is

$$\frac{D^2 \sigma^2}{2 (1 + C \sigma^2)} - \frac{1}{2} \log(1 + C \sigma^2).$$

Each sample begins a candidate for the onset, which takes the place of an older one: first of one
whose ratios stay small beyond the patience of the prior, otherwise of the one with the smallest
ratio times the number of samples it stands for.
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .._compilation import persistent_jit
from ..observers import ExtendedKalmanFilter, FilterSamples, GaussianUpdate, KalmanState
from ._signatures import Suspected, is_held, of_readings, of_step

# The number of onsets that are considered at a time.
CANDIDATES = 28

# The number of samples for which a candidate is kept in any case.
YOUNG = 10

# The standard deviation of the shifts of whitened innovations by a fault that no model knows.
SHIFT_SIGMAS = 1.0

# The age in samples from which candidates count in the statistics of healthy recordings.
MATURE = 30


class Prior(NamedTuple):
    """What is known beforehand.

    - `spread`: the standard deviation of the multiple of each fault.
    - `is_one_sided`: whether it is above 0.
    - `inflation`: the variance of the standardised statistic of each fault in healthy recordings, 1
      if the innovations are as expected; last that of a fault that no model knows.
    - `patience`, `forget_below`: the age in samples at which a candidate goes, unless the logarithm
      of one of its ratios is above that. No twin is so exact that hours of innovations may be added
      up: in the end they show that the rig has other losses than its twin.
    """

    spread: Float[np.ndarray | Array, " faults"]
    is_one_sided: Bool[np.ndarray | Array, " faults"]
    inflation: Float[np.ndarray | Array, " faults_and_other"]
    patience: Float[ArrayLike, ""]
    forget_below: Float[ArrayLike, ""]


class LikelihoodRatios(NamedTuple):
    """What is said of each fault at a time.

    - `evidence`: the logarithm of the ratio of the likelihoods with it, from any onset on, in
      multiples of a sample, and without any fault; last that of a fault that no model knows.
    - `ratio`: the same for the likeliest onset alone.
    - `onset`: the number of the likeliest first sample. `earliest`, `latest`: the first and the
      last of the candidates that are within 95 %.
    - `multiple`, `spread`: of the fault from there on, and the standard deviation.
    """

    evidence: Float[Array, " faults_and_other"]
    ratio: Float[Array, " faults_and_other"]
    onset: Int[Array, " faults_and_other"]
    earliest: Int[Array, " faults_and_other"]
    latest: Int[Array, " faults_and_other"]
    multiple: Float[Array, " faults"]
    spread: Float[Array, " faults"]


@final
class Candidates(eqx.Module):
    """The onsets that are considered.

    - `onset`: the number of the first sample, -1 for none.
    - `error`: $e$, in float32, which is enough for what is linear in it and forgotten.
    - `score`, `information`: $D$ and $C$.
    - `sums`, `counts`: of the whitened innovations of each channel since the onset.
    - `held`: the readings at the onset, K.
    """

    onset: Int[Array, " candidates"]
    error: Float[Array, "state candidates faults"]
    score: Float[Array, "candidates faults"]
    information: Float[Array, "candidates faults"]
    sums: Float[Array, "candidates channels"]
    counts: Float[Array, "candidates channels"]
    held: Float[Array, "candidates channels"]

    @classmethod
    def none(cls, state: int, faults: int, channels: int) -> "Candidates":
        """No candidate."""
        empty = jnp.zeros((CANDIDATES, channels))
        table = jnp.zeros((CANDIDATES, faults))
        return cls(
            jnp.full(CANDIDATES, -1), jnp.zeros((state, CANDIDATES, faults), jnp.float32), table,
            table, empty, empty, empty,
        )  # fmt: skip

    def begun(
        self, number: Int[Array, ""], readings: Float[Array, " channels"], place: Int[Array, ""]
    ) -> "Candidates":
        """With one that begins now in a place."""
        return Candidates(
            self.onset.at[place].set(number),
            self.error.at[:, place].set(0.0),
            self.score.at[place].set(0.0),
            self.information.at[place].set(0.0),
            self.sums.at[place].set(0.0),
            self.counts.at[place].set(0.0),
            self.held.at[place].set(readings),
        )


class Signature(NamedTuple):
    """What faults do to a filter.

    - `error`: the error of its state after a sample, $e$.
    - `seen`: the change of the whitened readings, $g$.
    """

    error: Float[Array, "state candidates faults"]
    seen: Float[Array, "readings candidates faults"]


def signature(
    kalman: ExtendedKalmanFilter,
    faults: Suspected,
    before: KalmanState,
    error: Float[Array, "state candidates faults"],
    held: Float[Array, "candidates channels"],
    sample: FilterSamples,
) -> tuple[Signature, GaussianUpdate]:
    """What faults do to the healthy filter at a sample, and what the sample says to it.

    **Arguments:**

    - `before`, `error`: the state of the filter after the sample before, and its error then.
    - `held`: the readings at which channels are stuck, K.
    """
    model = kalman.model
    predicted, step = kalman.linearised_step(before, sample.duty, sample.dt, sample.levels)
    commands = before.commands.given(jnp.asarray(sample.duty), kalman.spacing)
    used = jnp.isfinite(jnp.asarray(sample.readings))
    result = kalman.measurement_update(predicted, sample.readings, used, sample.ambient)
    added = of_step(
        model, faults, before.mean, before.duty, commands, jnp.asarray(sample.dt), sample.levels
    )
    away = jnp.where(used, held - model.read(predicted.mean).mean, 0.0)
    direct = of_readings(model, faults, predicted.mean)
    direct = direct + is_held(faults, len(used)) * away[..., None]  # (candidates channels faults)
    transition, decay, added, slope, gain, whitening, direct = (
        part.astype(error.dtype)
        for part in (
            step.driven, step.decay, added, result.slope, result.gain,
            whitening_of(kalman, result), direct,
        )
    )  # fmt: skip
    size, count, columns = error.shape
    driven, flat = len(transition), error.reshape(size, -1)
    moved = jnp.concatenate([transition @ flat[:driven], decay[:, None] * flat[driven:]])
    moved = (moved.reshape(size, count, columns) + added[:, None]).reshape(size, -1)
    seen = jnp.einsum("rc,mcf->rmf", whitening, direct)
    seen = slope @ moved + seen.reshape(len(slope), -1)
    moved = moved - gain @ seen
    shape = (count, columns)
    return Signature(moved.reshape(size, *shape), seen.reshape(len(seen), *shape)), result


def advance(
    kalman: ExtendedKalmanFilter,
    faults: Suspected,
    before: KalmanState,
    candidates: Candidates,
    sample: FilterSamples,
) -> Candidates:
    """The candidates after a sample that follows a state of the healthy filter."""
    (error, seen), result = signature(
        kalman, faults, before, candidates.error, candidates.held, sample
    )
    return Candidates(
        candidates.onset,
        error,
        candidates.score + jnp.einsum("r,rmf->mf", result.whitened, seen),
        candidates.information + (seen**2).sum(axis=0),
        candidates.sums + result.whitened[1:],
        candidates.counts + jnp.isfinite(jnp.asarray(sample.readings)),
        candidates.held,
    )


def whitening_of(
    kalman: ExtendedKalmanFilter, update: GaussianUpdate
) -> Float[Array, "readings channels"]:
    """The derivatives of the whitened readings with respect to errors of the channels."""
    layout = kalman.model.layout
    if layout.channels:
        return update.slope[:, layout.of("channels")]
    common = layout.of("common").start
    return update.slope[:, common : common + 1]


def log_ratios(prior: Prior, candidates: Candidates) -> Float[Array, "candidates faults_and_other"]:
    """The logarithms of the likelihood ratios of all candidates."""
    inflation = jnp.asarray(prior.inflation)
    score, information = (
        part / inflation[:-1] for part in (candidates.score, candidates.information)
    )
    variance = jnp.asarray(prior.spread) ** 2
    precision = 1 + information * variance
    ratio = 0.5 * score**2 * variance / precision - 0.5 * jnp.log(precision)
    # The mean of the multiple as a multiple of its standard deviation.
    above = score * jnp.sqrt(variance / precision)
    above = jax.scipy.special.log_ndtr(above) + np.log(2.0)
    ratio = ratio + jnp.where(jnp.asarray(prior.is_one_sided), above, 0.0)
    sums, counts = candidates.sums / inflation[-1], candidates.counts / inflation[-1]
    precision = 1 + counts * SHIFT_SIGMAS**2
    other = 0.5 * sums**2 * SHIFT_SIGMAS**2 / precision - 0.5 * jnp.log(precision)
    return jnp.concatenate([ratio, other.sum(axis=1, keepdims=True)], axis=1)


def likelihood_ratios(prior: Prior, candidates: Candidates) -> LikelihoodRatios:
    """What all candidates say together."""
    each = log_ratios(prior, candidates)
    spans = _spans(candidates.onset)
    weights = jnp.where(candidates.onset[:, None] >= 0, each + jnp.log(spans)[:, None], -jnp.inf)
    evidence = jax.scipy.special.logsumexp(weights, axis=0)
    best = jnp.argmax(weights, axis=0)
    faults = jnp.arange(each.shape[1] - 1)
    information = jnp.maximum(candidates.information[best[:-1], faults], 1e-300)
    # The shortest set of candidates of 95 %: what is likelier than each of it has less than that.
    # Sorting them takes longer than all else that is said here.
    is_likelier = weights[:, None] > weights[None]
    shares = jnp.exp(weights - evidence)
    is_inside = jnp.where(is_likelier, shares[:, None], 0.0).sum(axis=0) < 0.95
    onsets = candidates.onset[:, None]
    return LikelihoodRatios(
        evidence=evidence,
        ratio=each[best, jnp.arange(each.shape[1])],
        onset=candidates.onset[best],
        earliest=jnp.where(is_inside, onsets, jnp.iinfo(onsets.dtype).max).min(axis=0),
        latest=jnp.where(is_inside, onsets, -1).max(axis=0),
        multiple=candidates.score[best[:-1], faults] / information,
        spread=jnp.sqrt(jnp.asarray(prior.inflation)[:-1] / information),
    )


def _spans(onset: Int[Array, " candidates"]) -> Float[Array, " candidates"]:
    """The number of samples for which each candidate stands: half of the way to its neighbours."""
    order = jnp.argsort(onset)
    sorted_onsets = onset[order].astype(float)
    before = jnp.concatenate([sorted_onsets[:1], sorted_onsets[:-1]])
    after = jnp.concatenate([sorted_onsets[1:], sorted_onsets[-1:]])
    before = jnp.where(before < 0, sorted_onsets, before)
    width = jnp.maximum((after - before) / 2, 1.0)
    return jnp.zeros_like(width).at[order].set(width)


def _replaced(
    prior: Prior, candidates: Candidates, number: Int[Array, ""], by_age: Bool[Array, ""]
) -> Int[Array, ""]:
    """The index of the candidate that a new one replaces."""
    onset = candidates.onset
    ratio = log_ratios(prior, candidates).max(axis=1)
    is_late = (number - onset > prior.patience) & (ratio < prior.forget_below)
    value = jnp.where(is_late, -jnp.inf, ratio + jnp.log(_spans(onset)))
    value = jnp.where(by_age, onset, value)
    is_young = (number - onset < YOUNG) & ~by_age
    return jnp.argmin(jnp.where(onset < 0, -jnp.inf, jnp.where(is_young, jnp.inf, value)))


class RatioInputs(NamedTuple):
    """What the ratio needs of each sample.

    - `before`: the state of the healthy filter after the sample before.
    - `sample`: the sample. `begins`: whether a fault may begin with it.
    """

    before: KalmanState
    sample: FilterSamples
    begins: Bool[np.ndarray | Array, " samples"]


@persistent_jit
def ratios(
    kalman: ExtendedKalmanFilter, faults: Suspected, prior: Prior, inputs: RatioInputs
) -> LikelihoodRatios:
    """What is said of all faults after each sample."""

    def take(
        candidates: Candidates, at: tuple[Int[Array, ""], RatioInputs]
    ) -> tuple[Candidates, LikelihoodRatios]:
        now = _taken(kalman, faults, prior, candidates, *at, jnp.asarray(False))
        return now, likelihood_ratios(prior, now)

    none = Candidates.none(kalman.model.layout.size, len(faults.drift), len(kalman.model.columns))
    numbers = jnp.arange(len(inputs.begins))
    return jax.lax.scan(take, none, (numbers, inputs))[1]


@persistent_jit
def healthy_squares(
    kalman: ExtendedKalmanFilter, faults: Suspected, prior: Prior, inputs: RatioInputs
) -> tuple[Float[Array, " faults_and_other"], Float[Array, " faults_and_other"]]:
    """The sums of the squared standardised statistics of healthy innovations, 1 on average if the
    innovations are as expected, and their numbers."""

    def take(
        candidates: Candidates, at: tuple[Int[Array, ""], RatioInputs]
    ) -> tuple[Candidates, tuple[Array, Array]]:
        number, given = at
        now = _taken(kalman, faults, prior, candidates, number, given, jnp.asarray(True))
        used = (now.onset >= 0) & (number - now.onset >= MATURE)
        used = used & jnp.isfinite(jnp.asarray(given.sample.readings)).any()
        known = now.information > 1e-12
        squares = jnp.where(known, now.score**2 / jnp.where(known, now.information, 1.0), 0.0)
        other = (now.sums**2 / jnp.maximum(now.counts, 1.0)).mean(axis=1, keepdims=True)
        both = jnp.concatenate([squares, other], axis=1)
        counts = jnp.concatenate([known, jnp.ones_like(other, bool)], axis=1) & used[:, None]
        return now, (jnp.where(counts, both, 0.0).sum(axis=0), counts.sum(axis=0).astype(float))

    none = Candidates.none(kalman.model.layout.size, len(faults.drift), len(kalman.model.columns))
    numbers = jnp.arange(len(inputs.begins))
    squares, counts = jax.lax.scan(take, none, (numbers, inputs))[1]
    return squares.sum(axis=0), counts.sum(axis=0)


def _taken(
    kalman: ExtendedKalmanFilter,
    faults: Suspected,
    prior: Prior,
    candidates: Candidates,
    number: Int[Array, ""],
    given: RatioInputs,
    by_age: Bool[Array, ""],
) -> Candidates:
    """The candidates after a sample, with one that begins with it."""
    place = _replaced(prior, candidates, number, by_age)
    readings = kalman.model.from_degC(jnp.asarray(given.sample.readings))
    begun = candidates.begun(number, jnp.nan_to_num(readings), place)
    candidates = jax.tree.map(lambda new, old: jnp.where(given.begins, new, old), begun, candidates)
    return advance(kalman, faults, given.before, candidates, given.sample)
