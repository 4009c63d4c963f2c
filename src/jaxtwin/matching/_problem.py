"""The problem of a match: recordings, unknowns, priors and the user's settings, all checked."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..rig import CommonError
from ..simulation._initial import Initial
from ._loss import AbstractLoss, checked_loss
from ._recordings import Span, given_events, span_weights
from ._unknowns import Unknowns


@final
class LinearPrior(eqx.Module):
    """A prior of linear combinations of unknowns, such as the difference of two of them.

    - `matrix`, `values`: `matrix @ vector - values` has mean 0 and variance 1, independently.
    """

    matrix: Float[np.ndarray | Array, "combinations unknowns"]
    values: Float[np.ndarray | Array, " combinations"]

    @classmethod
    def none(cls, unknowns: int) -> "LinearPrior":
        """A prior without any combination."""
        return cls(np.zeros((0, unknowns)), np.zeros(0))

    @classmethod
    def between_groups(cls, unknowns: Unknowns) -> "LinearPrior":
        r"""The prior that relates the values of several groups.

        The value of a group is the sum of $\phi \sim N(m, s^2)$, which all groups share, and its
        difference, $N(0, \tau^2)$. With $\phi$ integrated out, the values of $G$ groups have the
        covariance $\tau^2 I + s^2 1 1^T$: their mean and their differences from it are independent.
        """
        rows, places = unknowns.per_group, unknowns.group_entries()
        groups = len(places)
        mean = np.full((groups, groups), 1 / groups)
        matrix = np.zeros((groups * len(rows), unknowns.size))
        for number, row in enumerate(rows):
            assert row.prior_spread is not None
            assert row.group_spread is not None
            of_mean = math.hypot(row.group_spread, math.sqrt(groups) * row.prior_spread)
            block = (np.eye(groups) - mean) / row.group_spread + mean / of_mean
            matrix[groups * number : groups * (number + 1), places[:, number]] = block
        return cls(matrix, matrix @ unknowns.prior_means())

    @classmethod
    def normal(
        cls, mean: Float[np.ndarray, " unknowns"], covariance: Float[np.ndarray, "some some"]
    ) -> "LinearPrior":
        """A normal prior of the first unknowns; the others have none."""
        some = len(covariance)
        matrix = np.zeros((some, len(mean)))
        # L L^T = cov, so the rows of the inverse of L are its whitening.
        matrix[:, :some] = np.linalg.inv(np.linalg.cholesky(covariance))
        return cls(matrix, matrix @ mean)


Events = Mapping[str, Sequence[float]] | Literal["detect", "none"]
"""Recording -> times of the camera's corrections, s; or whether to detect them."""


