"""Reads a saved fit, with or without the recordings to which it was matched."""

import json
import math
import os
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pydantic
from jaxtyping import Float

from ..errors import MatchError, ParameterError
from ..io import Experiment
from ..physics import Twin
from ..rig import Rig, load_rig, parse_rig, parse_toml, parsed_values, read_toml, refuse
from ..simulation import simulate
from ._camera_error import CameraError, Comparison
from ._fit import Fit, Solution, solution_of
from ._fitted_parameters import FittedParameters
from ._loss import AbstractLoss, loaded_loss
from ._noise_model import NoiseModel
from ._objective import recording_weights, shapes_needed
from ._problem import LinearPrior, MatchProblem, independent_prior_weights
from ._recordings import divided
from ._save_fit import FORMAT, StoredFit, StoredRecording, unrolled
from ._uncertainty import Uncertainty, close_pairs, insensitive_labels, physical_covariance
from ._unknowns import Unknowns

STORED_FIT_ADAPTER = pydantic.TypeAdapter(StoredFit)


def load_fit(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str] | None,
    experiments: Experiment | Sequence[Experiment] | None,
) -> Fit:
    """Implements `Fit.load`."""
    return _fit_of_tables(*read_toml(path, ParameterError), rig, experiments)


def fit_of_text(
    text: str,
    source: str,
    rig: Rig | str | os.PathLike[str] | None = None,
    experiments: Experiment | Sequence[Experiment] | None = None,
) -> Fit:
    """The fit in the text of a saved fit; `source` is its name in messages. The other arguments and
    the errors are those of `Fit.load`."""
    tables = parse_toml(text.encode(), source, ParameterError)
    return _fit_of_tables(tables, source, rig, experiments)


def _fit_of_tables(
    data: dict[str, Any],
    source: str,
    rig: Rig | str | os.PathLike[str] | None,
    experiments: Experiment | Sequence[Experiment] | None,
) -> Fit:
    if not isinstance(data.get("fit"), dict):
        _refuse(
            source,
            "fit",
            "expected a file that Fit.save wrote, got one without this table; pass a parameter "
            "file to Twin(rig, path)",
        )
    rig = _rig(source, data["fit"], rig)
    parsed_values(data, source, rig)  # refuses damaged rows
    rows = {name: _row(source, name, data, rig) for name in rig.parameters}
    stored = _stored(source, data["fit"], rows)
    names = tuple(stored.recordings)
    values = [parsed_values(data, source, rig, name) for name in names]
    group_names = tuple(dict.fromkeys(record.group for record in stored.recordings.values()))
    unknowns = _unknowns(rig, stored, group_names)
    _check_own_values(source, data, names, unknowns)
    vector = _vector(unknowns, values)
    known = _uncertainty(source, stored, unknowns, group_names, vector)
    sample_weights = _weights_of_all(source, stored, "sample_weights")
    noise_model = _noise_model(source, stored)
    start = Twin(rig, {name: row.initial for name, row in stored.parameters.items()})
    matched = _recordings(stored, experiments)
    problem = MatchProblem(
        twin=start,
        experiments=matched or (),
        names=names,
        unknowns=unknowns,
        sample_weights=sample_weights,
        events=noise_model.events,
        common_error=rig.common_error,
        loss=_loss(source, stored),
        group_names=group_names,
        prior_weights=independent_prior_weights(unknowns),
        linear_prior=LinearPrior.between_groups(unknowns),
        initial=np.array(stored.initial) if isinstance(stored.initial, tuple) else stored.initial,
    )
    fit = _fit(stored, values, Solution(problem, noise_model, vector), known)
    if matched is None:
        return fit
    pairs = enumerate(zip(fit.twins.values(), matched, strict=True))
    comparisons = tuple(
        _comparison(fit, number, twin, experiment) for number, (twin, experiment) in pairs
    )
    return replace(fit, comparisons=comparisons)


