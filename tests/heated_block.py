"""A rig of one heater and one body, without a driver, and so without counts."""

import tomllib
from pathlib import Path

from jaxtwin.rig import Rig, rig_from_tables

HEATED_BLOCK = """
format = 1
name = "block"
title = "One heater, one body"
ambient = { temperature = "T_amb" }
sensors = { noise = "0.2 K" }
channels = [{ name = "T", nodes = ["block"] }]
heaters = [{ name = "H", power = "30 W", capacitance = "10 J/K", contacts = { block = "1 K/W" } }]
bodies = [{ name = "block", capacitance = "30 J/K" }]
links = [{ resistance = "R_loss", between = ["block-ambient"] }]
[parameters]
R_loss = { value = 5.0, unit = "K/W", bounds = [0.01, 1000.0], free = true }
T_amb = { value = 22.0, unit = "degC", bounds = [-10.0, 60.0] }
"""


def heated_block() -> Rig:
    """The rig."""
    return rig_from_tables(tomllib.loads(HEATED_BLOCK), "block")


def heated_block_file(folder: Path) -> Path:
    """The rig as a file."""
    path = folder / "block.toml"
    path.write_text(HEATED_BLOCK, encoding="utf-8")
    return path
