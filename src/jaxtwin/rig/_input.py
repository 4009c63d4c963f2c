"""Inputs of a rig besides the duty: the state of a lid, the speed of a fan, a measured voltage."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from ._value import Value


@final
@dataclass(frozen=True)
class Input:
    """A quantity that changes during a run and is known, such as a column of a recording.

    An input has states, such as `("closed", "open")`, or is a number with a unit.

    **Arguments:**

    - `name`: a Python identifier, unique among the inputs and parameters of the rig.
    - `value`: its value where none is stated, in `unit`; for states, the position of one of them.
    - `unit`: the unit as in the rig file.
    - `states`: the names of its states, in the order of their numbers 0, 1, ...; none for a number.
    - `description`: one line for tables.
    - `scale`, `offset`: SI value = scale * value + offset.
    """

    name: str
    value: float
    unit: str = ""
    states: tuple[str, ...] = ()
    description: str = ""
    scale: float = 1.0
    offset: float = 0.0

    def share(self, state: str) -> str:
        """The name of the share of a state, 0 to 1, in a `Value`."""
        return f"{self.name}={state}"

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which a `Value` depends on this input."""
        return (self.name, *(self.share(state) for state in self.states))

    def shares(self, level: Any) -> dict[str, Any]:
        """The numbers of these names at a level of the input.

        A level between the numbers of two states, such as the mean over a step in which the lid is
        opened, is shared between them.

        **Arguments:**

        - `level`: the number of a state, or the value in SI units; a float or an array.
        """
        between = {
            self.share(state): _hat(level - number) for number, state in enumerate(self.states)
        }
        return {self.name: level, **between}

    @property
    def level(self) -> float:
        """Its value where none is stated: the number of a state, or the value in SI units."""
        return self.scale * self.value + self.offset

    @property
    def nominal(self) -> dict[str, float]:
        """The `shares` of its level where none is stated."""
        return self.shares(self.level)


def _hat(distance: Any) -> Any:
    """1 at 0, falling to 0 at a distance of 1."""
    nearness = 1 - abs(distance)
    return nearness * (nearness > 0)


@final
@dataclass(frozen=True)
class Switched:
    """A value for each state of an input: `{ closed = "R_wall", open = "R_open", by = "lid" }`.

    **Arguments:**

    - `values`: pairs (name of the share of a state, value in that state).
    """

    values: tuple[tuple[str, Value], ...]

    def __mul__(self, factor: Value | float | int) -> "Switched":
        return Switched(tuple((share, value * factor) for share, value in self.values))


def conductances(resistance: Value | Switched) -> tuple[Value, ...]:
    """The conductance of a resistance that inputs change, as the terms of a sum, W/K.

    A conductance is used because it stays finite where a fan stands still and where a path is
    closed; between two states it changes linearly.
    """
    if isinstance(resistance, Value):
        return (1 / resistance,)
    return tuple(Value(1.0, ((share, 1.0),)) / value for share, value in resistance.values)


def depends_on(value: Value, inputs: tuple[Input, ...]) -> bool:
    """Whether a value depends on one of these inputs."""
    names = {name for one in inputs for name in one.names}
    return any(name in names for name, _ in value.powers)


def nominal_inputs(inputs: tuple[Input, ...]) -> Mapping[str, float]:
    """The numbers of all inputs where none is stated, by the names that a `Value` has for them."""
    return {name: number for one in inputs for name, number in one.nominal.items()}
