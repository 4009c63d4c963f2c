"""The trade between two aims: controllers tuned for both, with several weights."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..._arguments import finite_number, whole_number
from ..._display import picture
from ..._name_suggestions import did_you_mean, unknown_name
from ..._progress import announced, silent
from ..._result import AbstractResult, dataset, table
from ...errors import ControlError
from ...matching import Fit, nominal_twin
from ...physics import Twin
from ..controllers._controller import AbstractController
from ..loops._measures import MEASURES
from ._objective import STEPWISE, checked_objective
from ._tuning import Tuning
from ._tuning_problem import tuning_problem, twin_first

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, repr=False, eq=False)
class Frontier(AbstractResult):
    """Controllers along the trade between two aims.

    **Arguments:**

    - `against`: the measure whose weight changes.
    - `weights`: its weights, in ascending order.
    - `tunings`: the tuning for each weight.
    """

    against: str
    weights: Float[np.ndarray, " points"]
    tunings: tuple[Tuning, ...]

    def measure(self, name: str) -> Float[np.ndarray, "points draws"]:
        """A measure of each controller, for each draw of the plant.

        **Raises:** `ControlError` for an unknown measure.
        """
        known = self.tunings[0].measures
        if name not in known:
            raise ControlError(f"Frontier: {unknown_name('measure', name, known)}")
        column = known.index(name)
        return np.stack([tuning.after.measures[:, column] for tuning in self.tunings])

    def plot(
        self,
        measure: str | None = None,
        beside: Sequence[str] = ("energy", "settling_time"),
    ) -> "Figure":
        """Plots a measure over other measures, with a panel for each
        (`jaxtwin.plots.plot_frontier`).

        **Arguments:**

        - `measure`: the measure on the vertical axis; by default the one whose weight changes.
        - `beside`: the measures on the horizontal axes.
        """
        return picture("plot_frontier", self, measure or self.against, beside)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each weight: parameters, sensitivity peak, and the median of each
        measure over the draws."""
        rows = []
        for weight, tuning in zip(self.weights, self.tunings, strict=True):
            row = {"weight": weight, **dict(zip(tuning.tuned, tuning.after.values, strict=True))}
            row["sensitivity_peak"] = tuning.after.sensitivity_peak
            medians = np.median(tuning.after.measures, axis=0)
            rows.append(row | dict(zip(tuning.measures, medians, strict=True)))
        return table(rows, "weight")

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset of measures (weight, draw), parameters (weight, parameter) and sensitivity
        peaks (weight)."""
        first, loops = self.tunings[0], [tuning.after for tuning in self.tunings]
        variables: dict[str, Any] = {
            "value": ("weight parameter", [loop.values for loop in loops]),
            "sensitivity_peak": ("weight", [loop.sensitivity_peak for loop in loops], "1"),
        }
        for name in first.measures:
            variables[name] = ("weight draw", self.measure(name), MEASURES[name][1])
        attributes = {"rig": first.rig, "against": self.against}
        return dataset(variables, attributes, weight=self.weights, parameter=first.tuned)

    def __repr__(self) -> str:
        first = self.tunings[0]
        return (
            f"<Frontier of {first.rig}: {len(self.weights)} controllers, weight of {self.against} "
            f"from {self.weights[0]:g} to {self.weights[-1]:g}>"
        )


@twin_first
@announced("frontier")
def frontier(
    twin: Twin | Fit,
    controller: AbstractController,
    references: float | int | str | ArrayLike,
    *,
    duration: float | int,
    against: str = "largest_plate_range",
    weights: Iterable[float | int],
    objective: str | Mapping[str, float] = "integral_absolute_error",
    tuned: Iterable[str] | Mapping[str, tuple[float, float]] | None = None,
    draws: int | Mapping[str, ArrayLike] | None = None,
    tail_weight: float | int = 0.5,
    sensitivity_limit: float | int | None = 2.0,
    rounds: int = 20,
    seed: int = 0,
    workers: int | None = None,
    **settings: Any,
) -> Frontier:
    """Tunes a controller for an objective plus a measure whose weight grows from search to search.

    ```python
    found = jaxtwin.control.frontier(
        twin, pid, 40, duration=900, against="largest_plate_range", weights=[0, 30, 100, 300],
    )
    found.to_dataframe(), found.plot()
    ```

    Each search starts at the controller of the previous weight, the first one at the given
    controller. A search finds a local optimum, so start with a tuned controller. All measures of
    each controller are kept: the result shows uniformity against energy and against settling time.

    **Arguments:**

    - `against`: the measure whose weight changes, a measure that has a derivative.
    - `weights`: its weights, in 1 over its unit, at least 0.
    - `objective`: the rest of the objective: a measure, or measure -> weight.
    - `controller`, `twin`, `references`, `duration`, `tuned`, `draws`, `tail_weight`,
      `sensitivity_limit`, `rounds`, `seed`, `workers`, `settings`: as in `jaxtwin.tune`.

    **Raises:** `ControlError` if arguments do not fit each other, as in `jaxtwin.tune`.
    """
    if against not in MEASURES or against in STEPWISE:
        known = [name for name in MEASURES if name not in STEPWISE]
        raise ControlError(
            f"frontier: against: expected one of {', '.join(known)}, got {against!r}"
            f"{did_you_mean([against], known)}"
        )
    where = "frontier: weights"
    given = list(weights)
    amounts = sorted(finite_number(where, weight, ControlError) for weight in given)
    if not amounts or amounts[0] < 0:
        raise ControlError(f"{where}: expected numbers of at least 0, got {given!r}")
    if not isinstance(objective, str | Mapping):
        raise ControlError(
            f"frontier: objective: expected a measure, or measure -> weight, got {objective!r}"
        )
    base = {objective: 1.0} if isinstance(objective, str) else dict(objective)
    number = whole_number("frontier: rounds", rounds, 1, ControlError)
    problem = tuning_problem(
        "frontier",
        controller,
        twin,
        references,
        duration,
        tuned=tuned,
        objective=base,
        draws=draws,
        tail_weight=tail_weight,
        sensitivity_limit=sensitivity_limit,
        starts=1,
        seed=whole_number("frontier: seed", seed, 0, ControlError),
        workers=workers,
        settings=settings,
    )
    rig = nominal_twin("frontier: twin", twin, ControlError).rig
    tunings = []
    for amount in amounts:
        began = time.perf_counter()
        sums = {**base, against: base.get(against, 0.0) + amount}
        aim = checked_objective("frontier", sums, tail_weight, rig)
        with silent():
            result = problem._replace(objective=aim).solved(number, began)
        tunings.append(result)
        problem = problem._replace(vector=problem.vector.with_controller(result.controller))
    return Frontier(against, np.array(amounts), tuple(tunings))
