"""What a fault means in a few words: every usual suspect has its words."""

import math

import pytest

from jaxtwin import Twin
from jaxtwin.diagnosis import suspects
from jaxtwin.diagnosis._diagnosis import phrase_of


@pytest.mark.parametrize("rig", ["dual-cell", "heated-box", "tclab"])
def test_each_suspect_has_a_phrase_with_its_part(rig: str) -> None:
    for name, suspect in suspects(Twin(rig)).items():
        text = phrase_of(name, suspect.size, suspect.none)
        assert text != name
        part = name.partition(" ")[2].partition("+")[0]
        assert part == "command" or part in text


@pytest.mark.parametrize(
    ("name", "size", "healthy", "phrase"),
    [
        ("loosen P1", 2.53, 1.0, "contact of P1 2.5 times what it was"),
        ("loosen P1", math.inf, 1.0, "contact of P1 many times what it was"),
        ("leak plate", 0.3, 0.1, "losses of plate 3 times what they were"),
        ("weaken supply", 0.8, 1.0, "voltage of supply at 80 %"),
        ("fail P2", 0.5, 0.0, "50 % of P2 without current"),
        ("offset T11", -0.5, 0.0, "T11 reads -0.5 K off"),
        ("move x", 0.002, 0.0, "picture moved by 2 mm along x"),
        ("drift room", 0.01, 0.0, "room drifts by 0.6 K a minute"),
        ("none of these", math.nan, math.nan, "none of these"),
        ("a fault of the user's", 2.0, 1.0, "a fault of the user's"),
    ],
)
def test_the_size_is_in_the_phrase(name: str, size: float, healthy: float, phrase: str) -> None:
    assert phrase_of(name, size, healthy) == phrase
