"""A box with a lid, a fan and cooling water: a rig whose inputs change its network."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from jaxtwin import Experiment, Twin
from jaxtwin.rig import Rig, rig_from_tables

TEXT = """
format = 1
name = "box"
channels = [{ name = "T1", nodes = ["V12"] }, { name = "Tair", nodes = ["air"] }]
sensors = { noise = "0.1 K" }
ambient = { temperature = "20 degC" }

inputs = [
    { name = "lid", states = ["closed", "open"] },
    { name = "fan", value = 1.0 },
    { name = "V_supply", value = 12, unit = "V" },
    { name = "T_water", value = 20, unit = "degC" },
]

[plate]
columns = ["4 cm", "4 cm"]
rows = ["4 cm"]
thickness = "1 mm"

[circuit]
capacitance = "5 J/K"
links = [
    { resistance = "2.5 K/W", between = ["V11-V12"] },
    { resistance = "60 K/W", between = ["V11-ambient", "V12-ambient"] },
]

[[cells]]
name = "P1"
seebeck_coefficient = "0.05 V/K"
electrical_resistance = "2 ohm"
thermal_resistance = "1.8 K/W"
side_capacitance = "17 J/K"
contacts = { V11 = "0.6 K/W" }
sink_resistance = "0.5 K/W"
sink_capacitance = "100 J/K"
sink_air_resistance = "R_air"
fan = { speed = "fan" }

[driver]
supply_voltage = "V_supply"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"

[[bodies]]
name = "air"
capacitance = "40 J/K"

[[bodies]]
name = "water"
temperature = "T_water"

[[links]]
resistance = "2 K/W"
between = ["V12-air"]

[[links]]
resistance = { closed = "R_closed", open = "R_open", by = "lid" }
between = ["air-ambient"]

[[links]]
resistance = "3 K/W"
between = ["air-water"]

[parameters]
R_air = { value = 0.8, unit = "K/W", bounds = [0.1, 5.0], free = true }
R_closed = { value = 4.0, unit = "K/W", bounds = [0.5, 50.0], free = true }
R_open = { value = 0.15, unit = "K/W", bounds = [0.01, 5.0], free = true }
"""

AMBIENT = 293.15
NODES = ("V11", "V12", "P1.TC", "P1.TH", "P1.SINK", "air")


def box_table() -> dict[str, Any]:
    """The tables of the rig file."""
    return tomllib.loads(TEXT)


def box() -> Rig:
    """The rig."""
    return rig_from_tables(box_table(), "box")


def box_file(folder: Path) -> Path:
    """The rig file."""
    file = folder / "box.toml"
    file.write_text(TEXT)
    return file


def by_radau(twin: Twin, experiment: Experiment) -> Float[np.ndarray, "times nodes"]:
    """The temperatures of `NODES`, degC, by the stiff solver of SciPy from equations that are
    written down here; the duty and the inputs of the experiment must be numbers."""
    values = twin.numbers_si
    position = [[node.name for node in twin.netlist.nodes].index(name) for name in NODES]
    columns = [experiment.inputs[name] for name in ("lid", "fan", "V_supply", "T_water")]
    state, found = np.full(6, AMBIENT), [np.full(6, AMBIENT)]
    for sample, (start, stop) in enumerate(
        zip(experiment.time[:-1], experiment.time[1:], strict=True)
    ):
        lid, fan, volts, water = (column[sample] for column in columns)
        duty = experiment.duty[sample, 0]
        to_air = (1 - lid) / values["R_closed"] + lid / values["R_open"]
        to_room = fan**0.5 / values["R_air"]

        def slope(
            _: float,
            x: Float[np.ndarray, " 6"],
            duty: float = duty,
            volts: float = volts,
            water: float = water,
            to_air: float = to_air,
            to_room: float = to_room,
        ) -> Float[np.ndarray, " 6"]:
            v11, v12, cold, hot, sink, air = x
            emf = 0.05 * (hot - cold)
            on, off = (-np.sign(duty) * volts - emf) / 2.1, -emf / 2.1
            share = abs(duty)
            current = share * on + (1 - share) * off
            joule = 2.0 * (share * on**2 + (1 - share) * off**2) / 2
            through = (cold - hot) / 1.8
            heat = [
                (v12 - v11) / 2.5 - (v11 - AMBIENT) / 60 + (cold - v11) / 0.6,
                (v11 - v12) / 2.5 - (v12 - AMBIENT) / 60 + (air - v12) / 2,
                (v11 - cold) / 0.6 - through - 0.05 * current * cold + joule,
                through + 0.05 * current * hot + joule + (sink - hot) / 0.5,
                (hot - sink) / 0.5 - to_room * (sink - AMBIENT),
                (v12 - air) / 2 - to_air * (air - AMBIENT) + (water + 273.15 - air) / 3,
            ]
            return np.array(heat) / [5.0, 5.0, 17.0, 17.0, 100.0, 40.0]

        solved = solve_ivp(slope, (start, stop), state, "Radau", rtol=1e-9, atol=1e-9)
        state = solved.y[:, -1]
        found.append(state)
    whole = np.full((len(experiment.time), len(twin.netlist.nodes)), np.nan)
    whole[:, position] = np.array(found) - 273.15
    return whole
