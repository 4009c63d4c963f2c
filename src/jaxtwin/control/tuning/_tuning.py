"""The result of tuning a controller."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..._display import picture
from ..._result import AbstractResult, dataset, table
from ..controllers._controller import AbstractController
from ..loops._loop_margins import LoopMargins
from ..loops._measures import MEASURES

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


class TuningStep(NamedTuple):
    """A controller that the search evaluated.

    - `start`: the number of the descent. `round`: the number of the round, 0 for its start.
    - `objective`: the objective; infinite if a loop is unstable or not finite.
    - `sensitivity_peak`: the largest sensitivity peak of all draws; NaN without a limit.
    - `accepted`: whether the descent moved to this controller.
    - `values`: parameter -> value.
    """

    start: int
    round: int
    objective: float
    sensitivity_peak: float
    accepted: bool
    values: Mapping[str, float]


class TunedLoop(NamedTuple):
    """A controller with the measures of its loops.

    - `values`: those of the tuned parameters. `objective`: the objective over all draws.
    - `sensitivity_peak`: the largest sensitivity peak of all draws; NaN without a limit.
    - `measures`: the measures of each draw; a single row without draws.
    - `sensitivity`: the sensitivity of the linearised loop of each draw over frequency.
    """

    values: Float[np.ndarray, " parameters"]
    objective: float
    sensitivity_peak: float
    measures: Float[np.ndarray, "draws measures"]
    sensitivity: Float[np.ndarray, "draws frequency"]

    def __repr__(self) -> str:
        return f"<TunedLoop: objective {self.objective:.4g}, {len(self.measures)} draws>"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Tuning(AbstractResult):
    """A tuned controller with its measures and the history of the search.

    **Arguments:**

    - `rig`: the name of the twin's rig.
    - `controller`: the tuned controller. `start`: the given controller.
    - `tuned`: the names of the tuned parameters. `lower`, `upper`: their bounds.
    - `sensitivity_limit`: the limit of the sensitivity peak, None for none.
    - `before`, `after`: the given and the tuned controller with the measures of their loops.
    - `measures`: the names of the measures. `weights`: their weights in the objective.
    - `omega`: the frequencies of the sensitivity, rad/s.
    - `history`: all controllers that the search evaluated.
    - `margins`: those of the tuned loop on the twin, without draws; None for a controller that is
      not linear.
    - `wall_time`: the duration of the search with compilation, s.
    """

    rig: str
    controller: AbstractController
    start: AbstractController
    tuned: tuple[str, ...]
    lower: Float[np.ndarray, " parameters"]
    upper: Float[np.ndarray, " parameters"]
    sensitivity_limit: float | None
    before: TunedLoop
    after: TunedLoop
    measures: tuple[str, ...]
    weights: Float[np.ndarray, " measures"]
    omega: Float[np.ndarray, " frequency"]
    history: tuple[TuningStep, ...]
    margins: LoopMargins | None
    wall_time: float

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """The parameters that ended at a bound; wider bounds may give a better controller."""
        values = self.after.values
        near = 1e-6 * (self.upper - self.lower)
        is_near = (values <= self.lower + near) | (values >= self.upper - near)
        return tuple(name for name, at in zip(self.tuned, is_near, strict=True) if at)

    def plot(self) -> "Figure":
        """Plots the objective over the rounds, the sensitivity over frequency, and the measures
        before and after (`jaxtwin.plots.plot_tuning`)."""
        return picture("plot_tuning", self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each controller that the search evaluated (start, round):
        objective, sensitivity peak, whether it was accepted, and the parameters."""
        rows = [step._asdict() | dict(step.values) for step in self.history]
        return table(rows, "start", "round").drop(columns="values")

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset of the two controllers (dimension controller: before and
        after) with parameters, the measures of each draw, and the sensitivity of each draw over
        frequency, rad/s."""
        both = (self.before, self.after)
        variables: dict[str, Any] = {
            "value": ("controller parameter", [loop.values for loop in both]),
            "objective": ("controller", [loop.objective for loop in both]),
            "sensitivity_peak": ("controller", [loop.sensitivity_peak for loop in both], "1"),
            "sensitivity": ("controller draw frequency", [loop.sensitivity for loop in both], "1"),
            "frequency": ("frequency", self.omega, "rad/s"),
        }
        for number, name in enumerate(self.measures):
            values = [loop.measures[:, number] for loop in both]
            variables[f"measure_{name}"] = ("controller draw", values, self._unit(name))
        return dataset(
            variables,
            {"rig": self.rig},
            controller=["before", "after"],
            parameter=self.tuned,
            draw=np.arange(len(self.after.measures)),
        )

    def __repr__(self) -> str:
        draws = len(self.after.measures)
        named = ", ".join(
            f"{name} {value:.4g}" for name, value in zip(self.tuned, self.after.values, strict=True)
        )
        peak = ""
        if self.sensitivity_limit is not None:
            peak = f", sensitivity peak {self.after.sensitivity_peak:.2f}"
        elif self.margins is not None:
            peak = f", {self.margins.summary()}"
        return (
            f"<Tuning of {self.rig}: {named}; objective {self.before.objective:.4g} -> "
            f"{self.after.objective:.4g}{peak}, {draws} draw{'s' * (draws != 1)}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        before, after = self.before, self.after
        rows: list[tuple[str, Any, Any, str]] = [
            (name, old, new, f"{low:.3g} to {high:.3g}")
            for name, old, new, low, high in zip(
                self.tuned, before.values, after.values, self.lower, self.upper, strict=True
            )
        ]
        rows.append(("objective", before.objective, after.objective, ""))
        if self.sensitivity_limit is not None:
            limit = f"at most {self.sensitivity_limit:g}"
            peaks = before.sensitivity_peak, after.sensitivity_peak
            rows.append(("sensitivity peak", *peaks, limit))
        if self.margins is not None:
            low, high = self.margins.disk.gain
            rows.append(("tolerates gains from, to", "", f"{low:.2f}, {high:.2f}", "times"))
            rows.append(("tolerates a phase of", "", self.margins.disk.phase_deg, "°"))
        medians = (np.median(loop.measures, axis=0) for loop in (before, after))
        for name, old, new in zip(self.measures, *medians, strict=True):
            rows.append((f"{name.replace('_', ' ')}, median", old, new, self._unit(name)))
        return table(rows, columns=("", "before", "after", "bounds or unit"))

    def _unit(self, measure: str) -> str:
        """The unit of a measure; that of a user's own is not known."""
        return MEASURES[measure][1] if measure in MEASURES else ""
