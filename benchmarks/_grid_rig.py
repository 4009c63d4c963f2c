"""Rigs of any size: a square plate in equal elements, and cells spread over it."""

import tempfile
from pathlib import Path

import jaxtwin as jt


def grid_rig(side: int, cells: int, nonlinear_loss: bool = True) -> jt.Rig:
    """A copper plate of 24 cm x 24 cm x 1 mm.

    **Arguments:**

    - `side`: elements along each edge.
    - `cells`: each on up to four elements, at places that have no mirror images.
    - `nonlinear_loss`: whether the film grows with the rise and the plate radiates.
    """
    joint = "_" if side > 9 else ""
    size = f"{24 / side!r} cm"
    loss = 'film_exponent = "0.25"\nemissivity = "0.2"' if nonlinear_loss else ""
    text = f"""
        format = 1
        name = "grid-{side}x{side}-{cells}"
        [plate]
        columns = {[size] * side}
        rows = {[size] * side}
        thickness = "1 mm"
        density = "8960 kg/m^3"
        specific_heat = "c_copper"
        conductivity = "400 W/(m K)"
        film_coefficient = "12 W/(m^2 K)"
        {loss}
        [driver]
        supply_voltage = "12 V"
        supply_resistance = "0.2 ohm"
        on_resistance = "0.1 ohm"
        counts = 255
        polarity = 1
        averaging = "on-off"
        off_phase = "brake"
        [camera]
        resolution = [80, 60]
        noise = "0.1 K"
        view = {{ x = [0, 80], y = [0, 60] }}
        [ambient]
        temperature = "20 degC"
        [initial]
        temperature = "20 degC"
        [parameters.c_copper]
        value = 385.0
        unit = "J/(kg K)"
        bounds = [300.0, 500.0]
        free = true
        """
    per_row = max(1, round(cells**0.5))
    for number in range(cells):
        # Centres on a grid with a shift that differs from cell to cell.
        row, column = divmod(number, per_row)
        at = [
            min(side - 1, int(side * (place + 0.3 + 0.4 * ((7 * number) % 5) / 5) / count))
            for place, count in ((row, -(-cells // per_row)), (column, per_row))
        ]
        touched = {
            f"V{1 + min(side - 1, at[0] + down)}{joint}{1 + min(side - 1, at[1] + right)}"
            for down in (0, 1)
            for right in (0, 1)
        }
        contacts = ", ".join(f'{name} = "{0.5 * len(touched)} K/W"' for name in sorted(touched))
        text += f"""
        [[cells]]
        name = "P{number + 1}"
        module = "TEC1-12706"
        side_capacitance = "17 J/K"
        contacts = {{ {contacts} }}
        sink_resistance = "0.6 K/W"
        sink_capacitance = "150 J/K"
        sink_air_resistance = "0.4 K/W"
        """
    for row in range(3):
        for column in range(4):
            text += f"""
        [[channels]]
        name = "Z{row + 1}{column + 1}"
        x = ["{6 * column} cm", "{6 * column + 6} cm"]
        y = ["{8 * row} cm", "{8 * row + 8} cm"]
        """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "grid.toml"
        path.write_text(text)
        return jt.load_rig(path)
