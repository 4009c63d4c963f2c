"""Which parameters a match may change, and how they stand in the optimiser's vector."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import MatchError, ParameterError
from ..physics import Twin
from ..rig import Parameter


@final
@dataclass(frozen=True)
class Unknowns:
    """The optimiser's vector: shared parameters first, then each recording's own, one by one.

    Parameters that stay above 0 enter by their logarithm: their relative change is what matters,
    and no step can make them negative. The others, such as temperatures, enter as they are.

    **Arguments:**

    - `shared`: parameters with one value for all recordings.
    - `own`: parameters with a value for each recording.
    - `recordings`: how many recordings there are.
    """

    shared: tuple[Parameter, ...]
    own: tuple[Parameter, ...]
    recordings: int

    @property
    def rows(self) -> tuple[Parameter, ...]:
        """The parameter of each entry of the vector."""
        return self.shared + self.own * self.recordings

    @property
    def size(self) -> int:
        """Length of the vector."""
        return len(self.rows)

    def start(self) -> Float[np.ndarray, " unknowns"]:
        """The parameters' values as a vector."""
        return np.array([_inward(row, row.value) for row in self.rows])

    def lower(self) -> Float[np.ndarray, " unknowns"]:
        """Lower bounds of the vector."""
        return np.array([_inward(row, row.lower) for row in self.rows])

    def upper(self) -> Float[np.ndarray, " unknowns"]:
        """Upper bounds of the vector."""
        return np.array([_inward(row, row.upper) for row in self.rows])

    @property
    def layout(self) -> "Layout":
        """Which entry is what."""
        return Layout(
            shared=tuple((row.name, is_logarithmic(row)) for row in self.shared),
            own=tuple((row.name, is_logarithmic(row)) for row in self.own),
            recordings=self.recordings,
        )

    def values(self, vector: Float[Array, " unknowns"]) -> list[dict[str, Float[Array, ""]]]:
        """Name -> value in the parameter's unit, for each recording."""
        return self.layout.values(vector)


@final
@dataclass(frozen=True)
class Layout:
    """What compiled code knows of the unknowns: their order, not their values or bounds.

    **Arguments:**

    - `shared`, `own`: pairs (name, whether it enters by its logarithm).
    - `recordings`: how many recordings there are.
    """

    shared: tuple[tuple[str, bool], ...]
    own: tuple[tuple[str, bool], ...]
    recordings: int

    def values(self, vector: Float[Array, " unknowns"]) -> list[dict[str, Float[Array, ""]]]:
        """Name -> value in the parameter's unit, for each recording."""
        at = len(self.shared)
        shared = _outward(self.shared, vector[:at])
        values = []
        for _ in range(self.recordings):
            values.append(shared | _outward(self.own, vector[at : at + len(self.own)]))
            at += len(self.own)
        return values


def choose_unknowns(
    twin: Twin,
    recordings: int,
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Unknowns:
    """The unknowns of a match: the rig's parameter table, changed by keywords.

    **Arguments:**

    - `twin`: its values are where the match starts.
    - `recordings`: how many there are.
    - `free`: the free parameters instead of those that the table calls free.
    - `fixed`: parameters to hold.
    - `shared`, `per_recording`: parameters whose scope differs from the table's.
    - `bounds`: other bounds, name -> (lower, upper) in the parameter's unit.

    **Raises:** `ParameterError` for unknown names; `MatchError` where a name is asked for two
    opposite things, bounds exclude the value, or nothing is left free.
    """
    table = twin.rig.parameters
    free = None if free is None else set(free)
    fixed, shared, per_recording = set(fixed), set(shared), set(per_recording)
    bounds = bounds or {}
    groups = {
        "free": free or set(),
        "fixed": fixed,
        "shared": shared,
        "per_recording": per_recording,
        "bounds": set(bounds),
    }
    for group, names in groups.items():
        unknown = sorted(names - set(table))
        if unknown:
            raise ParameterError(
                f"{twin.rig.name}: {group}: unknown parameter {', '.join(unknown)}, allowed are "
                f"{', '.join(table)}"
            )
    for one, other in (("free", "fixed"), ("shared", "per_recording")):
        both = sorted(groups[one] & groups[other])
        if both:
            raise MatchError(f"{', '.join(both)}: found in both {one} and {other}, allowed is one")
    rows = []
    for name, row in table.items():
        if name in fixed or not (row.free if free is None else name in free):
            continue
        lower, upper = (float(bound) for bound in bounds.get(name, (row.lower, row.upper)))
        value = float(twin.parameters[name])
        if not lower <= value <= upper or lower == upper:
            raise MatchError(
                f"{name}: found the start value {value:g} {row.unit}, allowed by its bounds is "
                f"{lower:g} to {upper:g}; move the start or the bounds"
            )
        scope = "recording" if name in per_recording else "shared" if name in shared else row.scope
        rows.append(replace(row, value=value, lower=lower, upper=upper, free=True, scope=scope))
    if not rows:
        raise MatchError(
            f"{twin.rig.name}: no free parameter; set free = true in the rig file's table or pass "
            "free=[...]"
        )
    return Unknowns(
        shared=tuple(row for row in rows if row.scope == "shared"),
        own=tuple(row for row in rows if row.scope == "recording"),
        recordings=recordings,
    )


def is_logarithmic(row: Parameter) -> bool:
    """Whether a parameter enters the vector by its logarithm."""
    return row.lower > 0 and row.offset == 0


def _inward(row: Parameter, value: float) -> float:
    return math.log(value) if is_logarithmic(row) else value


def _outward(
    entries: tuple[tuple[str, bool], ...], vector: Float[Array, " entries"]
) -> dict[str, Float[Array, ""]]:
    return {
        name: jnp.exp(vector[number]) if logarithmic else vector[number]
        for number, (name, logarithmic) in enumerate(entries)
    }
