r"""Values that differ between recordings: of a matched group, of another one, and how much the rig
itself differs.

The value of group $g$ is $u_g = \phi + b_g$, with $\phi \sim N(m, s^2)$ shared by all groups and
$b_g \sim N(0, \tau^2)$. This is a normal hierarchical model with standard deviations $s$ and $\tau$
from the rig file. The match integrates $\phi$ out. Its posterior follows from the values of the $G$
groups (Gelman and others, Bayesian Data Analysis, section 5.4):

$$\phi \mid u \sim N\Big(m + w \sum_g (u_g - m), \; w \tau^2\Big), \qquad
w = \frac{s^2}{\tau^2 + G s^2}$$

The value of a new group is $\phi$ with the additional variance $\tau^2$.
"""

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from ..rig import Parameter
from ._unknowns import Unknowns


@final
class GroupValues(NamedTuple):
    """Expected values of a group, and their uncertainty, on the scale of the optimiser's vector.

    - `rows`: the parameters. `mean`: their expected values.
    - `lift`: the derivatives of these values with respect to the entries of the match's vector.
    - `variance`: the variance of each value given the vector; `shared_variance`: the variance of
      the part that all groups share.
    """

    rows: tuple[Parameter, ...]
    mean: Float[np.ndarray, " rows"]
    lift: Float[np.ndarray, "rows unknowns"]
    variance: Float[np.ndarray, " rows"]
    shared_variance: Float[np.ndarray, " rows"]

    @property
    def values(self) -> dict[str, float]:
        """Name -> mean in the parameter's unit, inside its bounds."""
        pairs = zip(self.rows, self.mean.tolist(), strict=True)
        return {
            row.name: float(np.clip(row.from_entry(entry), row.lower, row.upper))
            for row, entry in pairs
        }

    def covariance(
        self, of_vector: Float[np.ndarray, "unknowns unknowns"]
    ) -> Float[np.ndarray, "rows rows"]:
        """The covariance of the values, given that of the match's vector. A value that was held at
        a bound has none."""
        propagated = self.lift @ np.nan_to_num(of_vector) @ self.lift.T
        return propagated + np.diag(self.variance)


def new_group_values(unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"]) -> GroupValues:
    """The values expected of a group that was not matched, for the parameters that differ between
    groups."""
    rows, places = unknowns.rows_of_groups()
    standard_deviations = np.array(
        [(row.prior_spread, row.group_spread) for row in rows], float
    ).reshape(-1, 2)
    shared, between = np.square(standard_deviations.T)
    count = places.shape[1]
    weight = shared / (between + count * shared)
    lift = np.zeros((len(rows), unknowns.size))
    lift[np.arange(len(rows))[:, None], places] = weight[:, None]
    means = unknowns.prior_means()
    return GroupValues(
        rows=rows,
        mean=means[places[:, 0]] + lift @ (vector - means),
        lift=lift,
        variance=weight * between + between,
        shared_variance=weight * between,
    )


def group_and_shared_values(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], group: int | None
) -> GroupValues:
    """The values that all recordings share, followed by those of a group.

    **Arguments:**

    - `group`: the number of the group, None for a group that was not matched.
    """
    rows, places = unknowns.rows_of_groups()
    shared = [number for number, row in enumerate(unknowns.shared) if row.scope != "group"]
    of_group = new_group_values(unknowns, vector)
    if group is not None:
        lift, none = np.eye(unknowns.size)[places[:, group]], np.zeros(len(rows))
        of_group = GroupValues(rows, vector[places[:, group]], lift, none, none)
    none = np.zeros(len(shared))
    return GroupValues(
        rows=(*(unknowns.shared[number] for number in shared), *rows),
        mean=np.concatenate([vector[shared], of_group.mean]),
        lift=np.concatenate([np.eye(unknowns.size)[shared], of_group.lift]),
        variance=np.concatenate([none, of_group.variance]),
        shared_variance=np.concatenate([none, of_group.shared_variance]),
    )


# Estimates the differences of the rig itself between recordings.
#
# Between recordings a contact may be remounted, a camera moved, or a sink collect dust. The shared
# parameters of recording $i$ are modelled as $\theta + b_i$ with $b_i \sim N(0, \tau^2 S)$, where
# $S$ holds the priors' variances. The single number $\tau$ is estimated from how much more the
# scores of the recordings disagree at the match than their noise explains. This is a random-effects
# model (Laird and Ware, Biometrics 38 (1982) 963-974).
#
# Let $s_i = J_i^T r_i$ be the score of a recording, $I_i = J_i^T J_i$ its information and $M_i =
# J_i^T \Gamma J_i$ the covariance of its noise, all after elimination of the recording's own values
# and of the camera's amplitudes. The matrix $K_{ij} = \delta_{ij} - I_i (\sum_k I_k)^{-1}$ removes
# everything that a common value can explain, also the effect of its prior and of a match that ended
# slightly beside its optimum:
#
# $$K s = K (e + \operatorname{diag}(I_i) b), \qquad
# \operatorname{cov} e = \operatorname{diag}(M_i).$$
#
# The likelihood of $\tau$ is that of a normal distribution. A few recordings contain little
# information on it, and the maximum is often at 0. The estimate is therefore the posterior mean of
# $\tau^2$ with a half-normal prior of $\tau$ (Gelman, Bayesian Analysis 1 (2006) 515-534).

