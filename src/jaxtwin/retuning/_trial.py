"""The trial of a candidate beside the present controller: many draws, in one scenario after the
other."""

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..control import (
    REST_FRACTION,
    SETTLING_BAND,
    AbstractController,
    ClosedLoop,
    OutOfReachError,
    Scenario,
    TuningObjective,
    longest_delay,
    scenario,
    simulate_many_loops,
    twin_at_medians,
)
from ..errors import ControlError
from ..physics import Twin
from ._loop_band import LoopBand
from ._scenarios import TrialScenario

# The share of the draws in which the limits of temperature are kept, at least.
MIN_SHARE_WITHIN_LIMITS = 0.99

# The difference of cost that does not count, as a part of the cost of the present controller in the
# first scenario.
COST_TOLERANCE = 0.01


@final
class LoopTrial(NamedTuple):
    """A controller in a scenario.

    - `cost`: the objective, in the mean over all draws; infinite if a loop does not stay finite.
    - `kept`: the share of the draws that keep the limits of temperature.
    - `hottest`: the highest reading of all draws, degC.
    - `error_at_rest`: the absolute error in the last tenth of the run, in the mean over all draws,
      K.
    """

    cost: float
    kept: float
    hottest: float
    error_at_rest: float


NOT_TRIED = LoopTrial(math.nan, math.nan, math.nan, math.nan)
"""In place of a loop whose references no duty can hold."""


@final
@dataclass(frozen=True)
class ScenarioTrial:
    """The present controller and the candidate in a scenario.

    - `scenario`: the scenario. `present`, `candidate`: what they did.
    - `passed`: whether the candidate passed. `sentence`: what was found, for people.
    """

    scenario: TrialScenario
    present: LoopTrial
    candidate: LoopTrial
    passed: bool
    sentence: str

    @property
    def is_tried(self) -> bool:
        """Whether a duty can hold the references in this scenario at all."""
        return self.present is not NOT_TRIED


