"""The structures that are tried, and what they are called."""

from collections.abc import Set
from itertools import product

from ._network import Family

LOSSES = (
    ("linear",),
    ("convection",),
    ("radiation",),
    ("linear", "radiation"),
    ("convection", "radiation"),
)
BACKS = ((), ("wall",), ("shell",), ("wall", "shell"))
BOARDS = (("board",), ("board", "wall"))

WORDS = {
    "linear": "a linear loss",
    "convection": "natural convection",
    "radiation": "radiation",
    "wall": "a wall behind it",
    "shell": "a shell around it",
    "board": "a common board",
    "lag": "the lag of its sensor",
    "heater": "a heater with a heat capacity",
    "stray": "heat from the heater to the shell",
    "sink": "a sink that warms",
    "power law": "heat as a power of the drive",
    "link": "links between the places",
    "drift": "a room that drifts",
    "delay": "a delay",
}


def structures(family: Family) -> list[frozenset[str]]:
    """All structures of a family, the simplest first: every place has the same kinds of parts.

    With several channels all places are linked, since what the log does not show of a link its
    prior makes weak.
    """
    has_several = len(family.channels) > 1
    result = []
    optional = [("lag",)]
    optional += [("sink",)] * bool(family.cells)
    if len(family.cells) < len(family.inputs):
        optional += [("heater",), ("stray",)]
    optional += [("power law",)] * int(family.has_levels)
    for loss, back, *others in product(
        LOSSES, BACKS + BOARDS * has_several, *(((), kind) for kind in optional)
    ):
        kinds = {*loss, *back, *(kind for chosen in others for kind in chosen), "link"}
        if "stray" in kinds and not {"heater", "shell"} <= kinds:
            continue
        result.append(frozenset(part for part in family.choices if kind_of(part) in kinds))
    return sorted(result, key=len)


def kind_of(part: str) -> str:
    """The kind of a part: `"wall"` of `"wall 2"`."""
    return next(kind for kind in WORDS if part.startswith(f"{kind} "))


def in_words(parts: Set[str]) -> str:
    """A structure in words."""
    kinds = {kind_of(part) for part in parts}
    return "a block with " + ", ".join(text for kind, text in WORDS.items() if kind in kinds)
