"""Small rigs made for one test."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from jaxtwin import Twin
from jaxtwin.data import data_folder
from jaxtwin.rig import Rig, load_rig, rig_from_tables

MakeRig = Callable[..., Rig]

CAMERA = """
[camera]
resolution = [80, 60]
noise = "0.1 K"
view = { x = [0, 80], y = [0, 60] }
"""


def bundled(
    name: str, driver: Mapping[str, str], parameters: Mapping[str, Mapping[str, Any]] | None = None
) -> Twin:
    """A bundled rig whose driver has other values, with further parameters."""
    text = (data_folder() / "rigs" / f"{name}.toml").read_text()
    document: dict[str, Any] = tomllib.loads(text)
    document["driver"] |= driver
    document["parameters"] |= parameters or {}
    return Twin(rig_from_tables(document, name))


def small_rig_file(
    folder: Path,
    columns: Sequence[str],
    rows: Sequence[str],
    contacts: Sequence[Mapping[str, str]],
    *,
    thickness: str = "2 mm",
    conductivity: str = "200 W/(m K)",
    density: str = "2700 kg/m^3",
    specific_heat: str = "900 J/(kg K)",
    film_coefficient: str = "10 W/(m^2 K)",
    more_of_plate: str = "",
    sink_resistance: str = "0.6 K/W",
    supply_resistance: str = "0.2 ohm",
    averaging: str = "on-off",
    off_phase: str = "brake",
    sensors: str = CAMERA,
    channels: str = '[[channels]]\nname = "T"\nnodes = ["V11"]',
    ambient: str = "20 degC",
    parameters: str = "",
) -> Path:
    """Writes a rig by geometry, whose values are constants unless they name one of the parameters.

    **Arguments:**

    - `contacts`: for each cell the elements of the plate that it touches, and their resistances.
    - `sensors`: the table of the camera or of other sensors. `channels`: their tables.
    - `parameters`: their tables.
    """
    cells = "".join(
        f"""
        [[cells]]
        name = "P{number}"
        module = "TEC1-12706"
        side_capacitance = "17 J/K"
        contacts = {{ {", ".join(f'{on} = "{value}"' for on, value in touched.items())} }}
        sink_resistance = "{sink_resistance}"
        """
        for number, touched in enumerate(contacts, start=1)
    )
    text = f"""
        format = 1
        name = "made for a test"
        {cells}
        [plate]
        columns = {list(columns)}
        rows = {list(rows)}
        thickness = "{thickness}"
        density = "{density}"
        specific_heat = "{specific_heat}"
        conductivity = "{conductivity}"
        film_coefficient = "{film_coefficient}"
        {more_of_plate}
        [driver]
        supply_voltage = "12 V"
        supply_resistance = "{supply_resistance}"
        on_resistance = "0.1 ohm"
        counts = 255
        polarity = 1
        averaging = "{averaging}"
        off_phase = "{off_phase}"
        {sensors}
        {channels}
        [ambient]
        temperature = "{ambient}"
        [initial]
        temperature = "{ambient}"
        {parameters}
        """
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def zone(name: str, x: tuple[float, float], y: tuple[float, float], more: str = "") -> str:
    """The table of a channel that is the mean of a rectangle of the picture, cm."""
    return f"""
        [[channels]]
        name = "{name}"
        x = ["{x[0]} cm", "{x[1]} cm"]
        y = ["{y[0]} cm", "{y[1]} cm"]
        {more}
        """


@pytest.fixture
def make_rig(tmp_path: Path) -> MakeRig:
    """Writes and reads a rig: see `small_rig_file`."""

    def make(
        columns: Sequence[str],
        rows: Sequence[str],
        contacts: Sequence[Mapping[str, str]],
        **values: str,
    ) -> Rig:
        return load_rig(small_rig_file(tmp_path, columns, rows, contacts, **values))

    return make
