"""Units as pictures show them."""

# What a unit of a rig file or a dataset has, and what is shown for it.
SIGNS = {"degC": "°C", "ohm": "Ω", "^2": "²", "K2": "K²"}


def unit_text(unit: str) -> str:
    """A unit with the usual signs: `Ω`, `°C`, `K²`, `W/(m² K)`."""
    for written, sign in SIGNS.items():
        unit = unit.replace(written, sign)
    return unit