# The scale of the half-normal prior of $\tau$: a quarter of the parameters' own priors.
TAU_SCALE = 0.25

# Values of $\tau$ over which the posterior is summed.
GRID = np.linspace(0.0, 3.0, 601)

# Directions with less than this part of the variance of a recording's score are left out: their
# noise is not known well enough.
MIN_VARIANCE_FRACTION = 1e-4


class RecordingScore(NamedTuple):
    r"""The score of one recording with respect to all unknowns, at the match.

    - `score`: $J^T r$; for the recording's own values it includes the gradient of their priors.
    - `information`: $J^T J$. `noise`: $J^T \Gamma J$.
    """

    score: Float[np.ndarray, " unknowns"]
    information: Float[np.ndarray, "unknowns unknowns"]
    noise: Float[np.ndarray, "unknowns unknowns"]


def estimate_heterogeneity(
    scores: Sequence[RecordingScore],
    prior: Float[np.ndarray, "unknowns unknowns"],
    shared: Int[np.ndarray, " shared"],
    prior_standard_deviations: Float[np.ndarray, " shared"],
) -> float:
    r"""Estimates $\tau$, the heterogeneity of a random-effects model: the standard deviation of
    shared parameters between recordings, as a fraction of their priors' standard deviations.

    **Arguments:**

    - `scores`: the score of each recording.
    - `prior`: the precision of the priors.
    - `shared`: which unknowns are shared by all recordings; the others are eliminated.
    - `prior_standard_deviations`: the standard deviations of the priors. Unknowns without a prior
      have 0 here and are assumed to be the same in all recordings.
    """
    reduced = [
        _without_nuisance(of_recording, prior, shared, prior_standard_deviations)
        for of_recording in scores
    ]
    count, size = len(reduced), len(shared)
    inverse = np.linalg.pinv(
        sum(of_recording.information for of_recording in reduced), hermitian=True
    )
    stacked = np.concatenate([of_recording.information for of_recording in reduced])
    mixing = np.eye(count * size) - np.tile(stacked @ inverse, (1, count))
    by_noise, by_differences = (
        mixing @ _block_diagonal(blocks) @ mixing.T
        for blocks in (
            [of_recording.noise for of_recording in reduced],
            [of_recording.information @ of_recording.information for of_recording in reduced],
        )
    )
    score = mixing @ np.concatenate([of_recording.score for of_recording in reduced])
    variances, directions = np.linalg.eigh(by_noise)
    # With a single recording only rounding errors are left.
    kept = variances > MIN_VARIANCE_FRACTION * max(
        np.trace(of_recording.noise) for of_recording in reduced
    )
    whitened = directions[:, kept] / np.sqrt(variances[kept])
    gains, turned = np.linalg.eigh(whitened.T @ by_differences @ whitened)
    squares = (turned.T @ (whitened.T @ score)) ** 2
    variance = 1 + GRID[:, None] ** 2 * np.maximum(gains, 0.0)
    log_posterior = -0.5 * np.sum(np.log(variance) + squares / variance, axis=1)
    log_posterior -= 0.5 * (GRID / TAU_SCALE) ** 2
    weights = np.exp(log_posterior - log_posterior.max())
    return float(np.sqrt(weights @ GRID**2 / weights.sum()))


def _without_nuisance(
    of_recording: RecordingScore,
    prior: Float[np.ndarray, "unknowns unknowns"],
    shared: Int[np.ndarray, " shared"],
    prior_standard_deviations: Float[np.ndarray, " shared"],
) -> RecordingScore:
    """The efficient score for the shared parameters, in units of their priors' standard deviations.

    The priors of the eliminated values count as noise of this score.
    """
    others = np.setdiff1d(np.arange(len(of_recording.score)), shared)
    normal = of_recording.information + prior
    across = normal[np.ix_(shared, others)]
    eliminate = across @ np.linalg.pinv(normal[np.ix_(others, others)], hermitian=True)
    lift = np.zeros((len(shared), len(of_recording.score)))
    lift[np.arange(len(shared)), shared] = prior_standard_deviations
    lift[:, others] = -prior_standard_deviations[:, None] * eliminate
    of_others = np.zeros_like(prior)
    of_others[np.ix_(others, others)] = prior[np.ix_(others, others)]
    return RecordingScore(
        lift @ of_recording.score,
        lift @ (of_recording.information + of_others) @ lift.T,
        lift @ (of_recording.noise + of_others) @ lift.T,
    )


def _block_diagonal(blocks: Sequence[Float[np.ndarray, "n n"]]) -> Float[np.ndarray, "all all"]:
    size = len(blocks[0])
    whole = np.zeros((len(blocks) * size, len(blocks) * size))
    for number, block in enumerate(blocks):
        part = slice(number * size, (number + 1) * size)
        whole[part, part] = block
    return whole
