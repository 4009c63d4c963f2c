"""Reads a saved fit, with or without the recordings to which it was matched."""

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NoReturn, TypeVar

import numpy as np
import pydantic
from jaxtyping import Float

from ..errors import MatchError, ParameterError
from ..io import Experiment
from ..physics import Twin
from ..rig import (
    ParameterTable,
    Rig,
    load_rig,
    parse_rig,
    parse_toml,
    parsed_values,
    read_toml,
    refuse,
    validation_message,
)
from ..simulation import simulate
from ._camera_error import CameraError, Comparison
from ._fit import Fit, Solution, solution_of
from ._fitted_parameters import FittedParameter, FittedParameters, matched_parameter
from ._loss import AbstractLoss, loaded_loss
from ._noise_model import NoiseModel
from ._objective import recording_weights, shapes_needed
from ._problem import LinearPrior, MatchProblem, independent_prior_weights
from ._recordings import divided
from ._stored_fit import SAME_FIELDS, STORED_FIT_ADAPTER, StoredFit, StoredUnknowns
from ._uncertainty import Uncertainty, close_pairs, insensitive_labels, physical_covariance
from ._unknowns import Unknowns

PARAMETERS_ADAPTER = pydantic.TypeAdapter(dict[str, ParameterTable])

Checked = TypeVar("Checked")


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
    stored = _checked(STORED_FIT_ADAPTER.validate_json, data["fit"], source, "fit")
    rig = _rig(source, stored, rig)
    parsed_values(data, source, rig)  # refuses damaged rows
    rows = _checked(PARAMETERS_ADAPTER.validate_json, data["parameters"], source, "parameters")
    parameters = _fitted_parameters(source, rows, stored, rig)
    records = tuple(stored.recordings.values())
    names = tuple(stored.recordings)
    values = [parsed_values(data, source, rig, name) for name in names]
    group_names = tuple(dict.fromkeys(record.group for record in records))
    unknowns = _unknowns(rig, parameters, [group_names.index(record.group) for record in records])
    _check_own_values(source, data, names, unknowns)
    noise_model = NoiseModel(
        channel=stored.assumed_noise[0],
        common_mode=stored.assumed_noise[1],
        events=tuple(record.events for record in records),
        channel_weights=tuple(record.channel_weights for record in records),
        common_mode_weights=tuple(record.common_mode_weights[:, 0] for record in records),
    )
    matched = _recordings(stored, experiments)
    problem = MatchProblem(
        twin=Twin(rig, {name: row.initial for name, row in parameters.items()}),
        experiments=matched or (),
        names=names,
        unknowns=unknowns,
        sample_weights=tuple(record.sample_weights for record in records),
        events=noise_model.events,
        common_error=rig.common_error,
        loss=_loss(source, stored),
        group_names=group_names,
        prior_weights=independent_prior_weights(unknowns),
        linear_prior=LinearPrior.between_groups(unknowns),
        initial=np.array(stored.initial) if isinstance(stored.initial, tuple) else stored.initial,
    )
    solution = Solution(problem, noise_model, _vector(unknowns, values))
    uncertainty = _uncertainty(source, stored.unknowns, solution)
    fit = _fit(stored, parameters, values, solution, uncertainty)
    if matched is None:
        return fit
    pairs = enumerate(zip(fit.twins.values(), matched, strict=True))
    comparisons = tuple(
        _comparison(fit, number, twin, experiment) for number, (twin, experiment) in pairs
    )
    return replace(fit, comparisons=comparisons)


def _checked(
    validate_json: Callable[..., Checked], table: object, source: str, field: str
) -> Checked:
    try:
        # Validated as JSON, which is strict about types and accepts lists as tuples.
        return validate_json(json.dumps(table, default=str), strict=True)
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        _refuse(source, ".".join(map(str, (field, *first["loc"]))), validation_message(first))


def _rig(source: str, stored: StoredFit, given: Rig | str | os.PathLike[str] | None) -> Rig:
    """The rig of the fit; raises an error if it is not the one that was matched."""
    matched = None
    if stored.rig_text is not None:
        matched = parse_rig(stored.rig_text.encode(), stored.rig_file)
    if given is None:
        if matched is None:
            _refuse(
                source,
                "fit.rig_text",
                "expected the text of the rig file, got none, as for a rig that is not as its file "
                "says; pass Fit.load(path, rig=...)",
            )
        return matched
    rig = given if isinstance(given, Rig) else load_rig(given)
    # Another version may have written another fingerprint of the same text.
    expected = stored.rig_fingerprint if matched is None else matched.fingerprint
    if rig.fingerprint != expected:
        _refuse(
            source,
            "fit.rig_fingerprint",
            f"the rig {rig.name!r} ({rig.source}) is not the one that was matched, which was "
            f"{stored.rig!r} ({stored.rig_file}), or has changed since; pass it as rig=...",
        )
    return rig


