"""The family of networks that identification chooses from, as tables of a rig file.

Each channel is a place: a block whose temperature its sensor reads. A network is the blocks, the
heaters, and a choice of `Part`s: losses, walls and shells, lags, heat capacities of heaters, laws
of their drive, links between places. A part has its parameters and its tables beside each other.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any, final

import numpy as np

from ..physics import STEFAN_BOLTZMANN
from ..rig import FILM_REFERENCE
from ._baselines import FirstOrder
from ._log import ScreenedLog

# A log says nothing of the power: the first heater has this one, and all capacities and resistances
# are relative to it, W.
NOMINAL_POWER = 10.0

# `match` finds that the errors of a structure are correlated, and counts some five independent
# readings where the screening counts `EFFECTIVE_SAMPLES`: with priors so much wider both weigh
# readings and priors alike.
WEAKENED = 3.0

# Nor does it say anything of the electrical side of a thermoelectric cell. These are the voltage
# and the resistance of one whose Joule heat, at full duty on one side, is 4 W; typical modules pump
# two to three times as much by the Peltier effect.
CELL_VOLTAGE, CELL_RESISTANCE, CELL_SEEBECK = 6.0, 4.5, 0.025

# K/W between the sides: such a cell can hold some 60 K.
CELL_THERMAL_RESISTANCE = 8.0

# Standard deviations of the logarithms of what is expected: a loss follows from the gain of the
# first-order system, a heat capacity from its time constant; of a wall or a link little is known.
LOSS_SPREAD, CAPACITANCE_SPREAD, HIDDEN_SPREAD, LINK_SPREAD = 0.7, 1.0, 1.3, 1.5

# Of the drift of a room that was not recorded, K/h, if the log is short, and over all of it, K.
DRIFT_SPREAD, LONG_DRIFT_SPREAD = 1.0, 2.0

# A delay is tried if that of a first-order system is longer, samples.
MIN_DELAY = 2.0

# The parameters of the room, and parts that are tried beside the best networks only.
ROOM, DRIFT = "T_room", "drift_room"
DRIFT_OF_ROOM, DELAY = "drift 1", "delay 1"

# Of the temperature at the start: of a place, which its sensor reads, and of what is hidden in a
# rig that begins hot, K.
START_SPREAD, HOT_START_SPREAD = 1.0, 10.0

Table = dict[str, Any]


@final
@dataclass(frozen=True)
class Unknown:
    """A parameter of the family.

    **Arguments:**

    - `name`, `unit`, `description`: as in the rig file.
    - `prior`: what is expected of it, in its unit.
    - `spread`: the standard deviation of that, of its logarithm if it is positive.
    - `absent`: the value with which a network that contains its part behaves as one without.
    - `is_positive`: whether it is searched by its logarithm; if not, it is a temperature or its
      rate, of which each recording has its own.
    """

    name: str
    unit: str
    description: str
    prior: float
    spread: float
    absent: float
    is_positive: bool = True

    @property
    def is_own(self) -> bool:
        """Whether each recording has a value of its own."""
        return not self.is_positive

    @property
    def is_start(self) -> bool:
        """Whether it is the temperature of a body at the start."""
        return self.is_own and self.name not in (ROOM, DRIFT)


@final
@dataclass(frozen=True)
class Part:
    """Something that a network may have.

    **Arguments:**

    - `name`: such as `"wall 2"`, with the number of its place or heater; empty for what every
      network has.
    - `unknowns`: its parameters.
    - `bodies`, `links`: its tables in the rig file.
    - `channel`, `actuator`: its keys in the table of the channel or the cell or heater of its
      number. `ambient`, `driver`: in those tables.
    """

    name: str
    unknowns: tuple[Unknown, ...]
    bodies: tuple[Table, ...] = ()
    links: tuple[Table, ...] = ()
    channel: Table = field(default_factory=dict)
    actuator: Table = field(default_factory=dict)
    ambient: Table = field(default_factory=dict)
    driver: Table = field(default_factory=dict)

    @property
    def number(self) -> int:
        """The number of its place or heater, counted from 1."""
        return int(self.name.rsplit(" ", 1)[1])


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
        variation = np.asarray(log.experiment.duty).std(axis=0)
        strongest = int(np.argmax(np.abs(first.gains) * variation))
        # Of a slower system the log shows only the beginning.
        tau = min(first.time_constant, 3 * log.experiment.duration)
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
    - `heated`: for each input, the number of the channel that it heats, counted from 0.
    - `cells`: the inputs with negative values, which are thermoelectric cells, counted from 0.
    - `polarity`: 1 if positive duties heat, -1 if they cool.
    - `has_levels`: whether the only input has values between 0 and 1, so that its heat need not be
      proportional to it.
    - `parts`: what a network may have, with what every network has at first.
    """

    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    heated: tuple[int, ...]
    cells: tuple[int, ...]
    polarity: int
    has_levels: bool
    parts: tuple[Part, ...]

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
        scales = [
            Scale.of(first, log, float(np.nanstd(column)))
            for first, column in zip(firsts, readings.T, strict=True)
        ]
        # A channel that is still on its way up tells little of its own size: places are alike.
        settled = [n for n, first in enumerate(firsts) if first.time_constant < experiment.duration]
        if settled:
            scales = [scales[n if n in settled else settled[0]] for n in range(len(scales))]
        duty = np.asarray(experiment.duty)
        cells = tuple(int(column) for column in np.flatnonzero((duty < 0).any(axis=0)))
        # An input heats the place that it warms fastest.
        rates = np.array([first.gains / first.time_constant for first in firsts])
        of_cells = rates[:, cells].ravel()
        polarity = 1
        if cells and of_cells[np.abs(of_cells).argmax()] < 0:
            polarity = -1
        heated = tuple(int(place) for place in (polarity * rates).argmax(axis=0))
        starts = [log.first_reading(channel) for channel in range(len(scales))]
        is_driven = bool(duty[0].any())
        expected = _room_prior(starts, is_driven) if room is None else (room, 0.5)
        room_itself = Unknown(ROOM, "degC", "room", *expected, expected[0], is_positive=False)
        parts = [Part("", (room_itself,))]
        if experiment.ambient is None:
            spread = min(DRIFT_SPREAD, LONG_DRIFT_SPREAD / (experiment.duration / 3600))
            drift = Unknown(DRIFT, "K/h", "drift of the room", 0.0, spread, 0.0, is_positive=False)
            parts.append(Part(DRIFT_OF_ROOM, (drift,), ambient={"drift": DRIFT}))
        delay = float(np.median([first.delay for first in firsts]))
        is_constant = experiment.ambient is None or np.ptp(experiment.ambient) == 0
        # C runs no draws that differ in a delay through a room that changes.
        if is_constant and delay > MIN_DELAY * log.sample_time:
            parts.append(_delay(delay, log.sample_time))
        for place, (scale, start) in enumerate(zip(scales, starts, strict=True), 1):
            parts += _parts_of_place(place, scale, expected[0], start)
        for number, place in enumerate(heated, 1):
            if number - 1 in cells:
                parts += _parts_of_cell(number, scales[place])
            else:
                parts += _parts_of_heater(number, place + 1, scales[place])
        if has_levels:
            exponent = Unknown("p_1", "", "exponent of the drive", 1.3, 0.3, 1.0)
            parts.append(Part("power law 1", (exponent,), actuator={"drive": "p_1"}))
        for (a, first), (b, second) in combinations(enumerate(scales, 1), 2):
            parts.append(_link(a, b, math.sqrt(first.resistance * second.resistance)))
        if len(scales) > 1:
            parts.append(_board(scales, expected[0], starts[0]))
        return cls(
            experiment.channels,
            experiment.cell_names,
            heated,
            cells,
            polarity,
            has_levels,
            tuple(parts),
        )

    @cached_property
    def choices(self) -> tuple[str, ...]:
        """The names of the parts that a network may have."""
        return tuple(part.name for part in self.parts if part.name)

    def unknowns(self, chosen: Set[str]) -> list[Unknown]:
        """The parameters of the network with the chosen parts."""
        return [row for part in self._chosen(chosen) for row in part.unknowns]

    def tables(self, chosen: Set[str], values: Mapping[str, float] | None = None) -> Table:
        """The tables of the rig file of the network with the chosen parts.

        **Arguments:**

        - `values`: parameter -> its value, by default what is expected.
        """
        parts = self._chosen(chosen)
        ambient = {key: value for part in parts for key, value in part.ambient.items()}
        channels: list[Table] = [
            {"name": name, "nodes": [f"block_{place}"]}
            for place, name in enumerate(self.channels, 1)
        ]
        actuators = [
            _cell(name, number, place)
            if number in self.cells
            else {
                "name": name,
                "power": f"P_{number + 1}" if number else f"{NOMINAL_POWER:g} W",
                "contacts": [f"block_{place + 1}"],
            }
            for number, (name, place) in enumerate(zip(self.inputs, self.heated, strict=True))
        ]
        for part in parts:
            if part.channel:
                channels[part.number - 1] |= part.channel
            if part.actuator:
                actuator = actuators[part.number - 1]
                contacts = part.actuator.get("contacts", actuator["contacts"])
                if isinstance(actuator["contacts"], dict):
                    contacts = {**actuator["contacts"], **contacts}
                actuator |= {**part.actuator, "contacts": contacts}
        rows = [row for part in parts for row in part.unknowns]
        return {
            "format": 1,
            "name": "identified",
            "ambient": {"temperature": ROOM, **ambient},
            "sensors": {"noise": "0.1 K"},
            "channels": channels,
            **self._driver(parts),
            "cells": [actuators[number] for number in self.cells],
            "heaters": [row for number, row in enumerate(actuators) if number not in self.cells],
            "bodies": [body for part in parts for body in part.bodies],
            "links": [link for part in parts for link in part.links],
            "initial": {"temperature": "T_start_1"},
            "parameters": {row.name: _parameter(row, (values or {}).get(row.name)) for row in rows},
        }

    def _driver(self, parts: Sequence[Part]) -> Table:
        """The table of the driver, which only cells and delays need."""
        driver: Table = {}
        if self.cells:
            driver |= {"supply_voltage": f"{CELL_VOLTAGE:g} V", "on_resistance": "0.1 ohm"}
            driver |= {"counts": 255, "polarity": self.polarity, "averaging": "on-off"}
        for part in parts:
            driver |= part.driver
        return {"driver": driver} if driver else {}

    def _chosen(self, names: Set[str]) -> list[Part]:
        return [part for part in self.parts if not part.name or part.name in names]


