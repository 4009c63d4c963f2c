"""The variables of an FMU of a twin, which are the same for FMI 2 and FMI 3."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..c_export._parameter_tables import settable_parameters
from ..c_export._text import ascii_text
from ..physics import Twin
from ..rig import Input, Parameter
from ..simulation import Stepper

Causality = Literal["independent", "parameter", "input", "output", "local"]


class Variable(NamedTuple):
    """A variable of an FMU.

    - `reference`: its number, counted from 0 in the order of the variables.
    - `unit`: such as "degC", "s", "K/s", or the unit of a parameter; "" for none.
    - `start`: the value at the start; None for a variable that is computed.
    - `is_discrete`: whether it changes only at events.
    - `state`: the number of the state whose derivative it is; None if it is not a derivative.
    - `choices`: the names of the states of an input that has states, whose number is its value.
    """

    name: str
    reference: int
    causality: Causality
    unit: str
    start: float | None
    limits: tuple[float, float] | None
    description: str
    is_discrete: bool = False
    state: int | None = None
    choices: tuple[str, ...] = ()


def variables_of(twin: Twin, stepper: Stepper) -> list[Variable]:
    """Returns time, duty cycles, ambient, the rig's other inputs, channels, the states, which can
    be set before the start, their derivatives, and the parameters.

    The states are the temperatures of the nodes and, if the driver has a lag, the duty cycles
    behind it.
    """
    system = stepper.system
    wiring, start = system.wiring, np.asarray(stepper.start().nodes, float)
    cells = [cell.name for cell in wiring.netlist.cells]
    lowest_duty = wiring.lowest_duty.tolist()
    rows = [
        Variable("time", 0, "independent", "s", None, None, "Time"),
        *(
            Variable(
                f"duty.{cell}",
                0,
                "input",
                "",
                0.0,
                (lowest, 1.0),
                "Duty cycle, positive heats",
                is_discrete=system.delay is not None,
            )
            for cell, lowest in zip(cells, lowest_duty, strict=True)
        ),
        Variable(
            "ambient", 0, "input", "degC", float(stepper.ambient), None, "Ambient temperature"
        ),
        *(_input_variable(rig_input) for rig_input in wiring.inputs),
        *(
            Variable(channel, 0, "output", "degC", None, None, "What the channel reads")
            for channel in wiring.channels
        ),
    ]
    text = "Temperature of a node of the twin; the start can be set"
    states = [
        Variable(f"node.{node.name}", 0, "local", "degC", temperature, None, text)
        for node, temperature in zip(wiring.netlist.nodes, start.tolist(), strict=True)
    ]
    if system.lag is not None:
        text = "Duty cycle behind the driver's lag; the start can be set"
        states += [
            Variable(f"lagged_duty.{cell}", 0, "local", "", 0.0, (lowest, 1.0), text)
            for cell, lowest in zip(cells, lowest_duty, strict=True)
        ]
    first = len(rows)
    slopes = [
        Variable(
            f"der({state.name})",
            0,
            "local",
            "K/s" if state.unit else "1/s",
            None,
            None,
            "How fast it changes",
            state=first + number,
        )
        for number, state in enumerate(states)
    ]
    taken = {row.name for row in (*rows, *states, *slopes)}
    parameters = [
        _parameter_variable(row, float(twin.values[row.name]), taken)
        for row in settable_parameters(twin)
    ]
    return [
        variable._replace(reference=number)
        for number, variable in enumerate([*rows, *states, *slopes, *parameters])
    ]


def names_c(name: str, variables: Sequence[Variable]) -> str:
    """The names of the variables as C, for messages."""
    texts = (
        ascii_text(variable.name).translate(str.maketrans('"\\%', "'/_")) for variable in variables
    )
    lines = "".join(f'    "{text}",\n' for text in texts)
    return f"static const char *const {name}_names[] = {{\n{lines}}};\n"


def _parameter_variable(row: Parameter, value: float, taken: set[str]) -> Variable:
    """The variable of a parameter, whose bounds contain the twin's value."""
    return Variable(
        f"parameter.{row.name}" if row.name in taken else row.name,
        0,
        "parameter",
        row.unit,
        value,
        (min(row.lower, value), max(row.upper, value)),
        row.description or "Parameter of the rig",
    )


def _input_variable(source: Input) -> Variable:
    """The variable of an input: an enumeration of its states, or a number in its unit."""
    numbers = ", ".join(f"{number} {state}" for number, state in enumerate(source.states))
    text = source.description or (f"State: {numbers}" if source.states else "Input of the rig")
    return Variable(
        f"input.{source.name}",
        0,
        "input",
        source.unit,
        source.value,
        None,
        text,
        is_discrete=bool(source.states),
        choices=source.states,
    )
