"""A heated pot with a wall behind it, as the tables of its rig file."""

from typing import Any


def pot_tables(
    capacitance: str = "900 J/K",
    loss: str = "0.25 K/W",
    wall_capacitance: str = "1500 J/K",
    wall_resistance: str = "0.1 K/W",
) -> dict[str, Any]:
    """The tables; each value is a quantity or the name of a parameter."""
    return {
        "format": 1,
        "name": "pot",
        "ambient": {"temperature": "21 degC"},
        "sensors": {"noise": "0.1 K"},
        "channels": [{"name": "water", "nodes": ["pot"]}],
        "heaters": [{"name": "H", "power": "300 W", "contacts": ["pot"]}],
        "bodies": [
            {"name": "pot", "capacitance": capacitance},
            {"name": "wall", "capacitance": wall_capacitance},
        ],
        "links": [
            {"resistance": loss, "between": ["pot-ambient"]},
            {"resistance": wall_resistance, "between": ["pot-wall"]},
        ],
    }