def _room_prior(start: Sequence[float], is_driven: bool) -> tuple[float, float]:
    """What is expected of a room that was not recorded, degC, and how surely, K."""
    coldest = min(start)
    if not 12 < coldest < 30 or max(start) - coldest > 2:
        return 21.0, 4.0  # a log that begins hot: a room as people like it
    # A rig that is alike everywhere and not heated is at rest.
    return ((coldest + 21) / 2, 3.0) if is_driven else (coldest, 1.5)


def _body(name: str, capacitance: str, start: str) -> Table:
    return {"name": name, "capacitance": capacitance, "initial_temperature": start}


def _to_room(node: str, **conductance: str) -> Table:
    return {**conductance, "between": [f"{node}-ambient"]}


def _start(name: str, description: str, start: float, spread: float) -> Unknown:
    return Unknown(name, "degC", f"start {description}", start, spread, start, is_positive=False)


def _hidden_start(name: str, description: str, start: float, room: float) -> Unknown:
    """The start of what no sensor reads: in a cold rig, that of what is read."""
    spread = START_SPREAD if abs(start - room) < 3 else HOT_START_SPREAD
    return _start(name, description, start, spread)


def _parts_of_place(place: int, scale: Scale, room: float, start: float) -> list[Part]:
    r, c, at, block = scale.resistance, scale.capacitance, f"of place {place}", f"block_{place}"
    rise = 0.5 * r * NOMINAL_POWER
    # Losses at half of the power as large as 70 % of the linear one.
    area = 0.7 / r / (4 * STEFAN_BOLTZMANN * (273.15 + room + rise) ** 3)
    film = 0.7 / r * (FILM_REFERENCE / max(rise, 1.0)) ** 0.25
    lag = max(0.03 * scale.time_constant, scale.sample_time / 2)
    parts = [
        Part(
            "",
            (
                Unknown(f"C_{place}", "J/K", f"heat capacity {at}", c, CAPACITANCE_SPREAD, c),
                _start(f"T_start_{place}", at, start, START_SPREAD),
            ),
            bodies=(_body(block, f"C_{place}", f"T_start_{place}"),),
        ),
        Part(
            f"linear {place}",
            (Unknown(f"R_{place}", "K/W", f"loss {at}", r, LOSS_SPREAD, 1e4 * r),),
            links=(_to_room(block, resistance=f"R_{place}"),),
        ),
        Part(
            f"convection {place}",
            (
                Unknown(
                    f"G_{place}",
                    "W/K",
                    f"natural convection {at}, at a difference of 20 K",
                    film,
                    LOSS_SPREAD,
                    1e-6 * film,
                ),
            ),
            links=(_to_room(block, convection=f"G_{place}"),),
        ),
        Part(
            f"radiation {place}",
            (
                Unknown(
                    f"A_{place}",
                    "m^2",
                    f"radiating area times emissivity {at}",
                    area,
                    LOSS_SPREAD,
                    1e-6 * area,
                ),
            ),
            links=(_to_room(block, radiating_area=f"A_{place}"),),
        ),
        Part(
            f"lag {place}",
            (
                Unknown(
                    f"tau_{place}",
                    "s",
                    f"lag of the sensor {at}",
                    lag,
                    CAPACITANCE_SPREAD,
                    scale.sample_time / 50,
                ),
            ),
            channel={"lag": f"tau_{place}"},
        ),
    ]
    for kind in ("wall", "shell"):
        name, node = f"{kind}_{place}", f"the {kind} {at}"
        rows = [
            Unknown(f"C_{name}", "J/K", f"heat capacity of {node}", 2 * c, HIDDEN_SPREAD, c),
            Unknown(f"R_{name}", "K/W", f"block to {node}", 0.5 * r, HIDDEN_SPREAD, 1e4 * r),
            _hidden_start(f"T_{name}", f"of {node}", start, room),
        ]
        links = [{"resistance": f"R_{name}", "between": [f"{block}-{name}"]}]
        if kind == "shell":
            loss = f"R_shell_room_{place}"
            rows.append(Unknown(loss, "K/W", f"loss of {node}", r, HIDDEN_SPREAD, r))
            links.append(_to_room(name, resistance=loss))
        bodies = (_body(name, f"C_{name}", f"T_{name}"),)
        parts.append(Part(f"{kind} {place}", tuple(rows), bodies, tuple(links)))
    return parts


