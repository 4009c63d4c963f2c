"""Small rigs made for one test."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from jaxtwin.rig import Rig, load_rig

MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig(tmp_path: Path) -> MakeRig:
    """Writes and reads a rig that is given by geometry; every value a constant."""

    def make(
        columns: Sequence[str],
        rows: Sequence[str],
        contacts: Sequence[Mapping[str, str]],
        *,
        thickness: str = "2 mm",
        conductivity: str = "200 W/(m K)",
        density: str = "2700 kg/m^3",
        specific_heat: str = "900 J/(kg K)",
        film_coefficient: str = "10 W/(m^2 K)",
        averaging: str = "on-off",
        off_phase: str = "brake",
        channels: str = '[[channels]]\nname = "T"\nnodes = ["V11"]',
    ) -> Rig:
        cells = "".join(
            f"""
            [[cells]]
            name = "P{number}"
            module = "TEC1-12706"
            side_capacitance = "17 J/K"
            contacts = {{ {", ".join(f'{on} = "{value}"' for on, value in touched.items())} }}
            sink_resistance = "0.6 K/W"
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
            [driver]
            supply_voltage = "12 V"
            supply_resistance = "0.2 ohm"
            on_resistance = "0.1 ohm"
            counts = 255
            polarity = 1
            averaging = "{averaging}"
            off_phase = "{off_phase}"
            [camera]
            resolution = [80, 60]
            noise = "0.1 K"
            view = {{ x = [0, 80], y = [0, 60] }}
            {channels}
            [ambient]
            temperature = "20 degC"
            [initial]
            temperature = "20 degC"
            """
        path = tmp_path / "rig.toml"
        path.write_text(text)
        return load_rig(path)

    return make
