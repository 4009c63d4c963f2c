"""A resistive heater."""

from dataclasses import dataclass, field
from typing import final

from ._placement import Placement
from ._relay_window import RelayWindow
from ._value import Value


@final
@dataclass(frozen=True)
class Heater:
    """A resistive heater, which heats one node of the rig and cannot cool it.

    It has either a power or an electrical resistance.

    **Arguments:**

    - `name`: unique among cells and heaters.
    - `node`: the element of the plate or the body that its heat goes into. A heater with a heat
      capacity of its own is also one of the rig's bodies, which has its name.
    - `power`: the power at full duty, to which the heat is proportional, W.
    - `electrical_resistance`: the resistance that the driver connects to its supply, ohm.
    - `placement`: its place on the plate; None if the file lists contacts.
    - `drive_exponent`: the heat is the power times the duty to this power; None for a heat that is
      proportional to the duty.
    - `full_scale`: what a column of a recording in W, V or A has at full duty: the number and this
      unit; None for recordings of the duty.
    - `time_proportional`: the relay that switches it; None where the duty is that of a fast PWM.
    """

    name: str
    node: str
    power: Value | None = None
    electrical_resistance: Value | None = None
    placement: Placement | None = None
    # A matter of recordings, not of temperatures, and so no part of the fingerprint.
    full_scale: tuple[float, str] | None = field(default=None, repr=False)
    # Part of the fingerprint of a rig, but not of one without it.
    drive_exponent: Value | None = field(default=None, repr=False)
    # A twin has the mean over a window, so that its temperatures, and the fingerprint of its rig,
    # which is made of this text, do not depend on it.
    time_proportional: RelayWindow | None = field(default=None, repr=False)