def _rig(source: str, table: dict[str, Any], given: Rig | str | os.PathLike[str] | None) -> Rig:
    """The rig of the fit; raises an error if it is not the one that was matched."""
    for key in ("rig", "rig_file", "rig_fingerprint"):
        if not isinstance(table.get(key), str):
            _refuse(source, f"fit.{key}", f"expected text, got {table.get(key)!r}")
    text, matched = table.get("rig_text"), None
    if isinstance(text, str):
        matched = parse_rig(text.encode(), table["rig_file"])
    if given is None:
        if matched is None:
            _refuse(
                source,
                "fit.rig_text",
                f"expected the text of the rig file, got {text!r}, as for a rig that is not as its "
                "file says; pass Fit.load(path, rig=...)",
            )
        return matched
    rig = given if isinstance(given, Rig) else load_rig(given)
    # Another version may have written another fingerprint of the same text.
    expected = table["rig_fingerprint"] if matched is None else matched.fingerprint
    if rig.fingerprint != expected:
        _refuse(
            source,
            "fit.rig_fingerprint",
            f"the rig {rig.name!r} ({rig.source}) is not the one that was matched, which was "
            f"{table['rig']!r} ({table['rig_file']}), or has changed since; pass it as rig=...",
        )
    return rig


def _row(source: str, name: str, data: dict[str, Any], rig: Rig) -> dict[str, Any]:
    """The row of a fitted parameter, from the parameter table and the rig."""
    table = data.get("parameters")
    row = table.get(name) if isinstance(table, dict) else None
    own = data["fit"].get("parameters")
    more = own.get(name) if isinstance(own, dict) else None
    field, parameter = f"parameters.{name}", rig.parameters[name]
    if not isinstance(row, dict):
        _refuse(source, field, f"expected a row for each parameter of {rig.name}, got {row!r}")
    if not isinstance(more, dict):
        _refuse(source, f"fit.{field}", f"expected the results of the match, got {more!r}")
    if row.get("unit") != parameter.unit:
        _refuse(source, f"{field}.unit", f"expected {parameter.unit!r}, got {row.get('unit')!r}")
    lower, upper = row.get("bounds", (-math.inf, math.inf))
    free, prior = row.get("free", False), row.get("prior")
    known = prior if free is True and isinstance(prior, dict) else {}
    bounded = replace(parameter, lower=lower, upper=upper)
    return more | {
        "name": name,
        "unit": parameter.unit,
        "description": row.get("description", ""),
        "free": free,
        "scope": row.get("scope", "shared"),
        "value": row.get("value"),
        "lower": lower,
        "upper": upper,
        "is_logarithmic": bounded.is_logarithmic,
        "published": rig.parameter_sets.get("published", {}).get(name),
        "prior_value": known.get("value"),
        "prior_spread": known.get("spread"),
        "group_spread": known.get("between_groups"),
    }


def _stored(source: str, table: dict[str, Any], rows: dict[str, dict[str, Any]]) -> StoredFit:
    """The table [fit], checked."""
    if table.get("format") != FORMAT:
        _refuse(source, "fit.format", f"expected {FORMAT}, got {table.get('format')!r}")
    try:
        # Validated as JSON, which is strict about types and accepts lists as tuples.
        text = json.dumps(table | {"parameters": rows}, default=str)
        stored = STORED_FIT_ADAPTER.validate_json(text, strict=True)
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        field = ".".join(map(str, ("fit", *first["loc"])))
        if first["type"] == "missing":
            _refuse(source, field, "expected what every saved fit has here, got none")
        expected = first["msg"].removeprefix("Input should be ")
        _refuse(source, field, f"expected {expected}, got {reprlib.repr(first['input'])}")
    if not stored.recordings:
        _refuse(source, "fit.recordings", "expected a table for each recording, got none")
    kinds = {"noise": stored.noise, "assumed_noise": stored.assumed_noise}
    numbers = {"rmse": stored.rmse, "cost": stored.cost, "camera_error": stored.camera_error}
    numbers |= {
        f"{name}[{n}].{part}": getattr(noise, part)
        for name, pair in kinds.items()
        for n, noise in enumerate(pair)
        for part in ("standard_deviation", "autocorrelation_time")
    }
    for field, number in numbers.items():
        if not 0 <= number < math.inf:
            _refuse(source, f"fit.{field}", f"expected a finite number, 0 or above, got {number}")
    for name, row in stored.parameters.items():
        if not math.isfinite(row.initial):
            field = f"fit.parameters.{name}.initial"
            _refuse(source, field, f"expected a finite number, got {row.initial}")
    return stored