def _parts_of_heater(number: int, place: int, scale: Scale) -> list[Part]:
    r, c = scale.resistance, scale.capacitance
    capacitance, contact = f"C_heater_{number}", f"R_heater_{number}"
    power = Unknown(
        f"P_{number}", "W", f"power of heater {number} at full duty", NOMINAL_POWER, 1.0, math.nan
    )
    # Without a heat capacity of its own a heater is a thousandth of its block.
    rows = (
        Unknown(
            capacitance, "J/K", f"capacity of heater {number}", 0.3 * c, HIDDEN_SPREAD, 1e-3 * c
        ),
        Unknown(contact, "K/W", f"heater {number} to block", 0.3 * r, HIDDEN_SPREAD, 1e-3 * r),
    )
    keys = {
        "capacitance": capacitance,
        "contacts": {f"block_{place}": contact},
        "initial_temperature": f"T_start_{place}",
    }
    always = [Part("", (power,))] if number > 1 else []
    to_shell = f"R_heater_shell_{number}"
    stray = Unknown(to_shell, "K/W", f"heater {number} to shell", r, HIDDEN_SPREAD, 1e4 * r)
    return [
        *always,
        Part(f"heater {number}", rows, actuator=keys),
        Part(f"stray {number}", (stray,), actuator={"contacts": {f"shell_{place}": to_shell}}),
    ]


