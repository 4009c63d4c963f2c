"""The result of retuning a controller."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, final

from .._display import picture
from .._result import AbstractResult, dataset
from ..control import AbstractController, Tuning
from ._loop_band import LoopBand
from ._trial import ScenarioTrial

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

Decision = Literal["accepted", "unchanged", "rejected"]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Retuned(AbstractResult):
    """A controller that was tuned on a new twin, and whether it may replace the present one.

    **Arguments:**

    - `rig`: the name of the twin's rig.
    - `decision`: `accepted` if the candidate passed its trial, `unchanged` if the present
      controller is as good, and `rejected` if the candidate failed, or there is none.
    - `reason`: why, in a sentence.
    - `present`: the controller in use. `candidate`: the tuned one, whatever the decision; None if
      the search found none.
    - `tuning`: the search; None if it found no controller.
    - `trials`: both controllers in each scenario.
    - `sensitivity_peak`: that which 95 % of the draws do not exceed with the candidate; NaN for a
      controller that is not linear.
    - `band`: the error of the candidate's loop that the trial predicts.
    - `wall_time`: the time that it took, s.
    """

    rig: str
    decision: Decision
    reason: str
    present: AbstractController
    candidate: AbstractController | None
    tuning: Tuning | None
    trials: tuple[ScenarioTrial, ...]
    sensitivity_peak: float
    band: LoopBand | None
    wall_time: float

    @property
    def controller(self) -> AbstractController:
        """The controller to use from now on: the candidate if it was accepted."""
        accepted = self.candidate if self.decision == "accepted" else None
        return self.present if accepted is None else accepted

    @property
    def failed(self) -> tuple[ScenarioTrial, ...]:
        """The scenarios in which the candidate failed."""
        return tuple(trial for trial in self.trials if not trial.passed)

    @property
    def _parameters(self) -> list[tuple[str, float, float]]:
        """The tuned parameters with their values before and after."""
        if self.tuning is None:
            return []
        before, after = self.tuning.before.values.tolist(), self.tuning.after.values.tolist()
        return list(zip(self.tuning.tuned, before, after, strict=True))

    def summary(self) -> str:
        """The decision, the controllers, and a line for each scenario."""
        lines = [f"{self.decision}: {self.reason}"]
        lines += [f"  {name}: {old:.4g} -> {new:.4g}" for name, old, new in self._parameters]
        lines += [
            f"  {_mark(trial)} {trial.scenario.name}: {trial.sentence}" for trial in self.trials
        ]
        return "\n".join(lines)

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "decision": self.decision,
            "reason": self.reason,
            "parameters": {name: (old, new) for name, old, new in self._parameters},
            "sensitivity_peak": self.sensitivity_peak,
            "scenarios": [
                {
                    "name": trial.scenario.name,
                    "description": trial.scenario.description,
                    "passed": trial.passed,
                    "sentence": trial.sentence,
                    "present": trial.present._asdict(),
                    "candidate": trial.candidate._asdict(),
                }
                for trial in self.trials
            ],
            "band": None if self.band is None else self.band.to_dict(),
            "wall_time_s": self.wall_time,
        }

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each scenario, its name as index; empty without a trial."""
        import pandas

        table = pandas.json_normalize(self.to_dict()["scenarios"])
        return table.set_index("name") if len(table) else table

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the numbers of the trial for each scenario (dimension name)."""
        rows = self.to_dataframe().select_dtypes(["number", "bool"])
        units = {"kept": ["1"], "hottest": ["degC"], "error_at_rest": ["K"]}
        numbers = {
            str(name): ("name", values, *units.get(str(name).partition(".")[2], []))
            for name, values in rows.items()
        }
        attributes = {"rig": self.rig, "decision": self.decision, "reason": self.reason}
        return dataset(numbers, attributes, name=rows.index)

    def plot(self) -> "Figure":
        """Plots the costs of both controllers in each scenario: `jaxtwin.plots.plot_retuned`."""
        return picture("plot_retuned", self)

    def __repr__(self) -> str:
        return f"<Retuned {self.rig}: {self.decision}: {self.reason}>"

    def _overview(self) -> "pandas.DataFrame":
        shown = ["present.cost", "candidate.cost", "passed", "sentence"]
        return self.to_dataframe().filter(shown)


def _mark(trial: ScenarioTrial) -> str:
    if not trial.is_tried:
        return "not tried"
    return "ok " if trial.passed else "NOT"
