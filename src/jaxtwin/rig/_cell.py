"""A thermoelectric cell on the plate, with its sink."""

from dataclasses import dataclass, field
from typing import final

from ._input import Switched
from ._placement import Placement
from ._value import Value


@final
@dataclass(frozen=True)
class Cell:
    """A thermoelectric cell between the plate and a sink, Fig. 9b of the paper.

    **Arguments:**

    - `name`: unique in the rig.
    - `seebeck_coefficient`: the Seebeck coefficient of the whole module, V/K.
    - `electrical_resistance`: ohm.
    - `thermal_resistance`: between the two sides, K/W.
    - `side_capacitance`: the heat capacity of each side, J/K.
    - `contacts`: pairs (plate element or body, contact resistance to the plate side in K/W).
    - `sink_resistance`: the resistance from the far side to the surroundings, or to the sink's mass
      if it has one, K/W; None for a far side that is isolated.
    - `sink`: the body that replaces the surroundings as the other end of this resistance; None for
      the surroundings.
    - `sink_capacitance`, `sink_air_resistance`: the sink's mass (J/K) and its resistance to the
      surroundings (K/W), which is None if the sink is isolated.
    - `initial_temperature`: the initial temperature of both sides, K; None means that each side
      starts at the temperature of the plate or of the sink, which it touches.
    - `sink_initial_temperature`: the initial temperature of the sink, K; None means that of the
      plate.
    - `area`: the area of the plate that the cell covers, m^2; None for that of one of the elements
      that it touches, on average.
    - `placement`: its place on the plate, from which its contacts and the area that it covers
      follow; None if the file lists contacts.
    - `full_scale`: what a column of a recording in W, V or A has at full duty: the number and this
      unit; None for recordings of the duty.
    """

    name: str
    seebeck_coefficient: Value
    electrical_resistance: Value
    thermal_resistance: Value
    side_capacitance: Value
    contacts: tuple[tuple[str, Value], ...]
    sink_resistance: Value | Switched | None = None
    sink_capacitance: Value | None = None
    sink_air_resistance: Value | Switched | None = None
    initial_temperature: Value | None = None
    sink_initial_temperature: Value | None = None
    sink: str | None = None
    area: float | None = None
    placement: Placement | None = None
    # A matter of recordings, not of temperatures, and so no part of the fingerprint.
    full_scale: tuple[float, str] | None = field(default=None, repr=False)
