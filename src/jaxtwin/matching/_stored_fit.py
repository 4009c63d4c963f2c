"""What a saved fit holds besides its parameter file: the table [fit].

The declaration serves both ways. By `STORED_FIT_ADAPTER` pydantic makes from a `StoredFit` what
`_save_fit` writes, and checks and converts what `_load_fit` has read.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, final

import numpy as np
import pydantic
from jaxtyping import Float
from pydantic import (
    AfterValidator,
    Field,
    FiniteFloat,
    GetPydanticSchema,
    NonNegativeInt,
    PlainSerializer,
)

from ..errors import RigError
from ..rig import Format, Rig, parse_rig
from ..simulation import Initial
from ._descent_result import Iteration, Optimum
from ._fit import Fit, solution_of
from ._loss import saved_loss
from ._model_error import ModelError
from ._noise_model import Noise
from ._start import FirstSample
from ._uncertainty import UnidentifiableDirection

# The version of the tables.
FORMAT: Format = 1

# Run-length encoded weights of the channels, one channel after the other: the number of samples in
# a row, and their weight.
Stretches = list[tuple[NonNegativeInt, float]]


def saved_as(
    form: Any, read: Callable[..., object], write: Callable[[Any], object]
) -> GetPydanticSchema:
    """Says as which type a file holds a field, and how this is converted when it is read and
    written."""
    converted = Annotated[form, AfterValidator(read), PlainSerializer(write)]
    return GetPydanticSchema(lambda _, schema_of: schema_of(converted))


def _by_label(numbers: list[float] | list[list[float]], info: Any) -> Float[np.ndarray, "..."]:
    """An array with an entry for each label, or a row and a column for each.

    `info` is pydantic's `ValidationInfo`, a protocol that has no check at run time. Its `data` are
    the fields before this one, without those that are damaged.
    """
    count = len(info.data.get("labels", ()))
    rows = [row for row in numbers if isinstance(row, list)]
    if {len(numbers), *map(len, rows)} != {count}:
        expected = f"{count} rows of {count} numbers" if rows else f"{count} numbers"
        raise ValueError(f"expected {expected}, one for each of the labels")
    return np.array(numbers)


def _unrolled(stretches: Stretches, info: Any) -> Float[np.ndarray, "times columns"]:
    """The weights of each sample, from their run-length encoding."""
    times, channels = info.data.get("samples", 0), info.data.get("channels", ())
    columns = 1 if info.field_name == "common_mode_weights" else len(channels)
    counts = [count for count, _ in stretches]
    # Compared before they are unrolled: the counts of a damaged file may be enormous.
    if sum(counts) != times * columns:
        raise ValueError(f"expected weights of {times * columns} samples, got {sum(counts)}")
    flat = np.repeat(np.array([weight for _, weight in stretches]), np.array(counts, int))
    return flat.reshape(columns, times).T


def _stretches(weights: Float[np.ndarray, "times columns"]) -> Stretches:
    """The run-length encoding of the weights of each sample."""
    flat = weights.T.ravel()
    starts = np.flatnonzero(np.append(True, flat[1:] != flat[:-1]))
    counts = np.diff(np.append(starts, flat.size))
    return list(zip(counts.tolist(), flat[starts].tolist(), strict=True))


def _not_negative(noise: Noise) -> Noise:
    if not all(0 <= number < np.inf for number in vars(noise).values()):
        raise ValueError(f"expected finite numbers, 0 or above, got {noise}")
    return noise


Vector = Annotated[
    Float[np.ndarray, " entries"], saved_as(list[float], np.array, np.ndarray.tolist)
]
LabelledVector = Annotated[
    Float[np.ndarray, " values"], saved_as(list[float], _by_label, np.ndarray.tolist)
]
LabelledMatrix = Annotated[
    Float[np.ndarray, "values values"], saved_as(list[list[float]], _by_label, np.ndarray.tolist)
]
Weights = Annotated[Float[np.ndarray, "times _columns"], saved_as(Stretches, _unrolled, _stretches)]
Magnitude = Annotated[FiniteFloat, Field(ge=0)]
CheckedNoise = Annotated[Noise, AfterValidator(_not_negative)]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class StoredUnknowns:
    """The table [fit.unknowns]: the optimiser's vector; see `Uncertainty`.

    - `undetermined`: labels of values with an infinite standard error.
    - `covariance`: of the vector.
    """

    labels: tuple[str, ...]
    undetermined: tuple[str, ...]
    prior_to_data_ratio: LabelledVector
    singular_values: Vector
    unidentifiable: tuple[UnidentifiableDirection, ...]
    covariance: LabelledMatrix
    inverse_hessian: LabelledMatrix
    between_recordings: LabelledVector


@final
@dataclass(frozen=True, kw_only=True)
class StoredParameter:
    """A table [fit.parameters.NAME]: the fields of a `FittedParameter` that neither the rig nor
    [parameters] has."""

    initial: FiniteFloat
    at_bound: bool
    standard_error: float
    prior_distance: float | None = None
    prior_to_data_ratio: float = np.nan
    warnings: tuple[str, ...] = ()
    relative_standard_error: float = np.nan
    interval: tuple[float, float] = (np.nan, np.nan)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class StoredRecording:
    """A table [fit.recordings.NAME].

    - `fingerprint`: SHA-256 of the recording's contents. `channels`: their names. `samples`: the
      number of times.
    - `first_sample`: the temperatures with which it begins.
    - `events`: times of the camera's corrections, s. `group`: the name of its group.
    - `fit_percent`: channel -> NRMSE fit, %.
    - `sample_weights`: weights of the samples from masks. `channel_weights`: from masks and the
      loss. `common_mode_weights`: weights of the common mode, a single column, from the loss.
    """

    fingerprint: str
    channels: tuple[str, ...]
    samples: int
    first_sample: FirstSample
    events: tuple[float, ...]
    group: str = ""
    fit_percent: dict[str, float]
    sample_weights: Weights
    channel_weights: Weights
    common_mode_weights: Weights


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class StoredFit:
    """The table [fit] of a saved fit.

    - `rig`, `rig_file`, `rig_fingerprint`: the rig's name, its file, and the digest of its
      contents. `rig_text`: the text of that file; None for a rig that is not as its file says.
    - `noise`: noise of channels and common mode, as estimated at the end. `assumed_noise`: as
      assumed in the weights of the last round.
    - the others: as in `Fit` and `MatchProblem`.
    """

    format: Format
    rig: str
    rig_file: str
    rig_fingerprint: str
    date: str
    versions: Mapping[str, str]
    status: str
    converged: bool
    rmse: Magnitude
    cost: Magnitude
    wall_time: float
    solver_gap: float
    camera_error: Magnitude
    noise: tuple[CheckedNoise, CheckedNoise]
    assumed_noise: tuple[CheckedNoise, CheckedNoise]
    loss: dict[str, str | float] | None = None
    initial: Literal["steady"] | float | tuple[float, ...] | dict[str, float] | None = None
    model_error: ModelError = field(default_factory=ModelError)
    history: tuple[Iteration, ...]
    optima: tuple[Optimum, ...]
    notes: tuple[str, ...] = ()
    rig_text: str | None = None
    unknowns: StoredUnknowns
    parameters: dict[str, StoredParameter]
    recordings: Annotated[dict[str, StoredRecording], Field(min_length=1)]


STORED_FIT_ADAPTER = pydantic.TypeAdapter(StoredFit)

# The fields of a fit that its table holds as they are.
SAME_FIELDS = {each.name for each in fields(StoredFit)} & {each.name for each in fields(Fit)}
SAME_FIELDS -= {"parameters", "recordings"}  # which have another form there


def stored_fit(fit: Fit) -> StoredFit:
    """The table [fit] of a fit.

    **Raises:** `MatchError` for a loss that is not registered.
    """
    rig, problem, noise_model = fit.twin.rig, solution_of(fit).problem, solution_of(fit).noise_model
    own_fields = [each.name for each in fields(StoredParameter)]
    return StoredFit(
        format=FORMAT,
        rig=rig.name,
        rig_file=rig.source,
        rig_fingerprint=rig.fingerprint,
        assumed_noise=(noise_model.channel, noise_model.common_mode),
        loss=saved_loss(problem.loss),
        initial=_plain_initial(problem.initial),
        rig_text=_rig_text(rig),
        unknowns=_unknowns(fit),
        parameters={
            name: StoredParameter(**{key: getattr(row, key) for key in own_fields})
            for name, row in fit.parameters.items()
        },
        recordings={name: _recording(fit, number) for number, name in enumerate(fit.recordings)},
        **{name: getattr(fit, name) for name in SAME_FIELDS},
    )


def _plain_initial(
    initial: Initial,
) -> Literal["steady"] | float | tuple[float, ...] | dict[str, float] | None:
    if initial is None:
        return None
    if isinstance(initial, str):
        return "steady"
    if isinstance(initial, Mapping):
        return {name: float(value) for name, value in initial.items()}
    values = np.asarray(initial, float)
    return tuple(values.tolist()) if values.ndim else float(values)


def _rig_text(rig: Rig) -> str | None:
    """The text of the rig's file; None for a rig that is not as its file says."""
    try:
        same = parse_rig(rig.text.encode(), rig.source).fingerprint == rig.fingerprint
    except RigError:
        same = False
    return rig.text.replace("\r\n", "\n") if same else None


def _unknowns(fit: Fit) -> StoredUnknowns:
    known = fit.uncertainty
    variances = zip(known.labels, np.diag(known.covariance), strict=True)
    return StoredUnknowns(
        labels=known.labels,
        undetermined=tuple(label for label, variance in variances if np.isinf(variance)),
        prior_to_data_ratio=known.prior_to_data_ratio,
        singular_values=known.singular_values,
        unidentifiable=known.unidentifiable,
        covariance=known.vector_covariance,
        inverse_hessian=known.inverse_hessian,
        between_recordings=known.between_recordings,
    )


def _recording(fit: Fit, number: int) -> StoredRecording:
    name, solution = fit.recordings[number], solution_of(fit)
    noise_model = solution.noise_model
    return StoredRecording(
        fingerprint=fit.fingerprints[number],
        channels=fit.channels[number],
        samples=len(noise_model.common_mode_weights[number]),
        first_sample=fit.first_samples[number],
        events=fit.events[name],
        group=fit.groups[name],
        fit_percent={c: value for (of, c), value in fit.fit_percent.items() if of == name},
        sample_weights=solution.problem.sample_weights[number],
        channel_weights=noise_model.channel_weights[number],
        common_mode_weights=noise_model.common_mode_weights[number][:, None],
    )
