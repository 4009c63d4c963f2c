"""What a fault means, in a few words with its size."""

import math

from .._number_text import short_number

# The model of a fault -> what it means, with its size: as a multiple of the healthy one (`times`,
# or `percent` of it), as a share in per cent, or in a usual unit.
PHRASES = {
    "loosen": "contact of {part} {times} times what it was",
    "age": "electrical resistance of {part} {times} times what it was",
    "block": "sink of {part} blocked, {times} times its resistance",
    "load": "heat capacity of {part} {times} times what it was",
    "leak": "losses of {part} {times} times what they were",
    "fail": "{share} % of {part} without current",
    "fade": "Seebeck coefficient of {part} at {percent} %",
    "reverse": "polarity of {part} swapped",
    "weaken": "voltage of {part} at {percent} %",
    "gain": "gain of {part} at {percent} %",
    "offset": "{part} reads {signed} K off",
    "stuck": "{part} is stuck",
    "swap": "{part} swapped",
    "move": "picture moved by {millimetres} mm along {part}",
    "delay": "commands {seconds} s late",
    "drift": "{part} drifts by {minute} K a minute",
}


def phrase_of(name: str, size: float, healthy: float) -> str:
    """What an explanation means; its own name if it is none of the usual faults."""
    model, _, part = name.partition(" ")
    if model not in PHRASES or not part:
        return name

    def number(value: float) -> str:
        return short_number(value, 2) if math.isfinite(value) else "many"

    ratio = size / healthy if healthy else size
    return PHRASES[model].format(
        part=part.replace("+", " and "),
        times=number(ratio),
        percent=number(100 * ratio),
        share=number(100 * min(size, 1.0)),
        signed=number(size) if size < 0 else f"+{number(size)}",
        seconds=number(size),
        millimetres=number(1000 * size),
        minute=number(60 * size),
    )
