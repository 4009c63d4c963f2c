"""The objective of tuning: a weighted sum of measures over many draws of the plant."""

import math
from collections.abc import Mapping
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...rig import Rig, check_has_plate
from ..loops._measures import OF_PLATE, Measure, measures_of

# Measures that change in steps of a sample and have no derivative -> the measure to use instead.
STEPWISE = {
    "settling_time": "integral_time_absolute_error",
    "saturation_share": "peak_power",
}

# The share of the draws that count as the worst ones.
TAIL_FRACTION = 0.05

# The name of an objective that is a function of the user.
OWN_OBJECTIVE = "objective"


class TuningObjective(NamedTuple):
    """A weighted sum of measures.

    - `measures`: name -> function, all measures that are computed of each loop.
    - `weights`: the weight of each measure in the sum.
    - `tail_weight`: the weight of the mean over the worst draws; the rest is that of the mean over
      all draws.
    """

    measures: Mapping[str, Measure]
    weights: Float[np.ndarray, " measures"]
    tail_weight: float

    def of_draws(self, values: Float[np.ndarray, "draws measures"]) -> Float[np.ndarray, " draws"]:
        """Computes the weighted sum of each draw."""
        weighs = self.weights != 0  # a measure of weight 0 may be infinite
        return values[:, weighs] @ self.weights[weighs]

    def over_draws(
        self,
        values: Float[np.ndarray, "draws measures"],
        slopes: Float[np.ndarray, "draws measures parameters"],
    ) -> tuple[float, Float[np.ndarray, " parameters"]]:
        """Computes the objective and its derivatives: the mean over all draws and over the worst
        ones (the conditional value at risk, Rockafellar and Uryasev, Journal of Risk 2, 2000)."""
        weighs = self.weights != 0
        sums = self.of_draws(values)
        by_parameters = np.einsum("dmp,m->dp", slopes[:, weighs], self.weights[weighs])
        if not np.isfinite(sums).all():
            return math.inf, np.full(slopes.shape[-1], np.nan)
        worst = np.argsort(sums)[-max(1, math.ceil(TAIL_FRACTION * len(sums))) :]
        share = np.full(len(sums), (1 - self.tail_weight) / len(sums))
        share[worst] += self.tail_weight / len(worst)
        return float(share @ sums), share @ by_parameters


def checked_objective(
    where: str, objective: object, tail_weight: object, rig: Rig
) -> TuningObjective:
    """Makes an objective from the name of a measure, from name -> weight, or from a function of a
    `ClosedLoop`.

    **Raises:** `ControlError` for anything else, for unknown measures, for measures without a
    derivative, and for those of the plate if the rig has none.
    """
    tail = finite_number(f"{where}: tail_weight", tail_weight, ControlError, least=0, most=1)
    of_rig = measures_of(len(rig.plate.element_names))
    measures: dict[str, Measure] = {name: function for name, (function, _) in of_rig.items()}
    at = f"{where}: objective"
    if callable(objective):
        measures[OWN_OBJECTIVE] = cast(Measure, objective)
        weights = {OWN_OBJECTIVE: 1.0}
    elif isinstance(objective, str):
        weights = {objective: 1.0}
    elif isinstance(objective, Mapping) and objective:
        weights = {
            str(name): finite_number(f"{at}: {name}", weight, ControlError)
            for name, weight in objective.items()
        }
    else:
        raise ControlError(
            f"{at}: expected a measure, measure -> weight, or a JAX function of a ClosedLoop, got "
            f"{objective!r}"
        )
    for name in weights:
        if name in OF_PLATE:
            check_has_plate(f"{at}: {name}", rig, ControlError)
        if name not in measures:
            raise ControlError(f"{at}: {unknown_name('measure', name, of_rig)}")
        if name in STEPWISE:
            raise ControlError(
                f"{at}: expected measures that have a derivative, got {name}, which changes by "
                f"whole samples; take {STEPWISE[name]}"
            )
    row = np.array([weights.get(name, 0.0) for name in measures])
    if not row.any():
        raise ControlError(f"{at}: expected a weight other than 0, got {objective!r}")
    return TuningObjective(measures, row, tail)
