"""Writes a fit to a file: a parameter file, with the tables that `_load_fit` needs besides.

```toml
[parameters]                # and [recordings.NAME]: a parameter file, see `jaxtwin.rig`
R_E = { value = 2.2, unit = "ohm", bounds = [1.0, 4.0], free = true }

[fit]                       # the numbers of the match
rig = "dual-cell"
rmse = 0.21

[fit.parameters.R_E]        # fields that the parameter table does not have
initial = 1.96
standard_error = 0.02

[fit.unknowns]              # the optimiser's vector; positive parameters are logarithms
labels = ["R_E", "T_amb[monday]"]
covariance = [[1e-4, 0.0], [0.0, 1e-2]]

[fit.recordings.monday]
fingerprint = "9f86d081..."
```
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, final

import numpy as np
from jaxtyping import Float

from .._toml_text import toml_inline, toml_key, toml_string
from .._whole_file import check_ending, write_whole_file
from ..errors import ParameterError, RigError
from ..rig import Rig, parameter_file_text
from ..simulation import Initial
from ._descent_result import Iteration, Optimum
from ._fit import Fit, solution_of
from ._fitted_parameters import FittedParameter
from ._loss import saved_loss
from ._model_error import ModelError
from ._noise_model import Noise
from ._start import FirstSample
from ._uncertainty import UnidentifiableDirection

# The version of the tables.
FORMAT = 1

# Fields of a fitted parameter that follow from the parameter table and the rig.
TABLE = {
    "name",
    "unit",
    "description",
    "free",
    "scope",
    "value",
    "lower",
    "upper",
    "is_logarithmic",
    "published",
    "prior_value",
    "prior_spread",
    "group_spread",
}

# Run-length encoded weights of the channels: the number of samples in a row, and their weight.
Stretches = tuple[tuple[int, float], ...]


@final
@dataclass(frozen=True)
class StoredRecording:
    """A recording in a saved fit.

    - `fingerprint`: SHA-256 of its contents. `channels`: their names. `samples`: the number of
      times.
    - `first_sample`: the temperatures with which it begins.
    - `events`: times of the camera's corrections, s. `group`: the name of its group.
    - `fit_percent`: channel -> NRMSE fit, %.
    - `sample_weights`: weights of the samples from masks. `channel_weights`: from masks and the
      loss. `common_mode_weights`: weights of the common mode, from the loss.
    """

    fingerprint: str
    channels: tuple[str, ...]
    samples: int
    first_sample: FirstSample
    events: tuple[float, ...]
    fit_percent: dict[str, float]
    sample_weights: Stretches
    channel_weights: Stretches
    common_mode_weights: Stretches
    group: str = ""


@final
@dataclass(frozen=True)
class StoredUnknowns:
    """The optimiser's vector in a saved fit; see `Uncertainty`.

    - `undetermined`: labels of values with an infinite standard error.
    """

    labels: tuple[str, ...]
    undetermined: tuple[str, ...]
    prior_to_data_ratio: tuple[float, ...]
    singular_values: tuple[float, ...]
    unidentifiable: tuple[UnidentifiableDirection, ...]
    covariance: tuple[tuple[float, ...], ...]
    inverse_hessian: tuple[tuple[float, ...], ...]
    between_recordings: tuple[float, ...]


@final
@dataclass(frozen=True)
class StoredFit:
    """The table [fit] of a saved fit.

    - `rig`, `rig_file`, `rig_fingerprint`: the rig's name, its file, and the digest of its
      contents. `rig_text`: the text of that file; None for a rig that is not as its file says.
    - `noise`: noise of channels and common mode, as estimated at the end. `assumed_noise`: as
      assumed in the weights of the last round.
    - the others: as in `Fit`.
    """

    format: int
    rig: str
    rig_file: str
    rig_fingerprint: str
    date: str
    versions: dict[str, str]
    status: str
    converged: bool
    rmse: float
    cost: float
    wall_time: float
    solver_gap: float
    camera_error: float
    noise: tuple[Noise, Noise]
    assumed_noise: tuple[Noise, Noise]
    unknowns: StoredUnknowns
    recordings: dict[str, StoredRecording]
    parameters: dict[str, FittedParameter]
    history: tuple[Iteration, ...]
    optima: tuple[Optimum, ...]
    rig_text: str | None = None
    loss: dict[str, str | float] | None = None
    model_error: ModelError = field(default_factory=ModelError)
    initial: Literal["steady"] | float | tuple[float, ...] | dict[str, float] | None = None
    notes: tuple[str, ...] = ()


def save_fit(fit: Fit, path: str | os.PathLike[str]) -> None:
    """Implements `Fit.save`."""
    check_ending(path, [".toml"], ParameterError)
    source = os.fspath(path)
    write_whole_file(source, fit_text(fit, source).encode("utf-8", "replace"), ParameterError)


def fit_text(fit: Fit, source: str) -> str:
    """The text of a saved fit; `source` is the name of the file in messages.

    **Raises:** `ParameterError` if a value is no finite number or outside its bounds.
    """
    table = fit.twin.rig.parameters
    rows = [
        replace(
            table[row.name],
            value=row.value,
            lower=row.lower,
            upper=row.upper,
            free=row.free,
            scope=row.scope,
            **_prior(row),
        )
        for row in fit.parameters.values()
    ]
    return parameter_file_text(
        source,
        rows,
        {k: v for k, v in fit.recording_values.items() if v} or None,
        f"{fit.twin.rig.name} matched to {', '.join(fit.recordings)}\n"
        f"mean fit {fit.mean_fit_percent:.2f} %, RMSE {fit.rmse:.4f} K\n{fit.status}",
        _fit_tables(fit),
    )


def _prior(row: FittedParameter) -> dict[str, float | None]:
    """The prior with which a parameter was matched: that of a refit is not the rig's."""
    if not row.free:
        return {}
    return {
        "prior_value": row.prior_value,
        "prior_spread": row.prior_spread,
        "group_spread": row.group_spread,
    }


