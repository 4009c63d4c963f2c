"""The entry to sensitivity analysis: the paper's correlations, or a global method."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, overload

from .._arguments import check_callable
from .._errors import SimulationError
from .._executor import Executor, check_executor
from .._waiting import announced
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ._global_analysis import global_sensitivity
from ._global_sensitivity import GlobalSensitivity
from ._input_choices import InputChoice
from ._method import AbstractMethod
from ._methods import MethodName, checked_method
from ._model import Model
from ._monte_carlo import correlate_costs
from ._outputs import OutputChoice
from ._sampling import checked_seed, checked_spread
from ._sensitivity import Sensitivity
from ._unit_samples import SampleKind

PAPERS_DRAWS = 50
"""The number of draws in the paper."""


@overload
def sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    method: Literal["correlations"] = "correlations",
    draws: int | None = None,
    spread: float | int = 0.25,
    seed: int = 0,
    names: Iterable[str] | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Sensitivity: ...


@overload
def sensitivity(
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
) -> GlobalSensitivity: ...


@announced("sensitivity analysis")
def sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    method: Literal["correlations"] | MethodName | AbstractMethod = "correlations",
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
) -> Sensitivity | GlobalSensitivity:
    """Finds the parameters that matter, by runs with other values of them.

    By default it correlates the cost with the parameters, as in the paper: every parameter is drawn
    from a normal distribution around its value, independently of the others and truncated to
    positive values. For each draw the mean squared error of every channel against its recording is
    computed. The index is the Pearson correlation between the two. The result also has Spearman's
    correlation, which is that of their ranks. Both have 95 % confidence intervals: with fifty draws
    they are uncertain by about 0.3. A cost has heavy tails, so that Pearson's correlation depends
    on a few extreme draws; the ranks show the relation that holds for most draws. Near an optimum
    the cost is quadratic, which no correlation can show.

    Other methods take any outputs and inputs; `docs/sensitivity.md` compares the questions that
    they answer.

    **Arguments:**

    - `twin`: a fit, in which each recording has its own values (those of a recording that was not
      matched are estimated from its first minute, see `Fit.twin_for`); or a single twin for all
      experiments, or a twin for each.
    - `experiments`: one or several experiments, with recorded temperatures if the cost is an
      output; None for those of the fit.
    - `method`: "correlations"; "pearson", "spearman", "src", "prcc", "oat", "morris", "sobol",
      "shapley", "dgsm" or "pce"; or a method with its own options, such as
      `Sobol(second_order=True)` of `jaxtwin.sensitivity_analysis`.
    - `draws`: the number of draws, at least 3; None for the usual number of the method, 50 in the
      paper. For "sobol" it is the number of base samples, for "morris" of trajectories, for
      "shapley" of orders, each of which takes several runs; "oat" always has the same number of
      runs.
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

    **Returns:** a `Sensitivity` by default, a `GlobalSensitivity` by other methods.

    **Raises:** `ParameterError` for unknown names, a value of zero, or inputs that the parameters
    or the method do not allow; `SimulationError` if an experiment has no recorded temperatures,
    an argument is out of range, or an executor fails; `MatchError` if a recording that was not
    matched is too short to estimate its values.
    """
    seed = checked_seed("sensitivity: seed", seed)
    spread = checked_spread("sensitivity: spread", spread)
    check_callable("sensitivity: on_progress", on_progress, SimulationError)
    check_executor("sensitivity: executor", executor, SimulationError)
    check_callable("sensitivity: model", model, SimulationError)
    if model is not None:
        beside = {"experiments": experiments, "times": times, "executor": executor}
        beside["outputs"] = None if outputs == ("cost",) else outputs
        if given := [name for name, value in beside.items() if value is not None]:
            raise SimulationError(
                f"sensitivity: {given[0]}: expected none beside a model, which makes its own runs "
                f"and outputs, got {beside[given[0]]!r}"
            )
    if method == "correlations":
        is_papers = inputs == "normal" and not isinstance(outputs, Mapping)
        is_papers = is_papers and list(outputs) in (["cost"], list("cost"))
        if not is_papers or times is not None or samples is not None or model is not None:
            raise SimulationError(
                "sensitivity: expected inputs, outputs, times, samples and a model beside a global "
                'method only, got them beside "correlations"; use method="pearson" or "spearman"'
            )
        return correlate_costs(
            twin,
            experiments,
            draws=PAPERS_DRAWS if draws is None else draws,
            spread=spread,
            seed=seed,
            names=names,
            executor=executor,
            on_progress=on_progress,
        )
    return global_sensitivity(
        twin,
        experiments,
        checked_method(method),
        draws=draws,
        spread=spread,
        seed=seed,
        names=names,
        inputs=inputs,
        outputs=outputs,
        times=times,
        samples=samples,
        model=model,
        executor=executor,
        on_progress=on_progress,
    )