def _cell(name: str, number: int, place: int) -> Table:
    """The table of a thermoelectric cell between a block and the room."""
    return {
        "name": name,
        "seebeck_coefficient": f"S_{number + 1}",
        "electrical_resistance": f"{CELL_RESISTANCE:g} ohm",
        "thermal_resistance": f"R_cell_{number + 1}",
        "side_capacitance": f"C_side_{number + 1}",
        "contacts": {f"block_{place + 1}": f"R_contact_{number + 1}"},
        "sink_resistance": f"R_sink_{number + 1}",
    }


def _parts_of_cell(number: int, scale: Scale) -> list[Part]:
    r, c, of = scale.resistance, scale.capacitance, f"of cell {number}"
    always = (
        Unknown(f"S_{number}", "V/K", f"Seebeck coefficient {of}", CELL_SEEBECK, 0.5, CELL_SEEBECK),
        Unknown(
            f"R_cell_{number}",
            "K/W",
            f"thermal resistance {of}",
            CELL_THERMAL_RESISTANCE,
            0.7,
            CELL_THERMAL_RESISTANCE,
        ),
        Unknown(f"C_side_{number}", "J/K", f"heat capacity of a side {of}", 0.05 * c, 1.0, c),
        Unknown(f"R_contact_{number}", "K/W", f"contact {of}", 0.05 * r, 1.0, r),
        Unknown(f"R_sink_{number}", "K/W", f"far side {of} to its sink", 0.2 * r, HIDDEN_SPREAD, r),
    )
    capacitance, to_air = f"C_sink_{number}", f"R_air_{number}"
    sink = (
        Unknown(
            capacitance, "J/K", f"heat capacity of the sink {of}", 3 * c, HIDDEN_SPREAD, 1e-2 * c
        ),
        Unknown(to_air, "K/W", f"sink {of} to the room", 0.2 * r, HIDDEN_SPREAD, 1e-3 * r),
    )
    keys = {"sink_capacitance": capacitance, "sink_air_resistance": to_air}
    return [Part("", always), Part(f"sink {number}", sink, actuator=keys)]