def _fit_tables(fit: Fit) -> str:
    """The table [fit] with all that belongs to it, as TOML."""
    rig, known, solution = fit.twin.rig, fit.uncertainty, solution_of(fit)
    head = {
        "format": FORMAT,
        "rig": rig.name,
        "rig_file": rig.source,
        "rig_fingerprint": rig.fingerprint,
        "date": fit.date,
        "versions": fit.versions,
        "status": fit.status,
        "converged": fit.converged,
        "rmse": fit.rmse,
        "cost": fit.cost,
        "wall_time": fit.wall_time,
        "solver_gap": fit.solver_gap,
        "camera_error": fit.camera_error,
        "noise": fit.noise,
        "assumed_noise": (solution.noise_model.channel, solution.noise_model.common_mode),
        "loss": saved_loss(solution.problem.loss),
        "initial": _plain_initial(solution.problem.initial),
        "model_error": fit.model_error,
        "history": fit.history,
        "optima": fit.optima,
        "notes": fit.notes or None,
    }
    variances = zip(known.labels, np.diag(known.covariance), strict=True)
    unknowns = {
        "labels": known.labels,
        "undetermined": [label for label, variance in variances if np.isinf(variance)],
        "prior_to_data_ratio": known.prior_to_data_ratio,
        "singular_values": known.singular_values,
        "unidentifiable": known.unidentifiable,
        "covariance": known.vector_covariance,
        "inverse_hessian": known.inverse_hessian,
        "between_recordings": known.between_recordings,
    }
    parts = [_table("fit", head) + _rig_text(rig), _table("fit.unknowns", unknowns)]
    for name, row in fit.parameters.items():
        own = {f.name: getattr(row, f.name) for f in fields(row) if f.name not in TABLE}
        parts.append(_table(f"fit.parameters.{toml_key(name)}", own))
    for number, name in enumerate(fit.recordings):
        parts.append(_table(f"fit.recordings.{toml_key(name)}", _recording(fit, number)))
    return "\n".join(parts)


def _rig_text(rig: Rig) -> str:
    """The text of the rig's file as a key of the table [fit]; nothing for a rig that is not as its
    file says."""
    from ..rig import parse_rig  # with pydantic

    try:
        same = parse_rig(rig.text.encode(), rig.source).fingerprint == rig.fingerprint
    except RigError:
        same = False
    if not same:
        return ""
    # Literally, as people wrote it, where TOML can say that.
    lines = rig.text.replace("\r\n", "\n")
    literal = "'''" not in lines and all(c.isprintable() or c in "\n\t" for c in lines)
    return f"rig_text = '''\n{lines}'''\n" if literal else f"rig_text = {toml_string(rig.text)}\n"


def unrolled(stretches: Stretches, times: int, channels: int) -> Float[np.ndarray, "times columns"]:
    """The weights of each sample, from their run-length encoding.

    **Raises:** `ValueError` if there are more or fewer than `times` by `channels`.
    """
    counts = [max(count, 0) for count, _ in stretches]
    if sum(counts) != times * channels:
        raise ValueError(f"expected weights of {times * channels} samples, got {sum(counts)}")
    return np.repeat([weight for _, weight in stretches], counts).reshape(channels, times).T


def _plain_initial(initial: Initial) -> str | float | list[float] | dict[str, float] | None:
    if initial is None or isinstance(initial, str):
        return initial
    if isinstance(initial, Mapping):
        return {name: float(value) for name, value in initial.items()}
    values = np.asarray(initial, float)
    return values.tolist()


def _recording(fit: Fit, number: int) -> dict[str, Any]:
    name, solution = fit.recordings[number], solution_of(fit)
    noise_model = solution.noise_model
    percent = {c: value for (recording, c), value in fit.fit_percent.items() if recording == name}
    return {
        "fingerprint": fit.fingerprints[number],
        "channels": fit.channels[number],
        "samples": len(noise_model.common_mode_weights[number]),
        "first_sample": fit.first_samples[number],
        "events": fit.events[name],
        "group": fit.groups[name],
        "fit_percent": percent,
        "sample_weights": _stretches(solution.problem.sample_weights[number]),
        "channel_weights": _stretches(noise_model.channel_weights[number]),
        "common_mode_weights": _stretches(noise_model.common_mode_weights[number][:, None]),
    }


def _stretches(weights: Float[np.ndarray, "times channels"]) -> Stretches:
    flat = weights.T.ravel()
    starts = np.flatnonzero(np.append(True, flat[1:] != flat[:-1]))
    counts = np.diff(np.append(starts, flat.size))
    return tuple(zip(counts.tolist(), flat[starts].tolist(), strict=True))


def _table(name: str, entries: Mapping[str, Any]) -> str:
    """A table with a line for each key; None is left out. A long list, such as the iterations or
    the rows of a matrix, has a line for each entry."""
    lines = [f"[{name}]"]
    for key, value in entries.items():
        plain = _plain(value)
        if plain is None:
            continue
        if isinstance(plain, list) and plain and isinstance(plain[0], list | dict):
            rows = "".join(f"    {toml_inline(entry)},\n" for entry in plain)
            lines.append(f"{toml_key(key)} = [\n{rows}]")
        else:
            lines.append(f"{toml_key(key)} = {toml_inline(plain)}")
    return "\n".join(lines) + "\n"


def _plain(value: object) -> Any:
    """Arrays and tuples as lists, records as dictionaries."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(entry) for entry in value]
    return value
