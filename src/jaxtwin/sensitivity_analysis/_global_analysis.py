"""A global sensitivity analysis: simulates the runs of a method, and estimates the indices of all
outputs from them."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import whole_number
from .._errors import SimulationError
from .._executor import Executor
from .._waiting import counting
from ..io import Experiment
from ..matching import Fit
from ..matching._nominal_twin import nominal_twin
from ..physics import Twin
from ..simulation import reduce_batch
from ..simulation._reductions import ReductionFunction
from ._central_values import rescaled_draws
from ._global_sensitivity import GlobalSensitivity
from ._input_choices import InputChoice, resolve_inputs
from ._inputs import Inputs
from ._method import AbstractMethod, indices_of
from ._model import Model, run_model
from ._outputs import (
    Column,
    OutputChoice,
    OutputName,
    checked_outputs,
    columns_of,
    failed_runs,
    reductions_for,
    samples_at,
    with_mean_cost,
)
from ._paired_twins import paired_twins
from ._slopes import slopes_of
from ._unit_samples import SampleKind, checked_kind


def global_sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
    method: AbstractMethod,
    *,
    draws: int | None,
    spread: float,
    seed: int,
    names: Iterable[str] | None,
    inputs: InputChoice,
    outputs: OutputChoice,
    times: Sequence[float] | None,
    samples: SampleKind | None,
    model: Model | None,
    executor: Executor | None,
    on_progress: Callable[[int], None] | None,
) -> GlobalSensitivity:
    """Runs a global sensitivity analysis. The arguments are those of `sensitivity`."""
    began = time.perf_counter()
    if model is None:
        twins, recordings = paired_twins("sensitivity", twin, experiments)
    else:
        twins, recordings = [nominal_twin("sensitivity: twin", twin, SimulationError)], []
        if method.needs_slopes:
            raise SimulationError(
                "sensitivity: method: expected a method without derivatives beside a model, got "
                f"{method!r}"
            )
    count = method.default_draws if draws is None else draws
    count = whole_number("sensitivity: draws", count, method.min_draws, SimulationError)
    kind = method.default_samples if samples is None else checked_kind(samples)
    quantities = checked_outputs(outputs)
    distribution = resolve_inputs(inputs, twin, twins[0], names, spread)
    design = method.design(distribution, count, seed, kind)
    values = design.samples
    if model is None:
        columns, rates = _run_experiments(
            twins,
            recordings,
            distribution,
            values,
            method,
            quantities,
            times,
            executor,
            on_progress,
        )
    else:
        columns, rates = run_model(model, _draws_for(twins[0], distribution, values)), None
    table = np.column_stack([column for _, column in columns]).astype(float)
    indices, counted = indices_of(method, design, table, rates, seed)
    return GlobalSensitivity(
        rig=twins[0].rig.name,
        method=method,
        design=design,
        outputs=tuple(output for output, _ in columns),
        indices=indices,
        values=table,
        counted=counted,
        failed=failed_runs(columns),
        seed=seed,
        wall_time=time.perf_counter() - began,
    )


def _run_experiments(
    twins: Sequence[Twin],
    recordings: Sequence[Experiment],
    inputs: Inputs,
    values: Float[np.ndarray, "runs parameters"],
    method: AbstractMethod,
    outputs: Mapping[str, OutputName | ReductionFunction],
    times: Sequence[float] | None,
    executor: Executor | None,
    on_progress: Callable[[int], None] | None,
) -> tuple[list[Column], Float[np.ndarray, "runs outputs parameters"] | None]:
    """Computes the outputs of all runs of all experiments, and their derivatives if the method
    needs them."""
    columns: list[Column] = []
    report = counting(len(values) * len(recordings), on_progress)
    slopes: list[list[Column]] = [[] for _ in inputs.names]
    for recording_twin, experiment in zip(twins, recordings, strict=True):
        samples = samples_at(times, experiment)
        reductions = reductions_for(outputs, samples)
        draws = _draws_for(recording_twin, inputs, values)
        results = reduce_batch(
            recording_twin,
            experiment,
            draws,
            reductions,
            executor=executor,
            on_progress=report,
        )
        columns += columns_of(results, outputs, samples, experiment)
        if method.needs_slopes:
            for j, part in enumerate(slopes_of(recording_twin, experiment, draws, reductions)):
                factor = draws[inputs.names[j]][0] / values[0, j] if inputs.relative_to else 1.0
                slopes[j] += [
                    (output, factor * column)
                    for output, column in columns_of(part, outputs, samples, experiment)
                ]
    rates = _stacked_slopes([with_mean_cost(part) for part in slopes], method)
    return with_mean_cost(columns), rates


def _draws_for(
    twin: Twin, inputs: Inputs, values: Float[np.ndarray, "runs parameters"]
) -> dict[str, Float[np.ndarray, " runs"]]:
    draws = dict(zip(inputs.names, values.T, strict=True))
    return draws if inputs.relative_to is None else rescaled_draws(twin, inputs.relative_to, draws)


def _stacked_slopes(
    slopes: list[list[Column]], method: AbstractMethod
) -> Float[np.ndarray, "runs outputs parameters"] | None:
    if not method.needs_slopes:
        return None
    parts = [np.column_stack([column for _, column in part]) for part in slopes]
    return np.stack(parts, axis=2).astype(float)
