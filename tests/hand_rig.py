"""A rig so small that its equations are written down by hand: two elements and a heater."""

import tomllib

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from jaxtwin.rig import Rig, rig_from_tables

NODES = ["V11", "V12", "P1.TC", "P1.TH"]
CAPACITANCE = 30.0, 30.0, 10.0, 10.0

# Pairs of nodes -> K/W.
LINKS = {(0, 1): 2.0, (0, 2): 0.5, (2, 3): 1.5}
TO_AIR = {0: 5.0, 1: 5.0}
SINK = 0.8
AMBIENT = 20.0

TEXT = """
format = 1
name = "hand"

[plate]
columns = ["4 cm", "4 cm"]
rows = ["4 cm"]
thickness = "2 mm"

[circuit]
capacitance = "30 J/K"
links = [
    {{ resistance = "5 K/W", between = ["V11-ambient", "V12-ambient"] }},
    {{ resistance = "2 K/W", between = ["V11-V12"] }},
]

[[cells]]
name = "P1"
seebeck_coefficient = "{seebeck}"
electrical_resistance = "2 ohm"
thermal_resistance = "1.5 K/W"
side_capacitance = "10 J/K"
contacts = {{ V11 = "0.5 K/W" }}
sink_resistance = "0.8 K/W"
{cell}

[driver]
supply_voltage = "12 V"
supply_resistance = "0.2 ohm"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "{averaging}"
{driver}

{sensors}

[[channels]]
name = "T1"
nodes = {read}
{channel}

[ambient]
temperature = "20 degC"

[initial]
temperature = "20 degC"

{more}
"""


def hand_rig(**parts: str) -> Rig:
    """The rig of the file `hand.toml`, with keys and tables added: see `hand_text`."""
    return rig_from_tables(tomllib.loads(hand_text(**parts)), "hand.toml")


def hand_text(
    *,
    seebeck: str = "0 V/K",
    averaging: str = "on-off",
    read: str = '["V12"]',
    cell: str = "",
    driver: str = "",
    channel: str = "",
    sensors: str = '[sensors]\nnoise = "0.1 K"',
    more: str = "",
) -> str:
    """The text of the file, with keys added to some of its tables, and more tables."""
    return TEXT.format(
        seebeck=seebeck,
        averaging=averaging,
        read=read,
        cell=cell,
        driver=driver,
        channel=channel,
        sensors=sensors,
        more=more,
    )


BODIES = """
[[bodies]]
name = "block"
capacitance = "80 J/K"
initial_temperature = "18 degC"

[[bodies]]
name = "water"
temperature = "12 degC"

[[bodies]]
name = "pipe"
capacitance = "5 J/K"

[[links]]
resistance = "0.3 K/W"
between = ["block-water", "block-pipe"]

[[links]]
resistance = "0.4 K/W"
factor = 2.0
between = ["V12-pipe"]
"""


FAN = """
[[links]]
resistance = "6 K/W"
between = ["block-ambient"]
fan = { speed = "1.4" }
"""


def text_of_many_parts(averaging: str) -> str:
    """The file of a thermoelectric cell with a current limit on a block that water and a fan cool,
    a heat pipe from there to the plate, and a sensor with a lag."""
    return hand_text(
        seebeck="0.05 V/K",
        averaging=averaging,
        read='["V11", "pipe"]',
        cell='sink = "block"',
        driver='current_limit = "3 A"',
        channel='lag = "4 s"',
        more=BODIES + FAN,
    )


def rig_of_many_parts(averaging: str) -> Rig:
    """The rig of that file."""
    return rig_from_tables(tomllib.loads(text_of_many_parts(averaging)), "hand.toml")


def heater_power(duty: float) -> float:
    """What 12 V turn into heat in the cell's 2 of 2.3 ohm for the fraction `duty`, W."""
    return duty * 2.0 * (12.0 / 2.3) ** 2


def linear_network(
    capacitance: Float[np.ndarray, " nodes"],
    links: dict[tuple[int, int], float],
    to_air: dict[int, float],
) -> tuple[Float[np.ndarray, "nodes nodes"], Float[np.ndarray, "nodes nodes"]]:
    """Its heat capacities and conductances as matrices, link by link."""
    G = np.zeros((len(capacitance), len(capacitance)))
    for (a, b), resistance in links.items():
        G[a, a] += 1 / resistance
        G[b, b] += 1 / resistance
        G[a, b] -= 1 / resistance
        G[b, a] -= 1 / resistance
    for node, resistance in to_air.items():
        G[node, node] += 1 / resistance
    return np.diag(capacitance), G


def after(
    matrix: Float[np.ndarray, "nodes nodes"], drive: Float[np.ndarray, " nodes"], time: float
) -> Float[np.ndarray, " nodes"]:
    """The solution of dx/dt = matrix x + drive from 0 after a time, by the matrix exponential."""
    size = len(drive)
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size], augmented[:size, size] = matrix, drive
    return expm(augmented * time)[:size, size]
