"""One row of a rig's parameter table."""

import math
from dataclasses import dataclass
from typing import Any, Literal, final


@final
@dataclass(frozen=True)
class Parameter:
    """A number that a rig leaves open to matching, sweeps and sensitivity analysis.

    **Arguments:**

    - `name`: a Python identifier, unique in the rig.
    - `value`, `lower`, `upper`: the value and its bounds in `unit`; a missing bound is infinite.
    - `unit`: as written in the rig file, for example `"K/W"` or `"degC"`.
    - `free`: whether matching may change it.
    - `scope`: `"shared"` by all recordings, or one value per `"recording"`.
    - `description`: one line for tables.
    - `prior_spread`: standard deviation of what is known about the value beforehand: relative (of
      its logarithm) where the lower bound is above 0 and it is no degC, else in `unit`. None where
      nothing is.
    - `prior_value`: the middle of that, `value` as the rig file has it unless it says otherwise.
    - `scale`, `offset`: SI value = scale * value + offset; the offset is 0 but for degC.
    """

    name: str
    value: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = ""
    free: bool = False
    scope: Literal["shared", "recording"] = "shared"
    description: str = ""
    scale: float = 1.0
    offset: float = 0.0
    prior_spread: float | None = None
    prior_value: float | None = None

    @property
    def is_logarithmic(self) -> bool:
        """Whether its relative change is what matters: it stays above 0 and is no degC."""
        return self.lower > 0 and self.offset == 0

    def to_si(self, value: Any) -> Any:
        """A value (float or array) given in `unit`, in SI units."""
        return self.scale * value + self.offset

    def from_si(self, value: Any) -> Any:
        """A value (float or array) given in SI units, in `unit`."""
        return (value - self.offset) / self.scale

    def __str__(self) -> str:
        bounds = f"{self.lower:g} ... {self.upper:g}"
        kind = f"{'free' if self.free else 'fixed'}, {self.scope}"
        return f"{self.name} = {self.value:g} {self.unit} ({bounds}; {kind})".replace("  ", " ")
