"""Faults of a virtual rig."""

import re
from dataclasses import dataclass
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp

from .._errors import LinkError
from ..physics import System

_EXAMPLES = (
    "drop=0.01, corrupt=0.001, jumps=164, stall=30/5, disconnect=60, loosen=P1@300/10, fail=P2@600"
)


@final
@dataclass(frozen=True)
class Faults:
    """Faults and their times, in s of the rig.

    **Arguments:**

    - `drop`, `corrupt`: the probabilities that a message is lost, and that bytes of it are changed.
    - `jumps`: the interval of the camera's recalibrations; each changes its offset by the
      `[camera.common_error]` of the rig file. 0: never.
    - `stall`: (interval, duration) of silences.
    - `disconnect`: the interval after which the connection is cut. 0: never.
    - `loosen`: (cell, time, factor); from this time on, the contact resistances of the cell to the
      plate are multiplied by the factor.
    - `fail`: (cell, time); from this time on, the circuit of the cell is interrupted and no current
      flows.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    jumps: float = 0.0
    stall: tuple[float, float] | None = None
    disconnect: float = 0.0
    loosen: tuple[str, float, float] | None = None
    fail: tuple[str, float] | None = None

    @classmethod
    def parse(cls, text: str) -> "Faults":
        """Parses text such as `"drop=0.01,stall=30/5,loosen=P1@300/10"`.

        **Raises:** `LinkError` that quotes the wrong word.
        """
        fields: dict[str, object] = {}
        for word in filter(None, (part.strip() for part in text.split(","))):
            key, _, value = word.partition("=")
            try:
                fields[key] = _value(key, value)
            except (KeyError, ValueError):
                raise LinkError(f"fault: expected words like {_EXAMPLES}, got {word!r}") from None
        return cls(**fields)  # pyright: ignore[reportArgumentType]

    def check_cells(self, cells: tuple[str, ...]) -> None:
        """Checks the cells that faults name.

        **Raises:** `LinkError` if the rig does not have one of them.
        """
        for fault in (self.loosen, self.fail):
            if fault is not None and fault[0] not in cells:
                raise LinkError(
                    f"fault: expected one of the cells {', '.join(cells)}, got {fault[0]!r}"
                )


def loosened(system: System, cell: int, factor: float) -> System:
    """Returns the equations with the contact resistances between a cell and the plate multiplied by
    `factor`."""
    with jax.enable_x64(True):
        side = int(system.wiring.cold[cell])
        other = [
            n for n in range(len(system.capacitance)) if n not in (side, system.wiring.hot[cell])
        ]
        matrix = system.conductance
        change = matrix[side, jnp.array(other)] * (1 / factor - 1)  # of -G_ij, in W/K
        matrix = matrix.at[side, jnp.array(other)].add(change)
        matrix = matrix.at[jnp.array(other), side].add(change)
        matrix = matrix.at[side, side].add(-change.sum())
        matrix = matrix.at[jnp.array(other), jnp.array(other)].add(-change)
        return eqx.tree_at(lambda s: s.conductance, system, matrix)


def failed(system: System, cell: int) -> System:
    """Returns the equations with the circuit of a cell interrupted: no current flows through it."""
    with jax.enable_x64(True):
        resistance = jnp.asarray(system.module.electrical_resistance).at[cell].set(1e9)
        return eqx.tree_at(lambda s: s.module.electrical_resistance, system, resistance)


def _value(key: str, text: str) -> object:
    match key:
        case "drop" | "corrupt":
            if not 0 <= float(text) < 1:
                raise ValueError
            return float(text)
        case "jumps" | "disconnect":
            return _seconds(text)
        case "stall":
            every, _, length = text.partition("/")
            return _seconds(every), _seconds(length)
        case "loosen":
            cell, when, factor = _match(r"(.+)@(.+)/(.+)", text)
            return cell, _seconds(when), _seconds(factor)
        case "fail":
            cell, when = _match(r"(.+)@(.+)", text)
            return cell, _seconds(when)
    raise KeyError(key)


def _match(pattern: str, text: str) -> tuple[str, ...]:
    found = re.fullmatch(pattern, text)
    if found is None:
        raise ValueError
    return found.groups()


def _seconds(text: str) -> float:
    number = float(text)
    if not 0 < number < 1e9:
        raise ValueError
    return number