def _fitted_parameters(
    source: str, rows: Mapping[str, ParameterTable], stored: StoredFit, rig: Rig
) -> FittedParameters:
    """The row of each parameter of the rig, from its two tables in the file."""
    published, fitted = rig.parameter_sets.get("published", {}), FittedParameters()
    for name, parameter in rig.parameters.items():
        field = f"parameters.{name}"
        if name not in rows:
            _refuse(source, field, f"expected a row for each parameter of {rig.name}, got none")
        if name not in stored.parameters:
            _refuse(source, f"fit.{field}", "expected the results of the match, got none")
        row = rows[name]
        if row.unit != parameter.unit:
            _refuse(source, f"{field}.unit", f"expected {parameter.unit!r}, got {row.unit!r}")
        lower, upper = row.bounds or (-math.inf, math.inf)
        # The prior of a parameter that was held is the rig's, and had no part in the match.
        prior = row.prior if row.free else None
        fitted[name] = FittedParameter(
            name=name,
            unit=row.unit,
            description=row.description,
            free=row.free,
            scope=row.scope,
            value=row.value,
            published=published.get(name),
            lower=lower,
            upper=upper,
            is_logarithmic=replace(parameter, lower=lower).is_logarithmic,
            prior_value=prior and prior.value,
            prior_spread=prior and prior.spread,
            group_spread=prior and prior.between_groups,
            **vars(stored.parameters[name]),
        )
    return fitted


def _fit(
    stored: StoredFit,
    parameters: FittedParameters,
    values: Sequence[Mapping[str, float]],
    solution: Solution,
    uncertainty: Uncertainty,
) -> Fit:
    """The fit, without comparisons; `values` are those of each recording."""
    problem, records = solution.problem, stored.recordings.values()
    own_rows = problem.unknowns.per_group + problem.unknowns.per_recording
    own = [{row.name: own_values[row.name] for row in own_rows} for own_values in values]
    shared = {row.name: values[0][row.name] for row in problem.unknowns.shared}
    return Fit(
        twin=problem.twin.with_values(shared | own[0]),
        recordings=problem.names,
        fingerprints=tuple(record.fingerprint for record in records),
        channels=tuple(record.channels for record in records),
        first_samples=tuple(record.first_sample for record in records),
        parameters=parameters,
        recording_values=dict(zip(problem.names, own, strict=True)),
        fit_percent={
            (name, channel): percent
            for name, record in stored.recordings.items()
            for channel, percent in record.fit_percent.items()
        },
        uncertainty=uncertainty,
        comparisons=None,
        _solution=solution,
        **{name: getattr(stored, name) for name in SAME_FIELDS},
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


def _unknowns(rig: Rig, parameters: FittedParameters, group_numbers: Sequence[int]) -> Unknowns:
    free = [
        replace(matched_parameter(row, rig.parameters[name]), value=row.initial)
        for name, row in parameters.items()
        if row.free
    ]
    return Unknowns.of(free, group_numbers)


def _uncertainty(source: str, known: StoredUnknowns, solution: Solution) -> Uncertainty:
    labels, unknowns = solution.problem.labels, solution.problem.unknowns
    if known.labels != labels:
        _refuse(
            source,
            "fit.unknowns.labels",
            f"expected the free parameters and recordings of the file, {', '.join(labels)}, got "
            f"{', '.join(known.labels)}",
        )
    slopes, lost = unknowns.value_derivatives(solution.vector), np.isin(labels, known.undetermined)
    covariance, correlation = physical_covariance(known.covariance, slopes, lost)
    return Uncertainty(
        labels=labels,
        covariance=covariance,
        correlation=correlation,
        prior_to_data_ratio=known.prior_to_data_ratio,
        singular_values=known.singular_values,
        unidentifiable=known.unidentifiable,
        insensitive=insensitive_labels(labels, known.prior_to_data_ratio),
        collinear=close_pairs(labels, correlation),
        vector_covariance=known.covariance,
        inverse_hessian=known.inverse_hessian,
        between_recordings=known.between_recordings,
    )


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
