"""The problem of a match: recordings, unknowns, priors and the user's settings, all checked."""

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._arguments import mapping_of, names_of
from .._name_suggestions import did_you_mean
from ..errors import MatchError, ParameterError
from ..io import Experiment
from ..physics import Twin
from ..rig import CommonError, Parameter
from ..simulation import Initial
from ._loss import AbstractLoss, checked_loss
from ._recordings import Span, given_events, span_weights
from ._unknowns import Unknowns

# The smallest spread of a prior, and the reciprocal of the largest: their squares must be finite
# and positive.
MIN_PRIOR_SPREAD = 1e-100

# The smallest number of times with readings: of fewer nobody can tell noise from misfit.
MIN_TIMES = 10


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


# Recording -> times of the camera's corrections, s; or whether to detect them.
Events = Mapping[str, Sequence[float]] | Literal["detect", "none"]


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


@final
@dataclass(frozen=True)
class ParameterChoice:
    """The arguments of `match` that change the rig's parameter table, not checked yet.

    - `free`: the free parameters, in place of those that the table marks as free.
    - `fixed`: parameters to hold.
    - `shared`, `per_recording`: parameters that are free in addition, with one value for all
      recordings or a value for each, whatever their scope in the table.
    - `bounds`: bounds that replace those of the table, name -> (lower, upper) in the parameter's
      unit.
    """

    free: Iterable[str] | None = None
    fixed: Iterable[str] = ()
    shared: Iterable[str] = ()
    per_recording: Iterable[str] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None


AS_IN_THE_TABLE = ParameterChoice()


def choose_unknowns(
    twin: Twin, group_numbers: Sequence[int], choice: ParameterChoice = AS_IN_THE_TABLE
) -> Unknowns:
    """Chooses the unknowns of a match: the rig's parameter table, changed by a choice.

    **Arguments:**

    - `twin`: its values are the start of the match.
    - `group_numbers`: the number of each recording's group, counted from 0.
    - `choice`: the changes of the table.

    **Raises:** `ParameterError` for unknown names and for a parameter with several values;
    `MatchError` if a name has contradictory roles, or has bounds without being free; if bounds
    exclude the value or the prior's centre, or change the meaning of the prior's spread; if that
    spread is too small or too large; or if nothing is left free.
    """
    table = twin.rig.parameters
    twin.numbers_si  # noqa: B018 - refuses a parameter with several values
    if isinstance(choice.free, Mapping):
        raise MatchError(
            f"free: expected one name or several, got values beside them; free them by name and "
            f"give bounds as bounds={dict(choice.free)!r}"
        )
    free = None if choice.free is None else set(names_of("free", choice.free, MatchError))
    fixed = set(names_of("fixed", choice.fixed, MatchError))
    shared = set(names_of("shared", choice.shared, MatchError))
    per_recording = set(names_of("per_recording", choice.per_recording, MatchError))
    bounds = {} if choice.bounds is None else choice.bounds
    mapping_of("bounds", bounds, "name -> (lower, upper)", MatchError)
    keywords = {
        "free": free or set(),
        "fixed": fixed,
        "shared": shared,
        "per_recording": per_recording,
        "bounds": set(bounds),
    }
    for keyword, names in keywords.items():
        unknown = sorted(names - set(table))
        if unknown:
            raise ParameterError(
                f"{twin.rig.name}: {keyword}: expected some of the parameters {', '.join(table)}, "
                f"got {', '.join(unknown)}{did_you_mean(unknown, table)}"
            )
    opposites = (
        ("free", "fixed"),
        ("shared", "fixed"),
        ("per_recording", "fixed"),
        ("shared", "per_recording"),
    )
    for keyword, other in opposites:
        both = sorted(keywords[keyword] & keywords[other])
        if both:
            raise MatchError(
                f"{', '.join(both)}: expected in either {keyword} or {other}, got in both"
            )
    chosen = {
        name: row
        for name, row in table.items()
        if name not in fixed
        and (name in shared | per_recording or (row.free if free is None else name in free))
    }
    if not chosen:
        raise MatchError(
            f"{twin.rig.name}: no free parameter; set free = true in the rig file's table or pass "
            "free=[...]"
        )
    held = sorted(set(bounds) - set(chosen))
    if held:
        raise MatchError(
            f"bounds: expected some of the free parameters {', '.join(chosen)}, got "
            f"{', '.join(held)}; free it or leave its bounds out"
        )
    rows = []
    for name, row in chosen.items():
        scope = "recording" if name in per_recording else "shared" if name in shared else row.scope
        limits = bounds.get(name, (row.lower, row.upper))
        bounded = _bounded(row, float(twin.values[name]), limits)
        rows.append(replace(bounded, free=True, scope=scope))
    return Unknowns.of(rows, group_numbers)


def _bounded(row: Parameter, value: float, bounds: tuple[float, float]) -> Parameter:
    """A parameter with a start value and bounds that do not change the meaning of its prior."""
    lower, upper = _pair(row.name, bounds)
    given = f"{lower:g} to {upper:g} {row.unit}".rstrip()
    if not lower <= value <= upper or lower == upper:
        raise MatchError(
            f"{row.name}: expected a start within its bounds, {lower:g} to {upper:g}, got "
            f"{value:g} {row.unit}; move the start or the bounds"
        )
    if row.prior_value is not None and not lower <= row.prior_value <= upper:
        raise MatchError(
            f"{row.name}: expected bounds that contain the centre of the prior, "
            f"{row.prior_value:g}, got {given}"
        )
    if (
        row.prior_spread is not None
        and not MIN_PRIOR_SPREAD <= row.prior_spread <= 1 / MIN_PRIOR_SPREAD
    ):
        raise MatchError(
            f"{row.name}: expected a prior spread of {MIN_PRIOR_SPREAD:g} to "
            f"{1 / MIN_PRIOR_SPREAD:g}, got "
            f"{row.prior_spread:g}; hold a parameter that is known, and leave the prior out where "
            "nothing is known"
        )
    bounded = replace(row, value=value, lower=lower, upper=upper)
    if row.prior_spread is not None and bounded.is_logarithmic != row.is_logarithmic:
        kept = "above 0" if row.is_logarithmic else "with a lower one of 0 or less"
        kind = "relative" if row.is_logarithmic else f"in {row.unit or 'its unit'}"
        raise MatchError(
            f"{row.name}: expected bounds {kept}, because the prior's spread is {kind}, got {given}"
        )
    return bounded


def _pair(name: str, bounds: object) -> tuple[float, float]:
    """Two numbers in order; they may be infinite."""
    try:
        pair = np.asarray(bounds)
    except ValueError:  # of different lengths
        pair = np.array(None)
    if pair.dtype.kind not in "iuf" or pair.shape != (2,) or not pair[0] < pair[1]:
        raise MatchError(
            f"{name}: bounds: expected (lower, upper), numbers in that order, got {bounds!r}"
        )
    return float(pair[0]), float(pair[1])


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

    **Raises:** `MatchError` if there are fewer samples than unknowns or than `MIN_TIMES` times, if
    nothing changes in any recording, or if events, masks or the loss are invalid.
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
    read_times = sum(int(np.count_nonzero(weight.any(axis=1))) for weight in weights)
    if read_times < MIN_TIMES:
        raise MatchError(
            f"{', '.join(recordings)}: expected readings at {MIN_TIMES} or more times, because the "
            f"noise is estimated from how residuals follow each other, got {read_times}"
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
