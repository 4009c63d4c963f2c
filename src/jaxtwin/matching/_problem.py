"""The problem of a match: recordings, unknowns and the user's settings, all checked."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count as count_from
from typing import Literal, final

import numpy as np
from jaxtyping import Float

from .._arguments import is_ordered, of_kind
from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..physics._twin import check_twin
from ..rig import CommonError
from ..simulation._initial import Initial
from ..simulation._simulate import checked_channels
from ._linear_prior import LinearPrior
from ._loss import AbstractLoss, checked_loss
from ._masks_and_events import Span, given_events, span_weights
from ._plausible_recording import check_units, check_without_gap
from ._unknowns import Unknowns

Events = Mapping[str, Sequence[float]] | Literal["detect", "none"]
"""Recording -> times of the camera's corrections, s; or whether to detect them."""


@final
@dataclass(frozen=True, eq=False)
class MatchProblem:
    """The checked arguments of a match.

    - `twin`: the start, with the values of the held parameters.
    - `experiments`: the recordings. `names`: the names of their results.
    - `unknowns`: the parameters to match. `groups`: the names of their groups.
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
    groups: tuple[str, ...]
    prior_weights: Float[np.ndarray, " unknowns"]
    linear_prior: LinearPrior
    initial: Initial = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.unknowns.labels(self.names, self.groups)

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
    groups: Sequence[str] = ("",),
    options: SampleOptions = USUAL_OPTIONS,
    initial: Initial = None,
) -> MatchProblem:
    """Checks the recordings and the options of a match, and makes the problem.

    **Arguments:**

    - `twin`: the start of the match.
    - `recordings`: as returned by `named_recordings`.
    - `unknowns`: as returned by `choose_unknowns`.
    - `groups`: the names of the recordings' groups, as returned by `named_groups`.
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
        groups=tuple(groups),
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


def check_distinct(recordings: Mapping[str, Experiment]) -> None:
    """Refuses a recording that is there twice, under whatever names: its samples would count as new
    data, and standard errors would be too small.

    **Raises:** `MatchError` with both names.
    """
    seen: dict[str, str] = {}
    for name, experiment in recordings.items():
        other = seen.setdefault(experiment.fingerprint, name)
        if other != name:
            raise MatchError(
                f"experiments: {name} is the same recording as {other}: expected each once, "
                "because the second adds no information; leave it out"
            )


def named_groups(
    recordings: Mapping[str, Experiment], groups: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """The groups of recordings: their names, and the number of each recording's group.

    **Arguments:**

    - `groups`: the name of each recording's group; by default the groups that the recordings name.

    **Raises:** `MatchError` if there is not a name for each recording.
    """
    several = list(recordings.values())
    if groups is None:
        named = [experiment.group for experiment in several]
        if not any(named):
            return ("",), (0,) * len(named)
    else:
        if not is_ordered(groups):
            raise MatchError(f"groups: expected a name for each recording, got {groups!r}")
        named = list(groups)
        for name in named:
            of_kind("groups", name, str, "text", MatchError)
    if len(named) != len(several) or not all(named):
        raise MatchError(
            "groups: expected a name for each recording, such as its day, got "
            f"{named!r} for {', '.join(recordings)}"
        )
    names = tuple(dict.fromkeys(named))
    return names, tuple(names.index(name) for name in named)


def named_recordings(twin: Twin, experiments: Sequence[Experiment]) -> dict[str, Experiment]:
    """Checks recordings, and returns them by the names of their results.

    **Arguments:**

    - `twin`: a twin of the rig to which they must belong.
    - `experiments`: one or several recordings.

    **Returns:** name -> recording, in order. The name is the recording's own, or its number if it
    has none. A repeated name is followed by its number, or by the next number that is not taken.

    **Raises:** `MatchError` if there is no recording, or one has no temperatures, or a channel of
    one has none, or one has a gap or is in kelvin; `SimulationError` for a recording of another
    rig.
    """
    check_twin("twin", twin, MatchError)
    if not experiments:
        raise MatchError("experiments: expected one or several recordings, got none")
    names: list[str] = []
    for number, experiment in enumerate(experiments, start=1):
        name = experiment.name or f"recording {number}"
        if experiment.temperatures is None or not experiment.channels:
            raise MatchError(f"{name}: expected recorded temperatures, got none")
        checked_channels(twin, experiment)
        if experiment.unsampled:
            raise MatchError(
                f"{name}: channel {experiment.unsampled[0]}: expected at least one sample, got "
                "missing ones only; leave the channel out with Experiment.select"
            )
        check_units(twin, name, experiment)
        check_without_gap(name, experiment)
        names.append(name)
    # Two recordings of one name must not share a row of a table.
    found: list[str] = []
    for number, name in enumerate(names, start=1):
        free = (f"{name} ({other})" for other in count_from(number))
        found.append(
            name if name not in found else next(other for other in free if other not in names)
        )
    return dict(zip(found, experiments, strict=True))
