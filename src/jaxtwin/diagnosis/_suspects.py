"""The faults that a diagnosis looks for, each with a usual size."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import numpy as np

from .._jax_settings import own_settings
from .._name_suggestions import did_you_mean
from ..errors import ObserverError
from ..physics import FAULT_MODELS, Fault, System, Twin
from ..rig import AMBIENT, ZoneSensor
from ..simulation import assembled

# The largest number of channels of which pairs may be swapped; more would give more suspects than
# are useful.
PAIRS = 4

# A usual rate at which a room drifts, K/s.
DRIFT = 0.01


@final
@dataclass(frozen=True)
class Suspect:
    """A possible fault.

    - `name`: its name, such as "loosen P1".
    - `fault`: its size -> the change of the equations, `System -> System`; None if they stay as
      they are.
    - `size`: a usual size. `none`: the size at which there is no fault.
    - `is_reciprocal`: whether its effect is proportional to the change of 1 / size.
    - `is_one_sided`: whether it is no fault in the other direction.
    - `unit`: the unit of the size; "1" for a factor or share.
    - `held`: the channel that is stuck at its reading. `is_drift`: whether the size is the rate at
      which the room drifts.
    """

    name: str
    fault: Callable[[float], Fault] | None
    size: float = 1.0
    none: float = 0.0
    is_reciprocal: bool = False
    is_one_sided: bool = True
    unit: str = "1"
    held: str = ""
    is_drift: bool = False

    def size_of(self, multiple: float) -> float:
        """The size of a multiple of the usual effect; infinite beyond the largest."""
        if not self.is_reciprocal:
            return self.none + multiple * (self.size - self.none)
        inverse = 1 / self.none + multiple * (1 / self.size - 1 / self.none)
        return 1 / inverse if inverse > 0 else math.inf

    def multiple_of(self, size: float) -> float:
        """The multiple of the usual effect that a size has."""
        if self.is_reciprocal:
            return (1 / size - 1 / self.none) / (1 / self.size - 1 / self.none)
        return (size - self.none) / (self.size - self.none)

    @property
    def largest(self) -> float:
        """The largest multiple that means something."""
        if self.unit == "share":
            return 1 / self.size
        if self.is_reciprocal and self.size > self.none:
            return 1 / (1 - self.none / self.size)
        if not self.is_reciprocal and self.none == 1.0 and self.size < 1.0:
            return 1 / (1 - self.size)
        return math.inf


Faults: TypeAlias = Mapping[str, Suspect | Fault] | Sequence[str | Suspect] | None
"""Which faults are looked for: names of usual ones, suspects, or functions by a name; None for all
usual ones."""


def suspects(twin: Twin, channels: Sequence[str] | None = None) -> dict[str, Suspect]:
    """Returns the usual suspects of a rig by their names.

    They are the models of `jaxtwin.physics.FAULT_MODELS` for each part to which they apply, a
    channel that is stuck, and a room that drifts.

    **Arguments:**

    - `twin`: the twin.
    - `channels`: the channels that are read; None for all.
    """
    read = twin.channels if channels is None else tuple(channels)
    rig, index = twin.rig, twin.netlist.index
    cells = [cell.name for cell in rig.cells]
    apart = [heater.name for heater in rig.heaters if heater.node == heater.name]
    with own_settings():
        lost = np.asarray(assembled(twin).ambient_conductance)
    result: list[Suspect] = []

    def add(model: str, part: str, size: float, none: float = 1.0, **options: Any) -> None:
        fault = partial(_of, twin, model, part)
        result.append(Suspect(f"{model} {part}", fault, size, none, **options))

    for part in (*cells, *apart):
        add("loosen", part, 1.5, is_reciprocal=True)
    for part in rig.driven:
        add("fail", part, 1.0, 0.0, unit="share")
        add("age", part, 1.15, is_reciprocal=True)
    for part in cells:
        add("fade", part, 0.9)
        add("reverse", part, 1.0, 0.0, unit="share")
        add("block", part, 3.0, is_reciprocal=True)
    for part in ("supply", *(rig.driven if len(rig.driven) > 1 else ())):
        add("weaken", part, 0.9)
    plate = ["plate"] if twin.wiring.elements else []
    bodies = [body.name for body in rig.bodies]
    elements = range(twin.wiring.elements)
    leaky = {"plate": float(lost[elements].sum())} if plate else {}
    leaky |= {name: float(lost[index[name]]) for name in bodies if lost[index[name]] > 0}
    for part, conductance in leaky.items():
        fault = partial(_scaled, twin, "leak", part, conductance)
        result.append(Suspect(f"leak {part}", fault, 2 * conductance, conductance, unit="W/K"))
    for name in _of_links(twin):
        resistance = float(twin.values_si[name])
        fault = partial(_leaking_link, twin, name, resistance)
        result.append(Suspect(f"leak {name}", fault, 2 / resistance, 1 / resistance, unit="W/K"))
    for part in (*plate, *bodies):
        add("load", part, 1.3, is_reciprocal=True)
    for channel in read:
        add("gain", channel, 0.95, is_one_sided=False)
        add("offset", channel, 0.5, 0.0, is_one_sided=False, unit="K")
        result.append(Suspect(f"stuck {channel}", None, unit="share", held=channel))
    if len(read) <= PAIRS:
        for pair in combinations(read, 2):
            add("swap", "+".join(pair), 1.0, 0.0, unit="share")
    if rig.camera is not None and all(isinstance(c.sensor, ZoneSensor) for c in rig.channels):
        for axis in "xy":
            add("move", axis, 1e-3, 0.0, is_one_sided=False, unit="m")
    if rig.driver.delay is not None:
        add("delay", "command", 1.0, 0.0, unit="s")
    room = Suspect("drift room", None, DRIFT, is_one_sided=False, unit="K/s", is_drift=True)
    return {suspect.name: suspect for suspect in (*result, room)}


def chosen(twin: Twin, faults: Faults, channels: Sequence[str]) -> tuple[Suspect, ...]:
    """The suspects that are asked for.

    **Raises:** `ObserverError` for an unknown name, for something that is none of `Faults`, or if
    there are none.
    """
    usual = suspects(twin, channels)
    if faults is None:
        return tuple(usual.values())
    if isinstance(faults, str):
        faults = [faults]
    given = list(faults.items()) if isinstance(faults, Mapping) else [(None, f) for f in faults]
    result: dict[str, Suspect] = {}
    for name, one in given:
        if isinstance(one, str):
            if one not in usual:
                raise ObserverError(
                    f"faults: expected names of {twin.rig.name}, got {one!r}"
                    f"{did_you_mean([one], usual)}"
                )
            one = usual[one]
        elif callable(one) and name is not None:
            one = Suspect(name, partial(_multiplied, one), is_one_sided=False, unit="multiple")
        if not isinstance(one, Suspect):
            raise ObserverError(
                "faults: expected names, suspects, or functions System -> System by "
                f"their names, got {one!r}"
            )
        result[one.name] = one
    if not result:
        raise ObserverError("faults: expected at least one, got none")
    return tuple(result.values())


# Faults are partial functions of this module, so that a diagnosis can be pickled.


def _multiplied(fault: Fault, size: float) -> Fault:
    """A fault whose size is the multiple of what a function changes in the numbers."""
    return partial(_changed_by, fault, size)


def _changed_by(fault: Fault, size: float, system: System) -> System:
    full = fault(system)
    if jax.tree.structure(full) != jax.tree.structure(system):
        return full  # which is refused
    return jax.tree.map(
        lambda old, new: old + size * (new - old) if eqx.is_inexact_array(old) else new,
        system,
        full,
    )


def _of(twin: Twin, model: str, part: str, size: float) -> Fault:
    return FAULT_MODELS[model](twin, part, np.float64(size))


def _scaled(twin: Twin, model: str, part: str, unit: float, size: float) -> Fault:
    """A fault whose size is a multiple of a unit."""
    return _of(twin, model, part, size / unit)


def _leaking_link(twin: Twin, name: str, resistance: float, size: float) -> Fault:
    """Links of a resistance have a conductance in its place, W/K."""
    return _of(twin, "change", name, 1 / (size * resistance))


def _of_links(twin: Twin) -> list[str]:
    """The parameters that are the resistances between several bodies and the surroundings."""
    links = [link for link in twin.netlist.links if link.role == "body" and link.b == AMBIENT]
    single = [link.resistances[0] for link in links if len(link.resistances) == 1]
    counts = Counter(name for value in single for name, _ in value.powers)
    return [name for name, count in counts.items() if count > 1]
