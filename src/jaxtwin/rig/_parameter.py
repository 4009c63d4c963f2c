"""One row of a rig's parameter table."""

import math
from dataclasses import dataclass
from typing import Any, Literal, final

# Whether there is one value for all recordings, one for each group, or one for each recording.
Scope = Literal["shared", "group", "recording"]


@final
@dataclass(frozen=True)
class Parameter:
    """A number that a rig leaves open to matching, sweeps and sensitivity analysis.

    **Arguments:**

    - `name`: a Python identifier, unique in the rig.
    - `value`, `lower`, `upper`: the value and its bounds in `unit`; a missing bound is infinite.
    - `unit`: the unit as in the rig file, for example `"K/W"` or `"degC"`.
    - `free`: whether matching may change it.
    - `scope`: `"shared"` by all recordings, or one value per `"group"` of them, such as a day, or
      per `"recording"`.
    - `description`: one line for tables.
    - `prior_spread`: the standard deviation of the prior: relative (that of the logarithm) if the
      lower bound is above 0 and the unit is not degC, otherwise in `unit`. None without a prior.
    - `prior_value`: the centre of the prior; by default the `value` in the rig file.
    - `group_spread`: for the scope `"group"`, the standard deviation of a group's value about the
      value that all groups share, measured as `prior_spread` is. `prior_spread` is then that of the
      shared value.
    - `scale`, `offset`: SI value = scale * value + offset; the offset is 0 except for degC.
    """

    name: str
    value: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = ""
    free: bool = False
    scope: Scope = "shared"
    description: str = ""
    scale: float = 1.0
    offset: float = 0.0
    prior_spread: float | None = None
    prior_value: float | None = None
    group_spread: float | None = None

    @property
    def standard_deviation(self) -> float | None:
        """The prior standard deviation of a single value: that of the shared value, combined with
        that of a group about it. None without a prior."""
        if self.prior_spread is None or self.group_spread is None:
            return self.prior_spread
        return math.hypot(self.prior_spread, self.group_spread)

    @property
    def is_logarithmic(self) -> bool:
        """Whether the parameter is matched by its logarithm: it is above 0 and its unit is not
        degC."""
        return self.lower > 0 and self.offset == 0

    def to_entry(self, value: float) -> float:
        """Returns the entry of a value in the vector of a match: its logarithm, or the value
        itself."""
        return math.log(value) if self.is_logarithmic else value

    def from_entry(self, entry: float) -> float:
        """Returns the value of an entry in the vector of a match."""
        return math.exp(entry) if self.is_logarithmic else entry

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