def _fit(
    stored: StoredFit,
    values: Sequence[Mapping[str, float]],
    solution: Solution,
    uncertainty: Uncertainty,
) -> Fit:
    """The fit, without comparisons; `values` are those of each recording."""
    problem, several = solution.problem, list(stored.recordings.values())
    unknowns = problem.unknowns
    own_rows = unknowns.per_group + unknowns.per_recording
    own = [{row.name: own_values[row.name] for row in own_rows} for own_values in values]
    shared = {row.name: values[0][row.name] for row in unknowns.shared}
    return Fit(
        twin=problem.twin.with_values({**shared, **own[0]}),
        recordings=problem.names,
        fingerprints=tuple(record.fingerprint for record in several),
        channels=tuple(record.channels for record in several),
        first_samples=tuple(record.first_sample for record in several),
        parameters=FittedParameters(stored.parameters),
        recording_values=dict(zip(problem.names, own, strict=True)),
        fit_percent={
            (name, channel): percent
            for name, record in stored.recordings.items()
            for channel, percent in record.fit_percent.items()
        },
        rmse=stored.rmse,
        status=stored.status,
        converged=stored.converged,
        history=stored.history,
        optima=stored.optima,
        wall_time=stored.wall_time,
        solver_gap=stored.solver_gap,
        camera_error=stored.camera_error,
        noise=stored.noise,
        uncertainty=uncertainty,
        model_error=stored.model_error,
        cost=stored.cost,
        date=stored.date,
        versions=stored.versions,
        notes=stored.notes,
        comparisons=None,
        _solution=solution,
    )


def _check_own_values(
    source: str, data: Mapping[str, Any], names: Sequence[str], unknowns: Unknowns
) -> None:
    """Refuses a file in which a recording lacks one of its own values."""
    for name in names:
        for row in unknowns.per_group + unknowns.per_recording:
            if row.name not in data.get("recordings", {}).get(name, {}):
                field = f"recordings.{name}.{row.name}"
                _refuse(source, field, "expected the value of each recording, got none")


def _vector(
    unknowns: Unknowns, values: Sequence[Mapping[str, float]]
) -> Float[np.ndarray, " unknowns"]:
    """The optimiser's vector, from the values of each recording."""
    rows = unknowns.shared + unknowns.per_group + unknowns.per_recording
    vector = np.zeros(unknowns.size)
    for indices, own in zip(unknowns.layout.entry_indices(), values, strict=True):
        vector[indices] = [row.to_entry(own[row.name]) for row in rows]
    return vector


def _loss(source: str, stored: StoredFit) -> AbstractLoss | None:
    try:
        return loaded_loss(stored.loss)
    except MatchError as problem:
        _refuse(source, "fit.loss", str(problem))


def _noise_model(source: str, stored: StoredFit) -> NoiseModel:
    return NoiseModel(
        channel=stored.assumed_noise[0],
        common_mode=stored.assumed_noise[1],
        events=tuple(record.events for record in stored.recordings.values()),
        channel_weights=_weights_of_all(source, stored, "channel_weights"),
        common_mode_weights=tuple(
            weights[:, 0] for weights in _weights_of_all(source, stored, "common_mode_weights")
        ),
    )


def _weights_of_all(
    source: str, stored: StoredFit, kind: str
) -> tuple[Float[np.ndarray, "..."], ...]:
    """The weights of one kind, of each recording `(times, columns)`."""
    return tuple(_weights(source, name, kind, record) for name, record in stored.recordings.items())


def _unknowns(rig: Rig, stored: StoredFit, group_names: tuple[str, ...]) -> Unknowns:
    rows = [
        replace(
            rig.parameters[row.name],
            value=row.initial,
            lower=row.lower,
            upper=row.upper,
            free=True,
            scope=row.scope,
            prior_value=row.prior_value,
            prior_spread=row.prior_spread,
            group_spread=row.group_spread,
        )
        for row in stored.parameters.values()
        if row.free
    ]
    return Unknowns.of(
        rows, [group_names.index(record.group) for record in stored.recordings.values()]
    )


