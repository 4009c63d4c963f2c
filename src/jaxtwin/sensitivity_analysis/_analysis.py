"""The two entries. A global sensitivity analysis simulates the runs of a method, with twins or with
a model of the user, and estimates the indices of all outputs from them. The paper's analysis,
section 3.4, is that of the correlations of costs with parameters over random draws.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, TypeAlias, cast

import numpy as np
from jaxtyping import ArrayLike, Float

from .._arguments import check_callable, of_kind, whole_number
from .._executor import Executor, check_executor
from .._name_suggestions import did_you_mean
from .._progress import announced, counting
from ..errors import SimulationError
from ..io import Experiment
from ..matching import Fit, nominal_twin
from ..physics import Twin
from ..simulation import REDUCTIONS, ReductionFunction, Reductions, reduce_batch
from ._correlations import (
    PartialRankCorrelation,
    Pearson,
    Spearman,
    StandardisedRegression,
    pearson,
    pearson_interval,
    spearman,
    spearman_interval,
)
from ._derivative_based import DerivativeBased, slopes_of
from ._global_sensitivity import GlobalSensitivity
from ._inputs import InputChoice, Inputs, rescaled_draws, resolve_inputs
from ._method import AbstractMethod, indices_of
from ._morris import Morris, OneAtATime
from ._outputs import (
    Column,
    Output,
    OutputChoice,
    OutputName,
    checked_outputs,
    columns_of,
    columns_of_values,
    distinct_names,
    failed_runs,
    paired_twins,
    reductions_for,
    samples_at,
    with_mean_cost,
)
from ._polynomial_chaos import PolynomialChaos
from ._sampling import SampleKind, checked_kind, checked_seed, checked_spread
from ._sensitivity import MEAN, Sensitivity
from ._shapley import Shapley
from ._sobol import Sobol

# From parameter -> values `(runs,)`, in the unit of the rig's table, to output -> values `(runs,)`
# or `(runs, ...)`, NaN if a run failed; or to `Reductions`.
Model: TypeAlias = Callable[
    [dict[str, Float[np.ndarray, " runs"]]], Mapping[str, ArrayLike] | Reductions
]


def run_model(model: Model, draws: dict[str, Float[np.ndarray, " runs"]]) -> list[Column]:
    """Runs a user's model and returns its outputs.

    **Raises:** `SimulationError` if the model does not return one or several numbers for each draw.
    """
    runs = len(next(iter(draws.values())))
    results: Any = model(draws)
    failed, units = np.zeros(runs, bool), {}
    if isinstance(results, Reductions):
        failed = results.failed
        known = {name: reduction.unit for name, reduction in REDUCTIONS.items()}
        present = [name for name in known if getattr(results, name) is not None]
        units = {name: known[name] for name in present} | dict(results.custom_units)
        results = {name: results[name] for name in (*present, *results.custom)}
    if not isinstance(results, Mapping) or not results:
        raise SimulationError(
            "sensitivity: model: expected a function that returns output -> values, got one that "
            f"returns {results!r}"
        )
    columns: list[Column] = []
    for name, values in cast(Mapping[Any, Any], results).items():
        array = np.asarray(values)
        if not isinstance(name, str) or array.dtype.kind not in "fiu" or array.shape[:1] != (runs,):
            raise SimulationError(
                f"sensitivity: model: output {name!r}: expected a number for each of {runs} draws, "
                f"got {array.dtype} of shape {array.shape}"
            )
        named = Output(name, unit=units.get(name, ""))
        for output, column in columns_of_values(named, array.astype(float)):
            columns.append((output, np.where(failed, np.nan, column)))
    return columns


MethodName: TypeAlias = Literal[
    "pearson", "spearman", "src", "prcc", "oat", "morris", "sobol", "shapley", "dgsm", "pce"
]
"""The name of a method of `global_sensitivity`."""

METHODS: dict[MethodName, AbstractMethod] = {
    "pearson": Pearson(),
    "spearman": Spearman(),
    "src": StandardisedRegression(),
    "prcc": PartialRankCorrelation(),
    "oat": OneAtATime(),
    "morris": Morris(),
    "sobol": Sobol(),
    "shapley": Shapley(),
    "dgsm": DerivativeBased(),
    "pce": PolynomialChaos(),
}
"""Name -> method, with its usual settings."""


def checked_method(method: MethodName | AbstractMethod) -> AbstractMethod:
    """Returns a method, given as an object or by its name.

    **Raises:** `SimulationError` for anything else.
    """
    if isinstance(method, str):
        for name, known in METHODS.items():
            if name == method:
                return known
        raise SimulationError(
            f"sensitivity: method: expected {', '.join(METHODS)}, got {method!r}"
            f"{did_you_mean([method], METHODS)}"
        )
    expected = "the name of a method, or one such as Sobol(second_order=True)"
    return of_kind("sensitivity: method", method, AbstractMethod, expected, SimulationError)


# The analysis, in messages.
WHERE = "sensitivity"


@announced("sensitivity analysis")
def global_sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    method: MethodName | AbstractMethod,
    draws: int | None = None,
    spread: float | int = 0.25,
    seed: int = 0,
    names: Iterable[str] | None = None,
    inputs: InputChoice = "normal",
    outputs: OutputChoice = ("cost",),
    times: Sequence[float] | None = None,
    samples: SampleKind | None = None,
    model: Model | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> GlobalSensitivity:
    """Finds the parameters that matter for any outputs of a twin, by a method of global sensitivity
    analysis: runs with other values of the parameters, over all of their distributions.

    `docs/sensitivity.md` compares the questions that the methods answer. `sensitivity` is the
    analysis of the paper.

    **Arguments:**

    - `twin`: a fit, in which each recording has its own values (those of a recording that was not
      matched are estimated from its first minute, see `Fit.twin_for`); or a single twin for all
      experiments, or a twin for each.
    - `experiments`: one or several experiments, with recorded temperatures if the cost is an
      output; None for those of the fit.
    - `method`: "pearson", "spearman", "src", "prcc", "oat", "morris", "sobol", "shapley", "dgsm" or
      "pce"; or a method with its own options, such as `Sobol(second_order=True)` of
      `jaxtwin.sensitivity_analysis`.
    - `draws`: the number of draws, at least 3; None for the usual number of the method. For "sobol"
      it is the number of base samples, for "morris" of trajectories, for "shapley" of orders, each
      of which takes several runs; "oat" always has the same number of runs.
    - `spread`: the relative standard deviation of "normal" and "lognormal" inputs, 0.25 in the
      paper.
    - `seed`: the same seed gives the same numbers.
    - `names`: the names of the parameters to draw; None for the free parameters that all recordings
      share.
    - `inputs`: "normal", as in the paper, truncated at 0; "lognormal", around the same values;
      "bounds", uniform between the bounds of the rig file; "priors", the priors of the rig file;
      "posterior", the remaining uncertainty of a fit, with its correlations; or name -> `Normal`,
      `Uniform` or `LogNormal` of `jaxtwin.sensitivity_analysis`.
    - `outputs`: some of "cost", "final", "minimum", "maximum", "plate_range", "plate_std",
      "energy", "peak_power", "uniformity", "temperature"; or a mapping of names to JAX functions of
      a trajectory, as `reduce_batch` takes it. All come from the same runs.
    - `times`: the times of "temperature", s; None for 25 times that divide each experiment evenly.
    - `samples`: "random", "latin-hypercube" or "sobol"; None for the usual kind of the method.
      Morris's and Shapley's methods use samples of their own kind.
    - `model`: your own function in place of simulations of experiments, for example for closed
      loops: from parameter -> values `(runs,)` to output -> values `(runs,)` or `(runs, ...)`, or
      to the `Reductions` of `simulate_closed_loops`. The parameters are drawn around a twin, or the
      mean twin of a fit. It cannot be combined with experiments, outputs, times, an executor, or a
      method that needs derivatives.
    - `executor`: an executor whose workers run the draws instead of this process, see
      `simulate_batch`.
    - `on_progress`: called with the number of newly finished simulations.

    **Raises:** `ParameterError` for unknown names, a value of zero, or inputs that the parameters
    or the method do not allow; `SimulationError` if an experiment has no recorded temperatures,
    an argument is out of range, or an executor fails; `MatchError` if a recording that was not
    matched is too short to estimate its values.
    """
    began = time.perf_counter()
    check_options(executor, on_progress)
    seed, spread = checked_seed(f"{WHERE}: seed", seed), checked_spread(f"{WHERE}: spread", spread)
    method = checked_method(method)
    if model is None:
        twins, recordings = paired_twins(WHERE, twin, experiments)
    else:
        check_callable(f"{WHERE}: model", model, SimulationError)
        beside = {"experiments": experiments, "times": times, "executor": executor}
        beside["outputs"] = None if outputs == ("cost",) else outputs
        if given := [name for name, value in beside.items() if value is not None]:
            raise SimulationError(
                f"{WHERE}: {given[0]}: expected none beside a model, which makes its own runs "
                f"and outputs, got {beside[given[0]]!r}"
            )
        if method.needs_slopes:
            raise SimulationError(
                f"{WHERE}: method: expected a method without derivatives beside a model, got "
                f"{method!r}"
            )
        twins, recordings = [nominal_twin(f"{WHERE}: twin", twin, SimulationError)], []
    count = method.default_draws if draws is None else draws
    count = whole_number(f"{WHERE}: draws", count, method.min_draws, SimulationError)
    kind = method.default_samples if samples is None else checked_kind(samples)
    quantities = checked_outputs(outputs)
    distribution = resolve_inputs(inputs, twin, twins[0], names, spread)
    design = method.design(distribution, count, seed, kind)
    values = design.samples
    if model is None:
        columns, rates = run_experiments(
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


def check_options(executor: Executor | None, on_progress: Callable[[int], None] | None) -> None:
    """Checks who works and who is told of progress.

    **Raises:** `SimulationError`.
    """
    check_callable(f"{WHERE}: on_progress", on_progress, SimulationError)
    check_executor(f"{WHERE}: executor", executor, SimulationError)


def run_experiments(
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


# Its draws are those of the paper: independent and random, each a run.
METHOD = Pearson()


@announced("sensitivity analysis")
def sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    draws: int = 50,
    spread: float | int = 0.25,
    seed: int = 0,
    names: Iterable[str] | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Sensitivity:
    """Finds the parameters that matter for the error of a twin, by runs with other values of them.
    This is the analysis of the paper.

    Every parameter is drawn from a normal distribution around its value, independently of the
    others and truncated to positive values. For each draw the mean squared error of every channel
    against its recording is computed. The index is the Pearson correlation between the two. The
    result also has Spearman's correlation, which is that of their ranks. Both have 95 % confidence
    intervals: with fifty draws they are uncertain by about 0.3. A cost has heavy tails, so that
    Pearson's correlation depends on a few extreme draws; the ranks show the relation that holds for
    most draws. Near an optimum the cost is quadratic, which no correlation can show.
    `global_sensitivity` has other methods, for any outputs and inputs.

    **Arguments:**

    - `twin`: a fit, in which each recording has its own values (those of a recording that was not
      matched are estimated from its first minute, see `Fit.twin_for`); or a single twin for all
      experiments, or a twin for each.
    - `experiments`: one or several experiments with recorded temperatures; None for those of the
      fit.
    - `draws`: the number of draws, at least 3; 50 in the paper.
    - `spread`: the standard deviation relative to each value, 0.25 in the paper.
    - `seed`: the same seed gives the same numbers.
    - `names`: the names of the parameters to draw; None for the free parameters that all recordings
      share.
    - `executor`: an executor whose workers run the draws instead of this process, see
      `simulate_batch`.
    - `on_progress`: called with the number of newly finished simulations.

    **Raises:** `ParameterError` for unknown names or a value of zero; `SimulationError` if an
    experiment has no recorded temperatures, an argument is out of range, or an executor fails;
    `MatchError` if a recording that was not matched is too short to estimate its values.
    """
    began = time.perf_counter()
    check_options(executor, on_progress)
    twins, recordings = paired_twins(WHERE, twin, experiments)
    draws = whole_number(f"{WHERE}: draws", draws, METHOD.min_draws, SimulationError)
    spread, seed = checked_spread(f"{WHERE}: spread", spread), checked_seed(f"{WHERE}: seed", seed)
    inputs = resolve_inputs("normal", twin, twins[0], names, spread)
    samples = METHOD.design(inputs, draws, seed, METHOD.default_samples).samples
    columns, _ = run_experiments(
        twins, recordings, inputs, samples, METHOD, {"cost": "cost"}, None, executor, on_progress
    )
    # Recordings may have channels in any order.
    known = twins[0].channels
    columns[:-1] = sorted(columns[:-1], key=lambda column: known.index(column[0].channel))
    cost, failed = np.column_stack([column for _, column in columns]), failed_runs(columns)
    counted = cost[~failed], samples[~failed]
    return Sensitivity(
        rig=twins[0].rig.name,
        names=inputs.names,
        values=np.array([float(twins[0].values[name]) for name in inputs.names]),
        channels=(*distinct_names(output.channel for output, _ in columns[:-1]), MEAN),
        correlation=pearson(*counted),
        interval=pearson_interval(*counted),
        rank_correlation=spearman(*counted),
        rank_interval=spearman_interval(*counted),
        samples=samples,
        cost=cost,
        failed=failed,
        spread=spread,
        seed=seed,
        wall_time=time.perf_counter() - began,
    )