@final
@dataclass(frozen=True, eq=False)
class MatchProblem:
    """The checked arguments of a match.

    - `twin`: the start, with the values of the held parameters.
    - `experiments`: the recordings. `names`: the names of their results.
    - `unknowns`: the parameters to match. `group_names`: the names of their groups.
    - `sample_weights`: weight of each sample of each recording, 0 to 1, from masks and gaps.
    - `events`: times of the camera's corrections in each recording, s; None to detect them.
    - `common_error`: the common error of the camera, None for none.
    - `loss`: the loss of the residuals, None for plain squares.
    - `prior_weights`: the reciprocal of the prior standard deviation of each unknown; 0 without a
      prior, and for unknowns whose prior is in `linear_prior`.
    - `initial`: the temperatures at the start of each run, as `simulate` takes them.
    """

    twin: Twin
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    unknowns: Unknowns
    sample_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    events: tuple[tuple[float, ...], ...] | None
    common_error: CommonError | None
    loss: AbstractLoss | None
    group_names: tuple[str, ...]
    prior_weights: Float[np.ndarray, " unknowns"]
    linear_prior: LinearPrior
    initial: Initial = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.unknowns.labels(self.names, self.group_names)

    @property
    def prior_precision(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """The inverse of the priors' covariance, 0 for unknowns without a prior."""
        linear = np.asarray(self.linear_prior.matrix)
        return np.diag(self.prior_weights**2) + linear.T @ linear

    @property
    def is_weighted(self) -> bool:
        """Whether the scale of the residuals matters, as it does if there are priors."""
        priors = self.unknowns.prior_weights().any()
        return bool(priors) or self.common_error is not None or self.loss is not None

    def labelled(self, vector: Float[np.ndarray, " unknowns"]) -> dict[str, float]:
        """Label -> value in the parameter's unit."""
        values = self.unknowns.to_values(vector).tolist()
        return dict(zip(self.labels, values, strict=True))


@final
@dataclass(frozen=True)
class SampleOptions:
    """The arguments of `match` that determine how its samples count, not checked yet."""

    events: Events | None = None
    masks: Mapping[str, Sequence[Span]] | None = None
    loss: AbstractLoss | None = None


USUAL_OPTIONS = SampleOptions()


def make_match_problem(
    twin: Twin,
    recordings: Mapping[str, Experiment],
    unknowns: Unknowns,
    *,
    group_names: Sequence[str] = ("",),
    options: SampleOptions = USUAL_OPTIONS,
    initial: Initial = None,
) -> MatchProblem:
    """Checks the recordings and the options of a match, and makes the problem.

    **Arguments:**

    - `twin`: the start of the match.
    - `recordings`: as returned by `named_recordings`.
    - `unknowns`: as returned by `choose_unknowns`.
    - `group_names`: the names of the recordings' groups, as returned by `named_groups`.
    - `options`: the options of the samples' weights.
    - `initial`: the temperatures at the start of each run, checked.

    **Raises:** `MatchError` if there are fewer samples than unknowns, if nothing changes in any
    recording, or if events, masks or the loss are invalid.
    """
    events, masks = options.events, options.masks
    weights = tuple(span_weights(recordings, masks))
    samples = sum(int(np.count_nonzero(weight)) for weight in weights)
    if samples <= unknowns.size:
        masked = ", the others are masked" if masks else ""
        raise MatchError(
            f"expected more samples than the {unknowns.size} unknowns, because the noise is "
            f"estimated from the residuals, got {samples} samples{masked}"
        )
    experiments = tuple(recordings.values())
    if not any(map(_is_excited, experiments, weights)):
        raise MatchError(
            f"{', '.join(recordings)}: expected a recording with some excitation, got none: every "
            "duty cycle is 0 and no reading ever changes; add a recording in which a cell is "
            "driven"
        )
    error = twin.rig.common_error
    if events is not None and error is None:
        raise MatchError(
            f"{twin.rig.name}: events: expected None, as the rig file has no table "
            f"[camera.common_error], got {events!r}; add the table"
        )
    if not (events is None or isinstance(events, Mapping) or events in ("detect", "none")):
        raise MatchError(f'events: expected "detect", "none" or recording -> times, got {events!r}')
    none = tuple(() for _ in recordings)
    if isinstance(events, Mapping):
        times = tuple(given_events(recordings, events))
    else:
        detect = error is not None and (error.detect if events is None else events == "detect")
        times = None if detect else none
    return MatchProblem(
        twin=twin,
        experiments=experiments,
        names=tuple(recordings),
        unknowns=unknowns,
        sample_weights=weights,
        events=times,
        common_error=error,
        loss=checked_loss(options.loss),
        group_names=tuple(group_names),
        prior_weights=independent_prior_weights(unknowns),
        linear_prior=LinearPrior.between_groups(unknowns),
        initial=initial,
    )


def independent_prior_weights(unknowns: Unknowns) -> Float[np.ndarray, " unknowns"]:
    """The reciprocal of the prior standard deviation of each entry; 0 for entries without a prior,
    and for values of groups, whose priors are not independent."""
    weights = unknowns.prior_weights()
    weights[unknowns.group_entries()] = 0.0
    return weights


def _is_excited(recording: Experiment, weight: Float[np.ndarray, "times channels"]) -> bool:
    """Whether a recording is driven, or any of its channels changes at samples that count."""
    assert recording.temperatures is not None
    counted = np.where(weight > 0, recording.temperatures, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of channels that are masked throughout
        ranges = np.nanmax(counted, axis=0) - np.nanmin(counted, axis=0)
    return bool(np.any(recording.duty) or np.any(ranges > 0))
