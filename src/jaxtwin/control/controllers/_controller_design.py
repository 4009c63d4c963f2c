"""For what a controller was designed: references, and what is to be small."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, final

from ._controller_fields import Kind, Refuse, quantity

DURATION = Kind("a time", "s", "900 s")


@final
class ControllerDesign(NamedTuple):
    """For what a controller was designed, which its file may keep: with these arguments `tune` and
    `retune` find its parameters again on another twin.

    - `references`: as in `simulate_closed_loop`, as text: `"0:30,300:45,600:30"`.
    - `duration`: s.
    - `objective`: measure -> weight, as in `tune`.
    """

    references: str
    duration: float
    objective: Mapping[str, float]

    def file_lines(self) -> list[str]:
        """Returns the lines of a controller's file."""
        weights = ", ".join(f"{name} = {float(one)!r}" for name, one in self.objective.items())
        return [
            f"design.references = {json.dumps(self.references)}",
            f'design.duration = "{float(self.duration)!r} s"',
            f"design.objective = {{ {weights} }}",
        ]


def design_of(data: Mapping[str, Any], refuse: Refuse) -> ControllerDesign | None:
    """Reads the design of a controller's file; None if there is none.

    **Arguments:**

    - `data`: the contents of the file. `refuse`: raises the error of a field.
    """
    table = data.get("design")
    if table is None:
        return None
    if not isinstance(table, dict) or set(table) != {"references", "duration", "objective"}:
        refuse("design", f"expected a table of references, duration and objective, got {table!r}")
    references, objective = table["references"], table["objective"]
    if not isinstance(references, str) or not references:
        refuse("design.references", f"expected text such as '0:30,300:45', got {references!r}")
    duration = quantity(table["duration"], "design.duration", DURATION, refuse, is_list=False)
    if not isinstance(objective, dict) or not objective:
        refuse("design.objective", f"expected measure = weight, got {objective!r}")
    weights = {}
    for name, weight in objective.items():
        is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
        # NaN is not below infinity.
        if not is_number or not 0 <= weight < float("inf"):
            refuse(f"design.objective.{name}", f"expected a number of at least 0, got {weight!r}")
        weights[name] = float(weight)
    return ControllerDesign(references, duration, weights)