def _link(a: int, b: int, resistance: float) -> Part:
    name = f"R_{a}_{b}"
    row = Unknown(
        name, "K/W", f"between places {a} and {b}", 3 * resistance, LINK_SPREAD, 1e5 * resistance
    )
    link = {"resistance": name, "between": [f"block_{a}-block_{b}"]}
    return Part(f"link {a} {b}", (row,), links=(link,))


def _delay(first_order: float, sample_time: float) -> Part:
    """A delay of what the heaters and cells do, expected to be some part of that of a first-order
    system, which stands for hidden bodies too."""
    row = Unknown("t_delay", "s", "delay of the drive", first_order / 2, 0.7, sample_time / 100)
    return Part(DELAY, (row,), driver={"lag": f"{sample_time / 20:.4g} s", "delay": "t_delay"})


def _board(scales: Sequence[Scale], room: float, start: float) -> Part:
    """A body that all places stand on."""
    c = sum(scale.capacitance for scale in scales)
    r = 1 / sum(1 / scale.resistance for scale in scales)
    loss = "R_board_room_1"
    rows = [
        Unknown("C_board_1", "J/K", "heat capacity of the board", c, HIDDEN_SPREAD, c),
        Unknown(loss, "K/W", "loss of the board", r, HIDDEN_SPREAD, r),
        _hidden_start("T_board_1", "of the board", start, room),
    ]
    links = [_to_room("board", resistance=loss)]
    for place, scale in enumerate(scales, 1):
        name, own = f"R_board_{place}", scale.resistance
        rows.append(Unknown(name, "K/W", f"place {place} to board", own, HIDDEN_SPREAD, 1e4 * own))
        links.append({"resistance": name, "between": [f"block_{place}-board"]})
    bodies = (_body("board", "C_board_1", "T_board_1"),)
    return Part("board 1", tuple(rows), bodies, tuple(links))


def _parameter(unknown: Unknown, value: float | None) -> Table:
    """The row of a parameter in the rig file."""
    start = unknown.prior if value is None else value
    if unknown.is_positive:
        factor = math.exp(min(6 * unknown.spread, 9.0))
        bounds = [min(unknown.prior / factor, start / 2), max(unknown.prior * factor, start * 2)]
    elif unknown.name == DRIFT:
        reach = 8 * unknown.spread + abs(start)
        bounds = [-reach, reach]
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
