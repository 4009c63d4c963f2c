"""The search of `tune`: objective and constraint over the unit box, their starts, and the best."""

import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar, final

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number, names_of, whole_number
from ..._jax_settings import own_settings
from ...errors import ControlError
from ...matching import Fit, nominal_twin, posterior_draws
from ...physics import Twin
from ...simulation import check_draw, checked_draws, valid_draws
from ..controllers._controller import AbstractController
from ..controllers._decoupled_pi import DecoupledPI
from ..controllers._design_vector import ControllerVector, DesignVector, split
from ..controllers._lqi import LQI
from ..controllers._mpc import MPC
from ..controllers._pid import PID
from ..loops._loop_margins import loop_margins
from ..loops._sampled_loop import SampledLoops
from ..loops._scenario import scenario
from ..loops._simulate_closed_loops import longest_delay, twin_at_medians
from ._loop_slopes import LoopSlopes
from ._objective import TuningObjective, checked_objective
from ._side_by_side_sqp import CandidateEvaluation, Round, descents
from ._tuning import TunedLoop, Tuning, TuningStep

# The factor by which a parameter without bounds may grow or fall.
DEFAULT_FACTOR = 30.0


class SearchBox(NamedTuple):
    """The map between parameters with bounds and the unit box. Parameters whose bounds are above 0
    are scaled by their logarithm."""

    lower: Float[np.ndarray, " parameters"]
    upper: Float[np.ndarray, " parameters"]

    @property
    def is_logarithmic(self) -> Bool[np.ndarray, " parameters"]:
        return self.lower > 0

    def values(self, point: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the parameters at a point of the unit box, within their bounds."""
        lower, upper = self._ends()
        result = lower + point * (upper - lower)
        result = np.where(
            self.is_logarithmic, np.exp(np.where(self.is_logarithmic, result, 0)), result
        )
        return np.clip(result, self.lower, self.upper)

    def point(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the point of parameters, which are clipped to their bounds."""
        lower, upper = self._ends()
        inside = np.clip(values, self.lower, self.upper)
        result = np.where(self.is_logarithmic, np.log(np.where(inside > 0, inside, 1)), inside)
        return np.clip((result - lower) / (upper - lower), 0, 1)

    def slopes(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the derivatives of the parameters with respect to the point."""
        lower, upper = self._ends()
        return (upper - lower) * np.where(self.is_logarithmic, values, 1.0)

    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        is_logarithmic = self.is_logarithmic
        lower, upper = (
            np.where(is_logarithmic, np.log(np.where(is_logarithmic, end, 1.0)), end)
            for end in (self.lower, self.upper)
        )
        return lower, upper


def search_box(
    where: str,
    controller: Any,
    tuned: Iterable[str] | Mapping[str, tuple[float, float]] | None,
) -> tuple[ControllerVector | DesignVector, SearchBox]:
    """Checks the arguments of `tune` that concern parameters, and makes the search box.

    **Raises:** `ControlError` for unknown names, for invalid bounds, and for a parameter that needs
    bounds and has none.
    """
    if tuned is None:
        tuned = _usual(where, controller)
    bounds = dict(tuned) if isinstance(tuned, Mapping) else {}
    names = tuple(bounds) if bounds else names_of(where, tuned, ControlError)
    if any(name in controller.design_weights() for name in names):
        vector = DesignVector(where, controller, names)
    else:
        vector = ControllerVector.of(where, controller, names)
    lower, upper = [], []
    given = split(vector.values, [shape for _, shape in vector.shapes])
    for (name, _), part in zip(vector.shapes, given, strict=True):
        value = np.ravel(part)
        low, high = (
            _pair(f"{where}: {name}", bounds[name])
            if name in bounds
            else _about(where, name, value)
        )
        lower.append(np.broadcast_to(low, value.shape))
        upper.append(np.broadcast_to(high, value.shape))
    return vector, SearchBox(np.concatenate(lower), np.concatenate(upper))


def _usual(where: str, controller: AbstractController) -> tuple[str, ...]:
    names = {
        PID: ("Kp", "Ki", "Kd"),
        DecoupledPI: ("Kp_mean", "Ki_mean", "Kp_difference", "Ki_difference"),
        LQI: ("integral_deviation", "duty_deviation", "reading_noise"),
        MPC: ("duty_deviation", "duty_change_deviation", "reading_noise"),
    }.get(type(controller))
    if names is not None and (isinstance(controller, LQI | MPC)):
        if controller.design_weights():
            return names
        names = None
    if names is None:
        raise ControlError(
            f"{where}: expected names of parameters for a {type(controller).__name__}, or name -> "
            "(lowest, highest), got None"
        )
    used = tuple(name for name in names if np.any(np.asarray(getattr(controller, name)) > 0))
    if not used:
        raise ControlError(f"{where}: expected a controller with gains above 0, got {controller}")
    return used


def _pair(where: str, bounds: Any) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in bounds)
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: expected (lowest, highest), finite numbers in this order, got {bounds!r}"
        ) from None
    return low, high


def _about(where: str, name: str, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not np.all(value > 0):
        raise ControlError(
            f"{where}: {name}: expected bounds, because its value is not above 0, got none; pass "
            f"tuned={{{name!r}: (lowest, highest)}}"
        )
    return value / DEFAULT_FACTOR, value * DEFAULT_FACTOR


P = ParamSpec("P")
T = TypeVar("T")

# The relative excess of a sensitivity peak over its limit that is accepted.
PEAK_TOLERANCE = 1e-3

# The number of random controllers for each start of which only the linear loop is evaluated.
RANDOM_CONTROLLERS = 200


def tuning_problem(
    where: str,
    controller: object,
    twin: Twin | Fit,
    references: float | int | str | ArrayLike,
    duration: float | int,
    *,
    tuned: Iterable[str] | Mapping[str, tuple[float, float]] | None,
    objective: object,
    draws: int | Mapping[str, ArrayLike] | None,
    tail_weight: float | int,
    sensitivity_limit: float | int | None,
    starts: int,
    seed: int,
    workers: int | None,
    settings: Mapping[str, Any],
) -> "TuningProblem":
    """Checks the arguments of `tune`, and makes the problem."""
    if not isinstance(controller, AbstractController):
        raise ControlError(
            f"{where}: controller: expected a controller with parameters, got {controller!r}"
        )
    plant = nominal_twin(f"{where}: twin", twin, ControlError)
    controller = controller.for_rig(plant.rig)
    if settings.get("quantised"):
        raise ControlError(
            f"{where}: quantised: expected False, because rounding has no derivative, got True"
        )
    if workers is not None:
        whole_number(f"{where}: workers", workers, 1, ControlError)
    vector, box = search_box(f"{where}: tuned", controller, tuned)
    aim = checked_objective(where, objective, tail_weight, plant.rig)
    limit = _checked_limit(where, sensitivity_limit)
    plant_draws = _plant_draws(where, plant, twin, draws, seed)
    median_twin = twin_at_medians(plant, plant_draws)
    conditions = scenario(
        median_twin,
        controller,
        references,
        duration=duration,
        **{**settings, "seed": seed, "quantised": False},
    )
    outputs = np.asarray(conditions.reference)[-1]
    with own_settings():
        delay = longest_delay(median_twin, plant_draws)
        conditions = replace(conditions, longest_delay=delay)
        loops = LoopSlopes(
            median_twin, plant_draws, vector.numbers, conditions, aim.measures, workers
        )
        linear = None
        if limit is not None:
            linear = SampledLoops(
                median_twin,
                plant_draws,
                vector,
                np.asarray(conditions.output_weights),
                outputs,
                longest_delay=delay,
                sensor_delay=conditions.sensor_delay_steps * conditions.step,
            )
    return TuningProblem(median_twin, outputs, vector, box, aim, limit, loops, linear, starts, seed)


@final
class TuningProblem(NamedTuple):
    """A search for the parameters of a controller.

    - `twin`: the twin without draws. `outputs`: the last references, degC.
    - `vector`, `box`: the parameters and their bounds.
    - `objective`: the objective.
    - `limit`: the limit of the sensitivity peak, None for none.
    - `loops`: the closed loops with derivatives. `linear`: the linearised loops.
    - `starts`: the number of descents. `seed`: the seed of the random starts.
    """

    twin: Twin
    outputs: Float[np.ndarray, " outputs"]
    vector: ControllerVector | DesignVector
    box: SearchBox
    objective: TuningObjective
    limit: float | None
    loops: LoopSlopes
    linear: SampledLoops | None
    starts: int
    seed: int

    def solved(self, rounds: int, began: float) -> Tuning:
        """Runs all descents, and returns the best controller."""
        result: dict[bytes, Float[np.ndarray, "draws measures"]] = {}

        def evaluate(
            points: Sequence[Float[np.ndarray, " parameters"]],
        ) -> list[CandidateEvaluation]:
            results = self._evaluated([self.box.values(point) for point in points])
            for point, (_, values) in zip(points, results, strict=True):
                result[point.tobytes()] = values
            return [evaluation for evaluation, _ in results]

        first = self.vector.values
        before, values_before = self._evaluated([first])[0]
        begin = self._first_points()
        history = descents(evaluate, begin, rounds=rounds)
        steps = tuple(self._step(part) for part in history)
        best = self._best(history)
        tuned = self.box.values(best.point)
        controller = self.vector.controller_at(tuned)
        margins = None
        if controller.is_linear:
            margins = loop_margins(self.twin, controller, self.outputs)
        return Tuning(
            rig=self.twin.rig.name,
            controller=controller,
            start=self.vector.controller,
            tuned=self.vector.labels,
            lower=self.box.lower,
            upper=self.box.upper,
            sensitivity_limit=self.limit,
            before=self._loop(first, before, values_before),
            after=self._loop(tuned, best.evaluation, result[best.point.tobytes()]),
            measures=tuple(self.objective.measures),
            weights=self.objective.weights,
            omega=np.zeros(0) if self.linear is None else self.linear.omega,
            history=steps,
            margins=margins,
            wall_time=time.perf_counter() - began,
        )

    def _evaluated(
        self, controllers: Sequence[Float[np.ndarray, " parameters"]]
    ) -> list[tuple[CandidateEvaluation, Float[np.ndarray, "draws measures"]]]:
        """Evaluates objective, constraint and measures of controllers by their parameters; the
        gradients are those with respect to the unit box."""
        with own_settings():
            loops = self.loops([self.vector.line(values) for values in controllers], self.starts)
            peaks = [None if self.linear is None else self.linear.peak(v) for v in controllers]
        results = []
        for values, measures, slopes, peak in zip(
            controllers, loops.values, loops.slopes, peaks, strict=True
        ):
            f, g = self.objective.over_draws(measures, slopes)
            by_point = self.box.slopes(values)
            c, a = -1.0, np.zeros_like(values)
            if peak is not None and self.limit is not None:
                c = math.log(peak.value / self.limit) if peak.is_stable else math.inf
                a = peak.slope / peak.value
            results.append((CandidateEvaluation(f, g * by_point, c, a * by_point), measures))
        return results

    def _first_points(self) -> list[Float[np.ndarray, " parameters"]]:
        """Returns the points of the given controller and of random controllers whose linear loop
        satisfies the limit, or has the lowest peak of `RANDOM_CONTROLLERS` that exceed it."""
        random = np.random.default_rng([self.seed, 1])
        points = [self.box.point(self.vector.values)]
        for _ in range(self.starts - 1):
            best = (math.inf, points[0])
            for _ in range(RANDOM_CONTROLLERS):
                point = random.random(len(points[0]))
                if self.linear is None or self.limit is None:
                    best = (0.0, point)
                    break
                with own_settings():
                    peak = self.linear.peak(self.box.values(point))
                if peak.is_stable and peak.value < best[0]:
                    best = (peak.value, point)
                if best[0] <= self.limit:
                    break
            points.append(best[1])
        return points

    def _best(self, history: Sequence[Round]) -> Round:
        finite = [part for part in history if part.evaluation.is_finite]
        if not finite:
            raise ControlError(
                "tune: expected a controller within the bounds whose loops are stable and finite, "
                f"got none in {len(history)} rounds; start with smaller gains, or give other bounds"
            )
        kept = [part for part in finite if part.evaluation.c <= PEAK_TOLERANCE]
        if not kept:
            nearest = min(finite, key=lambda part: part.evaluation.c)
            assert self.limit is not None
            raise ControlError(
                f"tune: sensitivity_limit: expected a limit that some controller within the bounds "
                f"keeps to, got {self.limit:g}; the lowest peak that was found is "
                f"{self.limit * math.exp(nearest.evaluation.c):.3g}"
            )
        return min(kept, key=lambda part: part.evaluation.f)

    def _step(self, part: Round) -> TuningStep:
        values = self.box.values(part.point)
        peak = math.nan if self.limit is None else self.limit * math.exp(part.evaluation.c)
        named = dict(zip(self.vector.labels, values.tolist(), strict=True))
        return TuningStep(part.start, part.number, part.evaluation.f, peak, part.accepted, named)

    def _loop(
        self,
        parameters: Any,
        evaluation: CandidateEvaluation,
        measures: Float[np.ndarray, "draws measures"],
    ) -> TunedLoop:
        sensitivity = np.zeros((len(measures), 0))
        peak = math.nan
        if self.linear is not None and self.limit is not None:
            with own_settings():
                sensitivity = self.linear.sensitivity(parameters)
            peak = self.limit * math.exp(evaluation.c)
        return TunedLoop(np.asarray(parameters), evaluation.f, peak, measures, sensitivity)


def _checked_limit(where: str, limit: object) -> float | None:
    if limit is None:
        return None
    return finite_number(f"{where}: sensitivity_limit", limit, ControlError, above=1)


def _plant_draws(
    where: str,
    plant: Twin,
    twin: Twin | Fit,
    draws: int | Mapping[str, ArrayLike] | None,
    seed: int,
) -> dict[str, Float[np.ndarray, " draws"]]:
    if draws is None:
        return {}
    if isinstance(draws, Mapping):
        checked = checked_draws(plant, draws)
        for number in np.flatnonzero(~valid_draws(plant, checked)):
            check_draw(plant, checked, int(number))
        return checked
    count = whole_number(f"{where}: draws", draws, 1, ControlError)
    if not isinstance(twin, Fit):
        raise ControlError(
            f"{where}: draws: expected name -> values beside a twin (a number of draws only beside "
            f"a fit), got {draws!r}"
        )
    return posterior_draws(twin, count, seed=seed)


def twin_first(function: Callable[P, T]) -> Callable[P, T]:
    """Lets a function whose first arguments are a twin and a controller take them in the old order
    too, with a warning."""

    @wraps(function)
    def in_order(*args: P.args, **keywords: P.kwargs) -> T:
        if args and isinstance(args[0], AbstractController):
            name = function.__name__
            message = f"{name}(controller, twin, ...) is now {name}(twin, controller, ...)"
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            twin, *rest = args[1:] or (keywords.pop("twin", None),)
            args = (twin, args[0], *rest)  # pyright: ignore[reportAssignmentType]
        return function(*args, **keywords)

    return in_order