@final
class ControllerTrial(NamedTuple):
    """What is the same for all scenarios of a trial.

    - `twin`: the twin. `draws`: draws of its values.
    - `references`, `duration`: as in `simulate_closed_loops`.
    - `objective`: the objective.
    - `allowance`: the part by which a candidate may be worse than the present controller.
    - `seed`: that of the noise.
    """

    twin: Twin
    draws: Mapping[str, Float[np.ndarray, " draws"]]
    references: float | int | str | np.ndarray
    duration: float | int
    objective: TuningObjective
    allowance: float
    seed: int

    def of(
        self,
        present: AbstractController,
        candidate: AbstractController,
        scenarios: tuple[TrialScenario, ...],
    ) -> tuple[tuple[ScenarioTrial, ...], LoopBand]:
        """Tries both controllers in all scenarios. Returns the trials, and the band of the
        candidate's error in the first.

        **Raises:** `ControlError` if the references cannot be held in the first scenario.
        """
        trials: list[ScenarioTrial] = []
        band = None
        median = twin_at_medians(self.twin, self.draws)
        for number, case in enumerate(scenarios):
            try:
                conditions = self._conditions(case, median, present)
            except OutOfReachError as problem:
                if number == 0:
                    raise
                # A room that is so cold that no duty holds the references is no fault of either.
                trials.append(ScenarioTrial(case, NOT_TRIED, NOT_TRIED, True, f"{problem}"))
                continue
            with ThreadPoolExecutor(2) as pool:
                runs = pool.map(partial(self._run, case, median, conditions), (present, candidate))
                (before, _), (after, errors) = runs
            if number == 0:
                band = self._band(conditions, errors)
            tolerance = COST_TOLERANCE * (trials[0].present.cost if trials else before.cost)
            is_off = conditions.switched_off is not None
            trials.append(self._judged(case, before, after, tolerance, is_off=is_off))
        assert band is not None
        return tuple(trials), band

    def _conditions(
        self, case: TrialScenario, median: Twin, controller: AbstractController
    ) -> Scenario:
        conditions = scenario(
            median,
            controller,
            self.references,
            duration=self.duration,
            seed=self.seed,
            **case.settings,
        )
        with own_settings():
            longest = longest_delay(median, self.draws)
        # With the same tables in all scenarios they share their programs.
        zeros = np.zeros((*conditions.ambient.shape, len(self.twin.netlist.nodes)))
        return replace(
            conditions,
            longest_delay=longest,
            heat=zeros if conditions.heat is None else conditions.heat,
            conductance=zeros if conditions.conductance is None else conditions.conductance,
        )

    def _run(
        self,
        case: TrialScenario,
        median: Twin,
        conditions: Scenario,
        controller: AbstractController,
    ) -> tuple[LoopTrial, Float[np.ndarray, "draws times"]]:
        weighs = np.flatnonzero(self.objective.weights)
        names = [[*self.objective.measures][number] for number in weighs]
        measures = {
            **{name: self.objective.measures[name] for name in names},
            "_hottest": hottest_reading,
            "_sides": hottest_of_sides,
            "_error": absolute_error,
        }
        with own_settings():
            results = simulate_many_loops(
                median,
                controller,
                conditions,
                draws=self.draws,
                controller_draws={},
                count=len(next(iter(self.draws.values()))),
                measures=measures,
                precision="float64",
                workers=None,
                fault=case.fault(self.twin),
            )
        cost = np.stack([results[name] for name in names], axis=1) @ self.objective.weights[weighs]
        hottest, errors = np.asarray(results["_hottest"]), np.asarray(results["_error"])
        # NaN is no temperature that keeps a limit.
        of_readings, of_sides = _limits(self.twin)
        kept = (hottest <= of_readings) & (results["_sides"] <= of_sides).all(axis=1)
        rest = errors[:, -max(1, round(REST_FRACTION * errors.shape[1])) :]
        is_finite = bool(np.isfinite(cost).all())
        result = LoopTrial(
            float(cost.mean()) if is_finite else np.inf,
            float(np.mean(kept)),
            float(np.max(hottest)),
            float(rest.mean()),
        )
        return result, errors

    def _judged(
        self,
        case: TrialScenario,
        present: LoopTrial,
        candidate: LoopTrial,
        tolerance: float,
        *,
        is_off: bool,
    ) -> ScenarioTrial:
        """Judges a candidate. Where the cells are switched off, what they leave behind says nothing
        of a controller, and only the limits count."""
        most = (1 + self.allowance) * present.cost + tolerance
        cost = f"a cost of {candidate.cost:.4g}, with the present controller {present.cost:.4g}"
        kept = f"the limits of temperature are kept in {100 * candidate.kept:.3g} % of the draws"
        rest = f"an error at rest of {candidate.error_at_rest:.2g} K, with the present controller"
        checks = [
            (
                candidate.kept >= MIN_SHARE_WITHIN_LIMITS,
                f"{kept}, up to {candidate.hottest:.1f} degC",
            ),
            (candidate.cost <= most, f"{cost}, and at most {most:.4g} is allowed"),
            (
                candidate.error_at_rest <= present.error_at_rest + SETTLING_BAND,
                f"{rest} {present.error_at_rest:.2g} K",
            ),
        ]
        # What is not a number passes no check.
        failed = [text for holds, text in checks[: 1 if is_off else None] if not holds]
        passed = "the cells were switched off within the limits" if is_off else cost
        return ScenarioTrial(case, present, candidate, not failed, failed[0] if failed else passed)

    def _band(self, conditions: Scenario, errors: Float[np.ndarray, "draws times"]) -> LoopBand:
        substeps = np.asarray(conditions.ambient).shape[1]
        reference = np.repeat(np.asarray(conditions.reference), substeps, axis=0)
        reference = reference[: errors.shape[1]]
        time = conditions.step * np.arange(errors.shape[1])
        return LoopBand.of(time, reference, float(np.median(errors[:, 0])), errors)


def hottest_reading(loop: ClosedLoop) -> Float[Array, ""]:
    """The highest temperature of a channel, without noise, degC."""
    return jnp.asarray(loop.temperatures).max()


def hottest_of_sides(loop: ClosedLoop) -> Float[Array, " sides"]:
    """The highest temperature of each side of a cell, degC."""
    return jnp.asarray(loop.cell_sides).max(axis=0)


def absolute_error(loop: ClosedLoop) -> Float[Array, " times"]:
    """The absolute error by the readings, in the mean over the outputs, K."""
    reference = jnp.asarray(loop.reference)
    measured = jnp.asarray(loop.measurement)[..., : reference.shape[-1]]
    return jnp.abs(reference - measured).mean(axis=-1)


def check_limit(twin: Twin) -> None:
    """Refuses a rig whose file does not say what is too hot.

    **Raises:** `ControlError`.
    """
    if twin.rig.limits is None:
        raise ControlError(
            f"retune: {twin.rig.source}: limits.temperature: expected the temperature at which the "
            'cells are switched off, such as "90 degC", got none; nothing says what is safe'
        )


def _limits(twin: Twin) -> tuple[float, Float[np.ndarray, " sides"]]:
    """The limit of readings, and those of all cold and all hot sides, degC."""
    assert twin.rig.maximum_temperature is not None
    sides = np.tile(twin.rig.maximum_side_temperatures, 2)
    return twin.rig.maximum_temperature - ZERO_CELSIUS, sides - ZERO_CELSIUS
