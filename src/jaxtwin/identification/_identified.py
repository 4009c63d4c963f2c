"""The result of an identification."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from .._arguments import finite_number, whole_number
from .._result import AbstractResult, table
from .._statistics import QUANTILE_975
from .._toml_text import toml_inline, toml_key
from ..errors import MatchError
from ..io import Experiment
from ..matching import Band, Fit, prediction_band
from ..rig import Rig
from ._screening import Rivals

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


def rig_text(tables: Mapping[str, Any], comment: str) -> str:
    """The text of a rig file, with a comment at its top."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()] + [""]
    rounded = _rounded(tables)
    for key, value in rounded.items():
        if key == "parameters":
            continue
        if isinstance(value, list):
            lines += ["", f"{key} = [", *(f"    {toml_inline(item)}," for item in value), "]"]
        else:
            lines.append(f"{key} = {toml_inline(value)}")
    lines += [
        "",
        "[parameters]",
        *(f"{toml_key(name)} = {toml_inline(row)}" for name, row in rounded["parameters"].items()),
    ]
    return "\n".join(lines) + "\n"


def _rounded(value: Any) -> Any:
    """A value with numbers of six digits, for people to read."""
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


# The number of schedules of which a next recording is one.
SCHEDULES = 80


@final
@dataclass(frozen=True)
class Candidate:
    """A structure that was tried.

    **Arguments:**

    - `structure`: in words.
    - `unknowns`: the number of its parameters.
    - `cost`: minus the logarithm of its posterior probability, up to a constant, with what the
      held-out blocks add for those that were judged.
    - `rmse`: channel -> root mean square error of the matched readings, K.
    - `held_out`: origin -> root mean square error over all channels from there to the end, of a
      match to what is before, K. An origin is a fraction of the recording; empty for a structure
      that was not judged.
    - `far_from_prior`: parameters far from what was expected of them, where the log contradicts
      the structure.
    """

    structure: str
    unknowns: int
    cost: float
    rmse: Mapping[str, float]
    held_out: Mapping[float, float]
    far_from_prior: tuple[str, ...]

    @property
    def held_out_rmse(self) -> float:
        """Root mean square over all origins, K; NaN if it was not judged."""
        errors = np.array(list(self.held_out.values()))
        return float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan


@final
@dataclass(frozen=True, repr=False, eq=False)
class Identified(AbstractResult):
    """A twin that was found from recordings alone.

    **Arguments:**

    - `fit`: the match of the chosen structure, for `validate`, `observe`, `monitor`, control and
      export.
    - `candidates`: all structures: the chosen one, the others that were judged, the most probable
      first, and the rest.
    - `baselines`: simple model -> root mean square error over the same held-out blocks, K.
    - `notes`: what a reader should know of the log, in sentences.
    """

    fit: Fit
    candidates: tuple[Candidate, ...]
    baselines: Mapping[str, float]
    notes: tuple[str, ...]
    _rivals: Rivals

    @property
    def rig(self) -> Rig:
        """The rig file that was written for the log; `rig.text` is its text."""
        return self.fit.twin.rig

    def predict(self, experiment: Experiment) -> Band:
        """Predicts an experiment, with a band of 95 % that contains the error of the model itself.

        **Arguments:**

        - `experiment`: the inputs. If it begins with a recording that was matched, the prediction
          goes on from there; else room and start are estimated from its first minute.

        **Raises:** the errors of `prediction_band`.
        """
        begun = [
            number
            for number, matched in enumerate(self.fit.experiments)
            if experiment.begins_with(matched)
        ]
        name = self.fit.recordings[begun[0]] if begun else None
        band = prediction_band(self.fit, name, experiment=experiment)
        half = (band.upper - band.middle) / QUANTILE_975
        disagreement = self._rivals.disagreement(experiment, begun[0] if begun else 0)
        wide = QUANTILE_975 * np.hypot(half, disagreement)
        return Band(band.run, band.middle - wide, band.middle + wide, band.level)

    def next_recording(
        self,
        duration: float | int,
        *,
        steps: int = 8,
        step: float | int | None = None,
        highest: float | int | None = None,
        seed: int = 0,
    ) -> Experiment:
        """Designs the recording that would tell the probable structures apart best.

        Of many random schedules of duties, the one over which their predictions disagree most is
        chosen. It begins as the first recording does.

        **Arguments:**

        - `duration`: s.
        - `steps`: the number of duties, each held for an equal part of it.
        - `step`: the time between two samples, s; by default a 300th of the duration.
        - `highest`: the highest temperature of any channel, degC; by default the highest that was
          recorded.
        - `seed`: of the schedules.

        **Raises:** `MatchError` if all schedules become too hot.
        """
        duration = finite_number("next_recording: duration", duration, MatchError)
        whole_number("next_recording: steps", steps, 2, MatchError)
        period = duration / 300 if step is None else finite_number("step", step, MatchError)
        limits = self.fit.model_error.highest
        hottest = np.array(
            [limits[name] if highest is None else float(highest) for name in self.fit.channels[0]]
        )
        random = np.random.default_rng(seed)
        time = np.arange(0.0, duration + period / 2, period)
        held = np.minimum((time / duration * steps).astype(int), steps - 1)
        lowest = np.array(self.rig.lowest_duty)
        plans = [
            Experiment(
                time,
                levels[held],
                channels=self.fit.channels[0],
                cells=self.rig.driven,
                name="next recording",
            )
            # Small duties too, as a device that must not become hot needs.
            for scale in (1.0, 0.7, 0.4, 0.2)
            for levels in scale * random.uniform(lowest, 1.0, (SCHEDULES // 4, steps, len(lowest)))
        ]
        separations = [self._rivals.separation(plan, hottest) for plan in plans]
        best = int(np.argmax(separations))
        if not np.isfinite(separations[best]):
            raise MatchError(
                f"next_recording: highest: expected a temperature that a schedule keeps, got "
                f"{float(hottest.max()):g} degC"
            )
        return plans[best]

    def summary(self) -> str:
        """The structure, its rivals and how far to trust it, as text."""
        best = self.candidates[0]
        rates = self.fit.model_error.growth
        fastest = max(rates, key=lambda channel: rates[channel])
        judged = [row for row in self.candidates[1:] if row.held_out]
        close = [row for row in judged if row.cost - best.cost < math.log(20)]
        lines = [
            f"{self.rig.name}: {best.structure}",
            f"{best.unknowns} unknowns, matched within {self.fit.rmse:.3g} K",
            f"held-out blocks: {best.held_out_rmse:.3g} K; "
            + ", ".join(f"{name} {error:.3g} K" for name, error in self.baselines.items()),
            (
                "the error of the model itself grows by "
                f"{'up to ' * (len(rates) > 1)}{1000 * rates[fastest]:.2g} mK/s ({fastest})"
            ),
        ]
        if close:
            lines.append(
                f"{len(close)} other structures are as probable within a factor of 20: the log "
                "does not tell them apart"
            )
            lines += [f"  {row.structure}: {row.held_out_rmse:.3g} K held out" for row in close[:5]]
            lines.append("next_recording(duration) designs a recording that would tell them apart")
        if best.far_from_prior:
            lines.append(f"far from what was expected: {', '.join(best.far_from_prior)}")
        return "\n".join([*lines, *self.notes])

    def _for_json(self) -> dict[str, Any]:
        return {
            "structure": self.candidates[0].structure,
            "candidates": [row.__dict__ for row in self.candidates],
            "baselines": self.baselines,
            "notes": self.notes,
            "fit": self.fit.to_dict(),
        }

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each structure."""
        return table(
            {
                "structure": row.structure,
                "unknowns": row.unknowns,
                "cost": row.cost,
                "held-out RMSE, K": row.held_out_rmse,
                **{f"RMSE {channel}, K": error for channel, error in row.rmse.items()},
            }
            for row in self.candidates
        )

    def to_xarray(self) -> "xarray.Dataset":
        """The same table as a dataset over the structures."""
        return self.to_dataframe().rename_axis("candidate").to_xarray()

    def plot(self) -> "Figure":
        """Plots the matched recordings: `Fit.plot`."""
        return self.fit.plot()

    def __repr__(self) -> str:
        return (
            f"<Identified {self.rig.name}: {self.candidates[0].structure}, "
            f"RMSE {self.fit.rmse:.3g} K>"
        )