def _uncertainty(
    source: str,
    stored: StoredFit,
    unknowns: Unknowns,
    group_names: tuple[str, ...],
    vector: Float[np.ndarray, " unknowns"],
) -> Uncertainty:
    result, size = stored.unknowns, unknowns.size
    labels = unknowns.labels(tuple(stored.recordings), group_names)
    if result.labels != labels:
        _refuse(
            source,
            "fit.unknowns.labels",
            f"expected the free parameters and recordings of the file, {', '.join(labels)}, got "
            f"{', '.join(result.labels)}",
        )
    for name in ("covariance", "inverse_hessian"):
        matrix = getattr(result, name)
        if len(matrix) != size or any(len(row) != size for row in matrix):
            _refuse(source, f"fit.unknowns.{name}", f"expected {size} rows of {size} numbers")
    for name in ("prior_to_data_ratio", "between_recordings"):
        if len(getattr(result, name)) != size:
            _refuse(source, f"fit.unknowns.{name}", f"expected {size} numbers")
    vector_covariance, prior_to_data_ratio = (
        np.array(result.covariance),
        np.array(result.prior_to_data_ratio),
    )
    lost = np.isin(labels, result.undetermined)
    covariance, correlation = physical_covariance(
        vector_covariance, unknowns.value_derivatives(vector), lost
    )
    return Uncertainty(
        labels=labels,
        covariance=covariance,
        correlation=correlation,
        prior_to_data_ratio=prior_to_data_ratio,
        singular_values=np.array(result.singular_values),
        unidentifiable=result.unidentifiable,
        insensitive=insensitive_labels(labels, prior_to_data_ratio),
        collinear=close_pairs(labels, correlation),
        vector_covariance=vector_covariance,
        inverse_hessian=np.array(result.inverse_hessian),
        between_recordings=np.array(result.between_recordings),
    )


def _weights(
    source: str, name: str, kind: str, record: StoredRecording
) -> Float[np.ndarray, "times columns"]:
    columns = 1 if kind == "common_mode_weights" else len(record.channels)
    try:
        return unrolled(getattr(record, kind), record.samples, columns)
    except ValueError as problem:
        _refuse(source, f"fit.recordings.{name}.{kind}", str(problem))


def _recordings(
    stored: StoredFit, experiments: Experiment | Sequence[Experiment] | None
) -> tuple[Experiment, ...] | None:
    """The matched recordings, recognised by their fingerprints."""
    if experiments is None:
        return None
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    # A match divides some recordings at gaps.
    several = [part for gaps in ("hold", "split") for part in divided(given, gaps=gaps)[0]]
    by_content = {experiment.fingerprint: experiment for experiment in several}
    result = []
    for name, record in stored.recordings.items():
        if record.fingerprint not in by_content:
            there = ", ".join(e.name or "one without a name" for e in given) or "none"
            raise MatchError(
                f"experiments: expected the recordings of the fit, got {there}, of which none has "
                f"the contents of {name!r} (fingerprint {record.fingerprint[:12]}...) that was "
                "matched; read them as they were read then"
            )
        result.append(by_content[record.fingerprint])
    return tuple(result)


def _comparison(fit: Fit, number: int, twin: Twin, experiment: Experiment) -> Comparison:
    solution = solution_of(fit)
    problem, noise_model = solution.problem, solution.noise_model
    error = np.zeros(len(experiment.time))
    if problem.common_error is not None:
        run = simulate(twin, experiment, initial=problem.initial)
        count = shapes_needed(problem, noise_model)
        weights = recording_weights(problem, noise_model, number, count)
        # Missing samples have no weight.
        difference = np.nan_to_num(run.temperatures - np.asarray(experiment.temperatures))
        error = np.asarray(weights.shapes) @ np.asarray(weights.split(difference).sizes)
    camera = CameraError(noise_model.events[number], error)
    return Comparison(twin, experiment, problem.initial, camera)


def _refuse(source: str, field: str, message: str) -> NoReturn:
    refuse(source, field, message, ParameterError)
