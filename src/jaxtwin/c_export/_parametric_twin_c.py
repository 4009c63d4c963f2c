"""A twin as C whose parameters can be set before the start, for an FMU.

Its steps are those of `twin.c`. The numbers that these need are not constants: C computes them from
the parameters (`network.c`, `step_factors.c`), as `Stepper` does, and each instance has its own.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from .._jax_settings import own_settings
from ..control import Table
from ..physics import STEFAN_BOLTZMANN, Twin
from ..rig import Parameter
from ..simulation import MULTIPLE_TOLERANCE, STABILITY_LIMIT, Stepper
from ._input_tables import input_numbers, input_tables
from ._parameter_tables import parameter_tables
from ._sources import Code, Parts, code_of, defines, whole_numbers
from ._stepper_c import about_twin, path_ends, twin_sizes
from ._stepper_tables import COMMENTS, StepperSizes, stepper_constants, stepper_tables
from ._text import ascii_text

# The tables that no parameter changes: those of inputs, and one of losses.
FIXED = ("input_start", "input_scale", "input_offset", "exponent", "link_ambient", "link_body")
FIXED += ("linear_radiation",)

# The constants that parameters change.
SCALARS = ("VS", "RS", "RON", "IMAX")

BY_PART = ("half_decay", "decay", "half", "half_start", "half_middle", "whole_start")
BY_PART += ("whole_middle", "first", "middle", "last", "lag", "at")
"""The tables with a row for each part of a step."""

# The constants of physics and of `Stepper` from which C computes the numbers.
CONSTANTS = {
    "STEFAN_BOLTZMANN": STEFAN_BOLTZMANN,
    "WHOLE": MULTIPLE_TOLERANCE,
    "STABILITY_LIMIT": STABILITY_LIMIT,
}

# Macro of the network -> its meaning and its unit.
NETWORK_COMMENTS = {
    "SUMS": "of products of parameters, in which quantities begin at these numbers",
    "MONOMIALS": "products of powers of parameters",
    "BRANCHES": "thermal resistances",
    "STEFAN_BOLTZMANN": "W/(m^2 K^4)",
    "WHOLE": "relative difference below which a delay is a multiple of the step",
    "STABILITY_LIMIT": "of the gain of a step, above which steps are not stable",
}


def parametric_twin_c(
    twin: Twin, stepper: Stepper, name: str, origin: str, parameters: Sequence[Parameter]
) -> Code:
    """Returns header, source and numbers, in double precision.

    **Arguments:**

    - `twin`, `stepper`: the twin, and its steps.
    - `parameters`: those that can be set, in their order.

    **Raises:** `ControlError` if a number of the twin is not finite.
    """
    with own_settings():
        sizes = StepperSizes(stepper)
        if sizes.has_delay:
            sizes.queue = _longest_queue(twin, stepper, parameters)
        given = parameter_tables(twin, stepper, parameters)
        rates = np.asarray(stepper.field.modes.rates, float)
        inputs = stepper.system.wiring.inputs
        tables = stepper_tables(stepper, sizes) | input_tables(stepper)
        tables["rate"] = rates, "by which the modes decay, 1/s"
        fixed = {key: tables.pop(key) for key in FIXED if key in tables}
        constants = stepper_constants(stepper, sizes) | given.constants | CONSTANTS
        scalars = [key for key in SCALARS if key in constants]
        constants = {k: v for k, v in constants.items() if k not in (*scalars, "PARTS")}
        of_inputs = input_numbers(inputs) if inputs else {}
        parts = Parts(
            about_twin(stepper, sizes, name, "double", origin, parameters),
            twin_sizes(stepper, sizes, name, "double")
            + defines(name, {"PARAMETERS": len(parameters)}, "double", COMMENTS)
            + _struct(name, tables, scalars, has_delay=sizes.has_delay),
            _in_instance(name, tables, scalars)
            + defines(name, constants, "double", COMMENTS | NETWORK_COMMENTS)
            + "\n/* Nodes of the cold sides of the cells, and of the hot ones. */\n"
            + whole_numbers(name, "side", sizes.sides)
            + path_ends(name, sizes)
            + "".join(whole_numbers(name, key, *result) for key, result in given.numbers.items())
            + "".join(whole_numbers(name, key, result) for key, result in of_inputs.items()),
            given.tables | fixed,
            states=0,
            has_parameters=True,
        )
        return code_of("parametric_twin", name, "double", parts)


def _longest_queue(twin: Twin, stepper: Stepper, parameters: Sequence[Parameter]) -> int:
    """The number of commands that are on their way with the longest delay within the bounds."""
    expression = twin.wiring.delay
    assert expression is not None
    ends = [
        {row.name: row.to_si(limit) for row in parameters if np.isfinite(limit := pick(row))}
        for pick in (lambda row: row.lower, lambda row: row.upper)
    ]
    delays = [float(expression.numbers(twin.numbers_si | end)[0]) for end in ({}, *ends)]
    step = float(np.asarray(stepper.sizes).sum())
    return int(max(delays) / step * (1 + MULTIPLE_TOLERANCE)) + 1


def _struct(
    name: str, tables: Mapping[str, Table], scalars: Sequence[str], *, has_delay: bool
) -> str:
    """The numbers of an instance. With a delay a step has up to two parts."""
    lines = [f"    double {key}; /* {COMMENTS[key]} */" for key in scalars]
    for key, (values, comment) in tables.items():
        shape = (1 + has_delay, *values.shape[1:]) if key in BY_PART else values.shape
        sizes = "".join(f"[{size}]" for size in shape)
        lines += [f"    /* {ascii_text(comment)} */", f"    double {key}{sizes};"]
    lines += [
        "    double delay_s, lag_s; /* of the driver, 0 for none */",
        "    int parts, waiting; /* parts of a step, and commands on their way */",
        "    int is_stable; /* whether the steps are */",
    ]
    body = "\n".join(lines)
    return f"\n/* The numbers of an instance. */\ntypedef struct {{\n{body}\n}} {name}_numbers;\n"


def _in_instance(name: str, tables: Mapping[str, Table], scalars: Sequence[str]) -> str:
    """Puts the numbers of an instance in the place of constants."""
    places = {f"{name}_{key}": f"numbers->{key}" for key in tables}
    places |= {f"{name.upper()}_{key}": f"numbers->{key}" for key in scalars}
    places[f"{name.upper()}_PARTS"] = "numbers->parts"
    places[f"{name.upper()}_WAITING"] = "state->numbers->waiting"
    lines = "".join(f"#define {key} ({place})\n" for key, place in places.items())
    return f"/* The numbers of an instance, as twin_steps.c names them. */\n{lines}\n"
