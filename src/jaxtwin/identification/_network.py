"""The family of networks that identification chooses from, as tables of a rig file.

For each place, which is a channel, there is a block that loses heat to the room. To it may be added
a wall behind it, natural convection, radiation and the lag of its sensor; to each heater a heat
capacity of its own and a law of its drive; between two places a link.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ..physics._heat_loss import STEFAN_BOLTZMANN
from ..rig._plate import FILM_REFERENCE
from ._baselines import FirstOrder
from ._log import ScreenedLog

# A log says nothing of the power: every heater has this one, and all capacities and resistances are
# relative to it, W.
NOMINAL_POWER = 10.0

# `match` finds that the errors of a structure are correlated, and counts some five independent
# readings where the screening counts `EFFECTIVE_SAMPLES`: with priors so much wider both weigh
# readings and priors alike.
WEAKENED = 3.0


@final
@dataclass(frozen=True)
class Unknown:
    """A parameter of the family.

    **Arguments:**

    - `name`, `unit`, `description`: as in the rig file.
    - `prior`: what is expected of it, in its unit.
    - `spread`: the standard deviation of that, of its logarithm if it is positive.
    - `part`: the part of a network that needs it; empty for what every network has.
    - `absent`: the value with which a network that contains the part behaves as one without.
    - `is_positive`: whether it is searched by its logarithm.
    - `is_own`: whether each recording has a value of its own.
    """

    name: str
    unit: str
    description: str
    prior: float
    spread: float
    part: str = ""
    absent: float = math.nan
    is_positive: bool = True
    is_own: bool = False


@final
@dataclass(frozen=True)
class Scale:
    """The size of what a channel does, from a first-order system fitted to it.

    **Arguments:**

    - `resistance`: K/W.
    - `time_constant`: s.
    - `sample_time`: of the screened recording, s.
    """

    resistance: float
    time_constant: float
    sample_time: float

    @classmethod
    def of(cls, first: FirstOrder, log: ScreenedLog, swing: float) -> "Scale":
        """The size that a first-order system has.

        A gain that the log does not determine is at least `swing`, the standard deviation of the
        readings, K.
        """
        span = log.experiment.duration
        strongest = int(
            np.argmax(np.abs(first.gains) * np.asarray(log.experiment.duty).std(axis=0))
        )
        # Of a slower system the log shows only the beginning.
        tau = min(first.time_constant, 3 * span)
        rise = max(abs(first.gains[strongest]) * tau / first.time_constant, swing)
        return cls(float(rise) / NOMINAL_POWER, tau, log.sample_time)

    @property
    def capacitance(self) -> float:
        """J/K."""
        return self.time_constant / self.resistance


@final
@dataclass(frozen=True)
class Family:
    """All networks for the channels and inputs of a log.

    **Arguments:**

    - `channels`, `inputs`: names.
    - `scales`: of each channel.
    - `heated`: for each input, the number of the channel that it heats.
    - `room`: what is expected of the room, degC, and the standard deviation of that, K.
    - `start`: the first reading of each channel, degC.
    - `has_levels`: whether the only input has values between 0 and 1, so that its heat need not be
      proportional to it.
    """

    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    scales: tuple[Scale, ...]
    heated: tuple[int, ...]
    room: tuple[float, float]
    start: tuple[float, ...]
    has_levels: bool

    @classmethod
    def of(
        cls,
        log: ScreenedLog,
        firsts: Sequence[FirstOrder],
        room: float | None,
        has_levels: bool,
    ) -> "Family":
        """The family for a log.

        **Arguments:**

        - `log`: the first recording.
        - `firsts`: the first-order system of each channel, fitted to it.
        - `room`: the temperature of the room, if it is known, degC.
        - `has_levels`: as in the class.
        """
        experiment, readings = log.experiment, log.temperatures
        duty = np.asarray(experiment.duty)
        scales = [
            Scale.of(first, log, float(np.nanstd(column)))
            for first, column in zip(firsts, readings.T, strict=True)
        ]
        # A channel that is still on its way up tells little of its own size: places are taken as
        # alike.
        settled = [n for n, f in enumerate(firsts) if f.time_constant < experiment.duration]
        if settled:
            scales = [scales[n if n in settled else settled[0]] for n in range(len(scales))]
        # An input heats the place that it warms fastest.
        rates = np.array([first.gains / first.time_constant for first in firsts])
        start = tuple(float(column[np.isfinite(column)][0]) for column in readings.T)
        return cls(
            channels=experiment.channels,
            inputs=experiment.cell_names,
            scales=tuple(scales),
            heated=tuple(int(place) for place in rates.argmax(axis=0)),
            room=_room_prior(start, bool(duty[0].any())) if room is None else (room, 0.5),
            start=start,
            has_levels=has_levels,
        )

    def parts(self) -> tuple[str, ...]:
        """The parts that a network may have, such as `"wall T1"`."""
        places = range(1, len(self.channels) + 1)
        result = [
            f"{part} {place}"
            for place in places
            for part in ("linear", "lag", "wall", "shell", "convection", "radiation")
        ]
        result += [f"heater {number}" for number in range(1, len(self.inputs) + 1)]
        result += ["power law 1"] * self.has_levels
        result += [f"link {a} {b}" for a in places for b in places if a < b]
        return (*result, "board 1") if len(self.channels) > 1 else tuple(result)

    def unknowns(self) -> tuple[Unknown, ...]:
        """All parameters."""
        room, spread = self.room
        result = [Unknown("T_room", "degC", "room", room, spread, is_positive=False, is_own=True)]
        for place, scale in enumerate(self.scales, 1):
            result += _place_unknowns(place, scale, room, self.start[place - 1])
        for number, place in enumerate(self.heated, 1):
            scale = self.scales[place]
            if number > 1:
                result.append(
                    Unknown(
                        f"P_{number}",
                        "W",
                        f"power of {self.inputs[number - 1]} at full duty",
                        NOMINAL_POWER,
                        1.0,
                    )
                )
            part = f"heater {number}"
            result += [
                Unknown(
                    f"C_heater_{number}",
                    "J/K",
                    f"heat capacity of heater {number}",
                    0.3 * scale.capacitance,
                    1.3,
                    part,
                    1e-3 * scale.capacitance,
                ),
                Unknown(
                    f"R_heater_{number}",
                    "K/W",
                    f"heater {number} to its block",
                    0.3 * scale.resistance,
                    1.3,
                    part,
                    1e-3 * scale.resistance,
                ),
            ]
            if self.has_levels:
                result.append(
                    Unknown(
                        f"p_{number}",
                        "",
                        f"exponent of the drive of heater {number}",
                        1.3,
                        0.3,
                        f"power law {number}",
                        1.0,
                    )
                )
        for a, first in enumerate(self.scales, 1):
            for b, second in enumerate(self.scales, 1):
                if a < b:
                    both = math.sqrt(first.resistance * second.resistance)
                    result.append(
                        Unknown(
                            f"R_{a}_{b}",
                            "K/W",
                            f"between places {a} and {b}",
                            3 * both,
                            1.5,
                            f"link {a} {b}",
                            1e5 * both,
                        )
                    )
        if len(self.channels) > 1:
            c = sum(scale.capacitance for scale in self.scales)
            r = 1 / sum(1 / scale.resistance for scale in self.scales)
            result += [
                Unknown(
                    "C_board_1",
                    "J/K",
                    "heat capacity of the board under all places",
                    c,
                    1.3,
                    "board 1",
                    c,
                ),
                Unknown(
                    "R_board_room_1", "K/W", "from the board to the room", r, 1.3, "board 1", r
                ),
                Unknown(
                    "T_board_1",
                    "degC",
                    "start of the board",
                    self.start[0],
                    1.0 if abs(self.start[0] - room) < 3 else 10.0,
                    "board 1",
                    self.start[0],
                    is_positive=False,
                    is_own=True,
                ),
            ]
            result += [
                Unknown(
                    f"R_board_{place}",
                    "K/W",
                    f"from place {place} to the board",
                    scale.resistance,
                    1.3,
                    "board 1",
                    1e4 * scale.resistance,
                )
                for place, scale in enumerate(self.scales, 1)
            ]
        return tuple(result)

    def tables(self, parts: Set[str], values: Mapping[str, float] | None = None) -> dict[str, Any]:
        """The tables of the rig file of a network.

        **Arguments:**

        - `parts`: the parts that it has.
        - `values`: parameter -> its value, by default what is expected.
        """
        bodies, links, channels = [], [], []
        for place, channel in enumerate(self.channels, 1):
            block = f"block_{place}"
            bodies.append(
                {
                    "name": block,
                    "capacitance": f"C_{place}",
                    "initial_temperature": f"T_start_{place}",
                }
            )
            if f"linear {place}" in parts:
                links.append({"resistance": f"R_{place}", "between": [f"{block}-ambient"]})
            if f"convection {place}" in parts:
                links.append({"convection": f"G_{place}", "between": [f"{block}-ambient"]})
            if f"radiation {place}" in parts:
                links.append({"radiating_area": f"A_{place}", "between": [f"{block}-ambient"]})
            for part in ("wall", "shell"):
                if f"{part} {place}" in parts:
                    bodies.append(
                        {
                            "name": f"{part}_{place}",
                            "capacitance": f"C_{part}_{place}",
                            "initial_temperature": f"T_{part}_{place}",
                        }
                    )
                    links.append(
                        {"resistance": f"R_{part}_{place}", "between": [f"{block}-{part}_{place}"]}
                    )
                    if part == "shell":
                        links.append(
                            {
                                "resistance": f"R_shell_room_{place}",
                                "between": [f"shell_{place}-ambient"],
                            }
                        )
            sensor: dict[str, Any] = {"name": channel, "nodes": [block]}
            if f"lag {place}" in parts:
                sensor["lag"] = f"tau_{place}"
            channels.append(sensor)
        if "board 1" in parts:
            bodies.append(
                {"name": "board", "capacitance": "C_board_1", "initial_temperature": "T_board_1"}
            )
            links.append({"resistance": "R_board_room_1", "between": ["board-ambient"]})
            links += [
                {"resistance": f"R_board_{place}", "between": [f"block_{place}-board"]}
                for place in range(1, len(self.channels) + 1)
            ]
        heaters = []
        for number, (name, place) in enumerate(zip(self.inputs, self.heated, strict=True), 1):
            block = f"block_{place + 1}"
            heater: dict[str, Any] = {
                "name": name,
                "power": f"P_{number}" if number > 1 else f"{NOMINAL_POWER:g} W",
            }
            if f"heater {number}" in parts:
                heater |= {
                    "capacitance": f"C_heater_{number}",
                    "contacts": {block: f"R_heater_{number}"},
                    "initial_temperature": f"T_start_{place + 1}",
                }
            else:
                heater["contacts"] = [block]
            if f"power law {number}" in parts:
                heater["drive"] = f"p_{number}"
            heaters.append(heater)
        for a in range(1, len(self.channels) + 1):
            links += [
                {"resistance": f"R_{a}_{b}", "between": [f"block_{a}-block_{b}"]}
                for b in range(a + 1, len(self.channels) + 1)
                if f"link {a} {b}" in parts
            ]
        return {
            "format": 1,
            "name": "identified",
            "ambient": {"temperature": "T_room"},
            "sensors": {"noise": "0.1 K"},
            "driver": {"counts": 1000},
            "channels": channels,
            "heaters": heaters,
            "bodies": bodies,
            "links": links,
            "initial": {"temperature": "T_start_1"},
            "parameters": {
                row.name: _row(row, (values or {}).get(row.name))
                for row in self.unknowns()
                if not row.part or row.part in parts
            },
        }


def _room_prior(start: Sequence[float], is_driven: bool) -> tuple[float, float]:
    """What is expected of a room that was not recorded, degC, and how surely, K."""
    coldest = min(start)
    if not 12 < coldest < 30 or max(start) - coldest > 2:
        return 21.0, 4.0  # a log that begins hot: a room as people like it
    # A rig that is alike everywhere and not heated is at rest.
    return ((coldest + 21) / 2, 3.0) if is_driven else (coldest, 1.5)


def _place_unknowns(place: int, scale: Scale, room: float, start: float) -> list[Unknown]:
    r, c, tau = scale.resistance, scale.capacitance, scale.time_constant
    mean = 273.15 + room + 0.5 * r * NOMINAL_POWER
    area = 0.7 / r / (4 * STEFAN_BOLTZMANN * mean**3)
    convection = 0.7 / r * (FILM_REFERENCE / max(0.5 * r * NOMINAL_POWER, 1.0)) ** 0.25
    at = f"of place {place}"
    return [
        Unknown(f"C_{place}", "J/K", f"heat capacity {at}", c, 1.0),
        Unknown(
            f"R_{place}",
            "K/W",
            f"from place {place} to the room",
            r,
            0.7,
            f"linear {place}",
            1e4 * r,
        ),
        Unknown(
            f"T_start_{place}", "degC", f"start {at}", start, 1.0, is_positive=False, is_own=True
        ),
        Unknown(
            f"tau_{place}",
            "s",
            f"lag of the sensor {at}",
            max(0.03 * tau, scale.sample_time / 2),
            1.0,
            f"lag {place}",
            scale.sample_time / 50,
        ),
        Unknown(
            f"G_{place}",
            "W/K",
            f"natural convection at 20 K {at}",
            convection,
            0.7,
            f"convection {place}",
            1e-6 * convection,
        ),
        Unknown(
            f"A_{place}",
            "m^2",
            f"radiating area times emissivity {at}",
            area,
            0.7,
            f"radiation {place}",
            1e-6 * area,
        ),
        *(
            row
            for part in ("wall", "shell")
            for row in (
                Unknown(
                    f"C_{part}_{place}",
                    "J/K",
                    f"heat capacity of the {part} {at}",
                    2 * c,
                    1.3,
                    f"{part} {place}",
                    c,
                ),
                Unknown(
                    f"R_{part}_{place}",
                    "K/W",
                    f"from place {place} to its {part}",
                    0.5 * r,
                    1.3,
                    f"{part} {place}",
                    1e4 * r,
                ),
                Unknown(
                    f"T_{part}_{place}",
                    "degC",
                    f"start of the {part} {at}",
                    start,
                    1.0 if abs(start - room) < 3 else 10.0,
                    f"{part} {place}",
                    start,
                    is_positive=False,
                    is_own=True,
                ),
            )
        ),
        Unknown(
            f"R_shell_room_{place}",
            "K/W",
            f"from the shell of place {place} to the room",
            r,
            1.3,
            f"shell {place}",
            r,
        ),
    ]


def _row(unknown: Unknown, value: float | None) -> dict[str, Any]:
    start = unknown.prior if value is None else value
    if unknown.is_positive:
        factor = math.exp(min(6 * unknown.spread, 9.0))
        bounds = [min(unknown.prior / factor, start / 2), max(unknown.prior * factor, start * 2)]
    else:
        reach = max(8 * unknown.spread, 30.0)
        bounds = [max(-273.0, min(unknown.prior, start) - reach), max(unknown.prior, start) + reach]
    return {
        "value": float(start),
        "unit": unknown.unit,
        "bounds": [float(bound) for bound in bounds],
        "prior": {"value": float(unknown.prior), "spread": WEAKENED * float(unknown.spread)},
        "free": True,
        "scope": "recording" if unknown.is_own else "shared",
        "description": unknown.description,
    }
