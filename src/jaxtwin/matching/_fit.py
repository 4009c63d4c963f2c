"""What a match gives."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, final

import numpy as np
from jaxtyping import Float

from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter, write_parameters
from ..simulation import Run
from ._estimate import Knowledge, Setting
from ._noise import Noise
from ._summary import Style, summary_table
from ._uncertainty import Uncertainty


@final
@dataclass(frozen=True)
class FittedParameter:
    r"""One row of Table 4 of the paper.

    **Arguments:**

    - `name`, `unit`, `description`, `free`, `scope`: as in the rig's parameter table.
    - `initial`, `value`: before and after, in `unit`. Where each recording has its own, their mean.
    - `published`: what the rig's parameter set `published` says, None where it says nothing.
    - `lower`, `upper`: bounds of the match.
    - `is_logarithmic`: whether it was matched by its logarithm, so that `prior_spread` is relative.
    - `at_bound`: whether it ended on one: what the data would rather have lies outside.
    - `standard_error`: in `unit`, with the residuals' autocorrelation counted; infinite where
      nothing tells it, NaN where the parameter was held or ended at a bound.
    - `prior_value`, `prior_spread`: what was known beforehand, None where nothing was.
    - `prior_distance`: of the value from there in standard deviations; the largest of all
      recordings.
    - `narrowing`: how many times narrower than beforehand the recordings alone would leave it, the
      others being known.
    - `warnings`: what to know before believing it.
    - `relative_standard_error`: of its natural logarithm, where it was matched by that; else NaN.
    - `interval`: both ends of its 95 % interval, in `unit`: $v e^{\pm 1.96 s}$ where it was matched
      by its logarithm, else $v \pm 1.96 s$, whatever the bounds. Unbounded where nothing tells it,
      NaN where `standard_error` is. Where each recording has its own, with the largest error.
    """

    name: str
    unit: str
    description: str
    free: bool
    scope: Literal["shared", "recording"]
    initial: float
    value: float
    published: float | None
    lower: float
    upper: float
    is_logarithmic: bool
    at_bound: bool
    standard_error: float
    prior_value: float | None = None
    prior_spread: float | None = None
    prior_distance: float | None = None
    narrowing: float = math.nan
    warnings: tuple[str, ...] = ()
    relative_standard_error: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)


@final
@dataclass(frozen=True)
class Iteration:
    """One step of the optimiser, for Fig. 14 of the paper.

    - `number`: 0 is the start. `start`: of which of several starts.
    - `cost`: mean squared error, eq. (11), K^2. `rmse`: its root, K.
    - `gradient`: largest cosine between residual and Jacobian column, 0 at an optimum.
    - `accepted`: whether the step was taken.
    - `parameters`: name -> value; those with a value for each recording as `name[recording]`.
    """

    number: int
    start: int
    cost: float
    rmse: float
    gradient: float
    accepted: bool
    parameters: Mapping[str, float]


@final
@dataclass(frozen=True)
class Optimum:
    """Where one of several starts ended.

    - `start`: which one. `cost`: half the sum of squared weighted residuals, priors among them.
    - `apart`: root mean square of the difference between its simulated channels and those of the
      best, K: optima far apart in their parameters may predict the same.
    - `rmse`: K. `iterations`, `status`, `converged`, `parameters`.
    """

    start: int
    cost: float
    apart: float
    rmse: float
    iterations: int
    status: str
    converged: bool
    parameters: Mapping[str, float]


@final
@dataclass(frozen=True, eq=False)
class CameraError:
    """What the camera added to all channels of a recording alike.

    - `events`: times of its flat-field corrections, s.
    - `error`: simulated less recorded temperature that is the camera's, `(times,)`, K.
    """

    events: tuple[float, ...]
    error: Float[np.ndarray, " times"]

    @property
    def offset(self) -> Float[np.ndarray, " times"]:
        """What it read too much, K."""
        return -self.error


@final
@dataclass(frozen=True, repr=False, eq=False)
class Fit:
    """A twin matched to recordings.

    **Arguments:**

    - `twin`: with the fitted values; those of the first recording where each has its own.
    - `recordings`: names.
    - `experiments`: the recordings.
    - `parameters`: a row for every parameter of the rig.
    - `recording_values`: recording -> name -> value, for parameters with one for each recording.
    - `fit_percent`: (recording, channel) -> NRMSE fit, %.
    - `rmse`: over all channels, K.
    - `status`, `converged`: why the best start stopped, and whether at an optimum.
    - `history`: all iterations of the best start. `optima`: where every start ended, best first.
    - `wall_time`: s, with compilation.
    - `runs`: recording -> the fitted twin's run, without the camera's common error.
    - `solver_gap`: largest difference of these from what the match's own, longest steps gave, K.
    - `camera`: recording -> the camera's common error.
    - `weights`: recording -> how much each sample counted, 0 to 1, `(times, channels)`.
    - `noise`: of what each channel has alone, and of what all share times the root of their number.
    - `uncertainty`: covariance, correlations, what the recordings cannot tell.
    - `cost`: half the sum of squared weighted residuals, priors among them.
    - `setting`, `knowledge`, `vector`: from which the match can go on.
    """

    twin: Twin
    recordings: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    parameters: tuple[FittedParameter, ...]
    recording_values: Mapping[str, Mapping[str, float]]
    fit_percent: Mapping[tuple[str, str], float]
    rmse: float
    status: str
    converged: bool
    history: tuple[Iteration, ...]
    optima: tuple[Optimum, ...]
    wall_time: float
    runs: Mapping[str, Run]
    solver_gap: float
    camera: Mapping[str, CameraError]
    weights: Mapping[str, Float[np.ndarray, "times channels"]]
    noise: tuple[Noise, Noise]
    uncertainty: Uncertainty
    cost: float
    setting: Setting
    knowledge: Knowledge
    vector: Float[np.ndarray, " unknowns"]

    @property
    def plant_fit_percent(self) -> dict[tuple[str, str], float]:
        """(recording, channel) -> NRMSE fit without the camera's common error, %."""
        return {
            (name, channel): value
            for name, run in self.runs.items()
            for channel, value in run.fit_percent.items()
        }

    @property
    def mean_fit_percent(self) -> float:
        """Mean of the fits of all channels of all recordings, %."""
        return float(np.mean(list(self.fit_percent.values())))

    @property
    def twins(self) -> dict[str, Twin]:
        """Recording -> twin with the values of that recording."""
        return {
            name: self.twin.with_parameters(values)
            for name, values in self.recording_values.items()
        }

    def parameter(self, name: str) -> FittedParameter:
        """The row of one parameter.

        **Raises:** `KeyError` where the rig has none of this name.
        """
        rows = {row.name: row for row in self.parameters}
        return rows[name]

    def summary(self, style: Style = "text") -> str:
        """The parameters in the layout of Table 4 of the paper with 95 % intervals, priors and
        warnings; in plain text also the fit of each channel and what the recordings cannot tell.

        **Arguments:**

        - `style`: `"text"`, `"markdown"` or `"latex"` (a `tabular` for the package booktabs).
        """
        return summary_table(self, style)

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types for JSON; infinite and missing numbers become None."""
        rows = [
            {field: _plain(getattr(row, field)) for field in FittedParameter.__dataclass_fields__}
            for row in self.parameters
        ]
        fits: dict[str, dict[str, float | None]] = {name: {} for name in self.recordings}
        for (recording, channel), value in self.fit_percent.items():
            fits[recording][channel] = _plain(value)
        return {
            "rig": self.twin.rig.name,
            "mean_fit_percent": _plain(self.mean_fit_percent),
            "rmse_K": self.rmse,
            "status": self.status,
            "converged": self.converged,
            "iterations": len(self.history) - 1,
            "wall_time_s": self.wall_time,
            "parameters": rows,
            "recordings": {name: dict(values) for name, values in self.recording_values.items()},
            "fit_percent": fits,
            "optima": [
                {
                    "start": one.start,
                    "cost": _plain(one.cost),
                    "apart_K": _plain(one.apart),
                    "rmse_K": _plain(one.rmse),
                    "iterations": one.iterations,
                    "status": one.status,
                    "converged": one.converged,
                    "parameters": {name: _plain(v) for name, v in one.parameters.items()},
                }
                for one in self.optima
            ],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the fitted parameters in the form of a rig file's parameter table (.toml).

        **Raises:** `ParameterError` for another ending, and where the file cannot be written.
        """
        write_parameters(
            path,
            fitted_table(self.twin.rig.parameters, self.parameters),
            recordings={k: v for k, v in self.recording_values.items() if v} or None,
            comment=(
                f"{self.twin.rig.name} matched to {', '.join(self.recordings)}\n"
                f"mean fit {self.mean_fit_percent:.2f} %, RMSE {self.rmse:.4f} K\n{self.status}"
            ),
        )

    def __repr__(self) -> str:
        return (
            f"<Fit of {self.twin.rig.name} to {len(self.recordings)} recordings: "
            f"{self.mean_fit_percent:.2f} %, RMSE {self.rmse:.3f} K, {self.status}>"
        )


def fitted_table(
    table: Mapping[str, Parameter], rows: tuple[FittedParameter, ...]
) -> list[Parameter]:
    """The rig's parameter table with fitted values, bounds, free flags and scopes."""
    return [
        replace(
            table[row.name],
            value=row.value,
            lower=row.lower,
            upper=row.upper,
            free=row.free,
            scope=row.scope,
        )
        for row in rows
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
