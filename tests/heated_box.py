"""A rig without a plate, so small that its equations are written down by hand: a heater and a bulb
in a box of air with a wall."""

import tomllib

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from jaxtwin.data import data_folder
from jaxtwin.rig import Rig, rig_from_tables

NODES = ("air", "wall", "heater")
CAPACITANCE = np.array([60.0, 400.0, 25.0])  # J/K
AMBIENT = 20.0
POWER = {"heater": 30.0, "bulb": 12.0}  # W

TEXT = """
format = 1
name = "heated box"
ambient = { temperature = "20 degC" }
sensors = { noise = "0.05 K" }
channels = [{ name = "T_air", nodes = ["air"] }, { name = "T_wall", nodes = ["wall"] }]
limits = { temperature = "90 degC" }

[[heaters]]
name = "heater"
power = "P"
capacitance = "25 J/K"
contacts = { air = "0.8 K/W", ambient = "20 K/W" }

[[heaters]]
name = "bulb"
power = "12 W"
contacts = ["air"]

[[bodies]]
name = "air"
capacitance = "60 J/K"

[[bodies]]
name = "wall"
capacitance = "400 J/K"

[[links]]
resistance = "R_film"
between = ["air-wall"]

[[links]]
resistance = "1.5 K/W"
between = ["wall-ambient"]

[parameters]
P = { value = 30.0, unit = "W", bounds = [1.0, 100.0], prior = { spread = 0.3 }, free = true }
R_film = { value = 0.5, unit = "K/W", bounds = [0.02, 10.0], prior = { spread = 1.0 }, free = true }
"""


def cell_and_heater(averaging: str) -> Rig:
    """A cell, a heater with a power and one with a resistance, on a plate."""
    text = (data_folder() / "rigs" / "single-cell.toml").read_text()
    document = tomllib.loads(text)
    document["driver"] |= {"averaging": averaging, "current_limit": "3 A"}
    document["heaters"] = [
        {"name": "foil", "power": "5 W", "contacts": ["V11"]},
        {
            "name": "wire",
            "electrical_resistance": "8 ohm",
            "capacitance": "6 J/K",
            "contacts": {"V11": "1.5 K/W", "ambient": "30 K/W"},
        },
    ]
    return rig_from_tables(document, "cell and heater")


def heated_box(*changes: tuple[str, str]) -> Rig:
    """The rig, with some texts of its file replaced by others."""
    return rig_from_tables(tomllib.loads(heated_box_text(*changes)), "box.toml")


def heated_box_text(*changes: tuple[str, str]) -> str:
    """The text of its file, with some texts replaced by others."""
    text = TEXT
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def conductance() -> Float[np.ndarray, "nodes nodes"]:
    """G of the nodes, W/K."""
    film, loss, touch, leak = 1 / 0.5, 1 / 1.5, 1 / 0.8, 1 / 20
    return np.array(
        [
            [film + touch, -film, -touch],
            [-film, film + loss, 0.0],
            [-touch, 0.0, touch + leak],
        ]
    )


def by_hand(duty: tuple[float, float], time: float) -> Float[np.ndarray, " nodes"]:
    """Temperatures after so many seconds of a constant duty, degC: a matrix exponential."""
    heat = np.array([duty[1] * POWER["bulb"], 0.0, duty[0] * POWER["heater"]])
    matrix = -conductance() / CAPACITANCE[:, None]
    end = np.linalg.solve(conductance(), heat)
    return AMBIENT + end - expm(matrix * time) @ end
