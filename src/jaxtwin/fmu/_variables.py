"""What an FMU of a twin takes and gives, the same for FMI 2 and FMI 3."""

from typing import Literal, NamedTuple

import numpy as np

from ..simulation import Stepper

Causality = Literal["independent", "input", "output", "local"]


class Variable(NamedTuple):
    """A variable of an FMU.

    - `reference`: its number, from 0 on in the order of the variables.
    - `unit`: "degC", "s", or "" for none.
    - `start`: None for what is computed.
    """

    name: str
    reference: int
    causality: Causality
    unit: str
    start: float | None
    limits: tuple[float, float] | None
    description: str


def variables_of(stepper: Stepper) -> list[Variable]:
    """Time, duty cycles, ambient, channels, and the temperatures of the nodes, which can be set
    before the start."""
    wiring, start = stepper.system.wiring, np.asarray(stepper.start().nodes, float)
    nodes = zip(wiring.netlist.nodes, start.tolist(), strict=True)
    rows: list[tuple[str, Causality, str, float | None]] = [
        ("time", "independent", "s", None),
        *((f"duty.{cell.name}", "input", "", 0.0) for cell in wiring.netlist.cells),
        ("ambient", "input", "degC", float(stepper.ambient)),
        *((channel, "output", "degC", None) for channel in wiring.channels),
        *((f"node.{node.name}", "local", "degC", temperature) for node, temperature in nodes),
    ]
    words = {
        "independent": "Time",
        "output": "What the channel reads",
        "local": "Temperature of a node of the twin; the start can be set",
    }
    return [
        Variable(
            name,
            reference,
            causality,
            unit,
            start,
            (-1.0, 1.0) if name.startswith("duty.") and causality == "input" else None,
            words.get(causality)
            or ("Ambient temperature" if unit else "Duty cycle, positive heats the plate"),
        )
        for reference, (name, causality, unit, start) in enumerate(rows)
    ]
