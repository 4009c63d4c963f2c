"""A recording that was diagnosed: the causes of what changed in it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._display import picture
from .._number_text import short_number
from .._result import AbstractResult, dataset, table
from ..io import Experiment
from ..observers import Observed
from ._suspects import Suspect

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# The model of a fault -> what it means, with its size: as a multiple of the healthy one (`times`,
# or `percent` of it), as a share in per cent, or in a usual unit.
PHRASES = {
    "loosen": "contact of {part} {times} times what it was",
    "age": "electrical resistance of {part} {times} times what it was",
    "block": "sink of {part} blocked, {times} times its resistance",
    "load": "heat capacity of {part} {times} times what it was",
    "leak": "losses of {part} {times} times what they were",
    "fail": "{share} % of {part} without current",
    "fade": "Seebeck coefficient of {part} at {percent} %",
    "reverse": "polarity of {part} swapped",
    "weaken": "voltage of {part} at {percent} %",
    "gain": "gain of {part} at {percent} %",
    "offset": "{part} reads {signed} K off",
    "stuck": "{part} is stuck",
    "swap": "{part} swapped",
    "move": "picture moved by {millimetres} mm along {part}",
    "delay": "commands {seconds} s late",
    "drift": "{part} drifts by {minute} K a minute",
}


def phrase_of(name: str, size: float, healthy: float) -> str:
    """What an explanation means; its own name if it is none of the usual faults."""
    model, _, part = name.partition(" ")
    if model not in PHRASES or not part:
        return name

    def number(value: float) -> str:
        return short_number(value, 2) if math.isfinite(value) else "many"

    ratio = size / healthy if healthy else size
    return PHRASES[model].format(
        part=part.replace("+", " and "),
        times=number(ratio),
        percent=number(100 * ratio),
        share=number(100 * min(size, 1.0)),
        signed=number(size) if size < 0 else f"+{number(size)}",
        seconds=number(size),
        millimetres=number(1000 * size),
        minute=number(60 * size),
    )


HEALTHY = "healthy"
# The names of the two answers that are no suspects.
NONE_OF_THESE = "none of these"

# Explanations are tied with the likeliest if they are less likely by at most this factor.
TIE = 20.0


class Explanation(NamedTuple):
    """A fault that may explain what changed.

    - `name`: of the suspect, or "none of these", which has no size.
    - `probability`: of it, given the recording until the cause was judged.
    - `size`: its size, in `unit` ("1" for factors, "share"). `lower`, `upper`: a 95 % band.
      `healthy`: the size of no fault.
    - `onset`: when it began, s. `onset_lower`, `onset_upper`: a 95 % band.
    """

    name: str
    probability: float
    size: float
    lower: float
    upper: float
    healthy: float
    unit: str
    onset: float
    onset_lower: float
    onset_upper: float

    @property
    def standard_error(self) -> float:
        """A fourth of the band of the size."""
        return (self.upper - self.lower) / 4

    @property
    def phrase(self) -> str:
        """It in a few words with its size, such as "contact of P1 2.5 times what it was"."""
        return phrase_of(self.name, self.size, self.healthy)

    @property
    def text(self) -> str:
        """It as text."""
        begin = f"{self.name} since {self.onset:.0f} s"
        if not math.isfinite(self.size):
            return f"{begin}, probability {self.probability:.2g}"
        unit, usual = f" {self.unit}", f" in place of {self.healthy:.3g}"
        if self.unit in ("1", "share", "multiple"):
            unit = usual = ""
        elif self.healthy == 0:
            usual = ""
        return (
            f"{begin}, size {self.size:.3g} ({self.lower:.3g} to {self.upper:.3g}){unit}{usual}, "
            f"probability {self.probability:.2g}"
        )


# The misfit above which a suspect explains a change only in part.
PARTIAL = 1.25


@final
@dataclass(frozen=True)
class Cause:
    """Why something changed.

    - `explanations`: the faults that may explain it, the likeliest first.
    - `found`: when the probability that something had changed passed 95 %, s. `until`: when
      it was over, s; None if it was there at the end.
    - `misfit`: the mean square of the innovations that the best suspect leaves, as a multiple of
      that in healthy recordings, 1 at least. It is 1 if the suspect explains all.
    """

    explanations: tuple[Explanation, ...]
    found: float
    until: float | None
    misfit: float

    @property
    def best(self) -> Explanation:
        """The likeliest explanation."""
        return self.explanations[0]

    @property
    def name(self) -> str:
        """Its name."""
        return self.best.name

    @property
    def size(self) -> float:
        """Its size."""
        return self.best.size

    @property
    def onset(self) -> float:
        """When it began, s."""
        return self.best.onset

    @property
    def probability(self) -> float:
        """Its probability."""
        return self.best.probability

    @property
    def is_partial(self) -> bool:
        """Whether the best suspect leaves more than noise: two faults at once, or one that is none
        of the suspects and resembles it."""
        return self.misfit > PARTIAL

    @property
    def tie(self) -> tuple[str, ...]:
        """The names of the explanations between which the readings do not decide, the likeliest
        first."""
        least = self.best.probability / TIE
        return tuple(
            explanation.name
            for explanation in self.explanations
            if explanation.probability >= least
        )


@final
@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(AbstractResult):
    """What `jaxtwin.diagnose` found in a recording.

    **Arguments:**

    - `observed`: the recording and its observer.
    - `suspects`: the faults that were looked for.
    - `causes`: what changed and why, in the order of the onsets.
    - `names`: the suspects' names, then "none of these" and "healthy".
    - `probabilities`: of each of `names` after each sample, given the readings up to it.
    """

    observed: Observed
    suspects: tuple[Suspect, ...]
    causes: tuple[Cause, ...]
    names: tuple[str, ...]
    probabilities: Float[np.ndarray, "samples names"]

    @property
    def experiment(self) -> Experiment:
        """The recording."""
        return self.observed.experiment

    @property
    def time(self) -> Float[np.ndarray, " samples"]:
        """The times of the samples, s."""
        return self.observed.time

    @property
    def ties(self) -> list[tuple[str, ...]]:
        """The names between which the readings do not decide, of each cause that has several."""
        return [cause.tie for cause in self.causes if len(cause.tie) > 1]

    def summary(self) -> str:
        """The causes as text, a line for each, with lines for what else explains it."""
        name = self.experiment.name or "recording"
        if not self.causes:
            return f"{name}: healthy; none of {len(self.suspects)} suspects"
        lines = [f"{name}: {len(self.causes)} cause{'s' if len(self.causes) > 1 else ''}"]
        for cause in self.causes:
            until = "" if cause.until is None else f", over at {cause.until:.0f} s"
            lines.append(f"  {cause.best.text}, found at {cause.found:.0f} s{until}")
            if cause.is_partial and cause.name != NONE_OF_THESE:
                lines.append(f"    it explains a part: {cause.misfit:.2g} times the noise is left")
            lines += [
                f"    or {explanation.text}"
                for explanation in cause.explanations[1:]
                if explanation.name in cause.tie
            ]
        return "\n".join(lines)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each explanation of each cause; a recording without causes
        has the row "healthy"."""
        if not self.causes:
            healthy = float(self.probabilities[-1, -1])
            return table([{"cause": 0, "name": HEALTHY, "probability": healthy}])
        return table(
            {"cause": number}
            | explanation._asdict()
            | {"found": cause.found, "until": cause.until, "misfit": cause.misfit}
            for number, cause in enumerate(self.causes)
            for explanation in cause.explanations
        )

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: probability (time, answer)."""
        return dataset(
            {
                "probability": ("time answer", self.probabilities, "1"),
                "time": ("time", self.time, "s"),
            },
            {"recording": self.experiment.name},
            answer=self.names,
        )

    def _for_json(self) -> dict[str, Any]:
        keys = {"onset": "onset_s", "onset_lower": "onset_lower_s", "onset_upper": "onset_upper_s"}
        return {
            "recording": self.experiment.name,
            "duration_s": self.experiment.duration,
            "suspects": [suspect.name for suspect in self.suspects],
            "causes": [
                {
                    "found_s": cause.found,
                    "until_s": cause.until,
                    "misfit": cause.misfit,
                    "tie": cause.tie,
                    "explanations": [
                        {keys.get(key, key): value for key, value in explanation._asdict().items()}
                        | {"phrase": explanation.phrase}
                        for explanation in cause.explanations
                    ],
                }
                for cause in self.causes
            ],
        }

    def plot(self) -> "Figure":
        """Draws the readings, and the probabilities over time.

        **Returns:** the figure.
        """
        return picture("plot_diagnosis", self)

    def __repr__(self) -> str:
        name = self.experiment.name or "a recording"
        return (
            f"<Diagnosis {name}: {'; '.join(cause.best.text for cause in self.causes) or HEALTHY}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        headings = {"name": "fault", "onset": "onset, s"}
        rows = self.to_dataframe().filter(["name", "probability", "size", "onset"])
        return rows.rename(columns=headings)
