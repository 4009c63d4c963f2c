"""A twin as C whose parameters can be set before the start, for an FMU, and its tables.

Its steps are those of `twin.c`. The numbers that these need are not constants: C computes them from
the parameters (`network.c`, `step_factors.c`), as `Stepper` does, and each instance has its own.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple, final

import numpy as np

from .._jax_settings import own_settings
from ..control import LawTable
from ..physics import OWN_VOLTAGE, STEFAN_BOLTZMANN, Expressions, Twin, Wiring
from ..rig import AMBIENT, Parameter
from ..simulation import MULTIPLE_TOLERANCE, STABILITY_LIMIT, Stepper
from ._input_tables import Polynomial, effect_factors, input_numbers, input_tables, polynomials
from ._sources import Code, Parts, ascii_text, code_of, defines, whole_numbers
from ._stepper_c import (
    COMMENTS,
    StepperSizes,
    about_twin,
    path_ends,
    stepper_constants,
    stepper_tables,
    twin_sizes,
)

# The tables from which C computes the network of a twin for any values of its parameters.

# Whole numbers and a comment.
WholeTable = tuple[list[int], str]


def settable_parameters(twin: Twin) -> list[Parameter]:
    """The parameters that can be set in C: those of the equations. Temperatures of the surroundings
    and of the start are set otherwise, and places on the plate and the camera's registration, on
    which weights of nodes depend, are constants."""
    rig, wiring = twin.rig, twin.wiring
    parts = [wiring.ambient, wiring.initial, wiring.ambient_drift]
    parts += [] if wiring.zones is None else [wiring.zones.registration]
    constant = {name for part in parts if part is not None for name in part.names}
    for place in rig.placements:
        constant |= {name for value in (place.x, place.y) for name, _ in value.powers}
    used = {name for part in _equations(wiring) for name in part.names}
    return [row for name, row in rig.parameters.items() if name in used - constant]


def _equations(wiring: Wiring) -> list[Expressions]:
    parts = [wiring.capacitances, wiring.resistances, wiring.conducting_sums, wiring.gains]
    parts += [wiring.module_constants, wiring.bridge_constants]
    parts += [wiring.lag, wiring.delay, wiring.current_limit, wiring.reservoirs]
    parts += [wiring.exponent, wiring.radiating, wiring.convection, wiring.drive_exponents]
    effects = wiring.input_wiring
    if effects is not None:
        parts += [effects.reservoirs, effects.conductances, effects.supply_voltage]
    return [part for part in parts if part is not None]


@final
class ParameterTables(NamedTuple):
    """What C computes a twin from.

    - `constants`: the sizes of the tables, and where each quantity begins among the sums.
    - `numbers`: the tables of whole numbers. `tables`: those of others; both with comments.
    """

    constants: dict[str, int | float]
    numbers: dict[str, WholeTable]
    tables: dict[str, LawTable]


def parameter_tables(
    twin: Twin, stepper: Stepper, parameters: Sequence[Parameter]
) -> ParameterTables:
    """Makes the tables: all quantities as sums of products of the parameters, and the branches of
    the network."""
    rows = _quantities(twin, stepper, frozenset(row.name for row in parameters))
    constants: dict[str, int | float] = {}
    sums: list[Polynomial] = []
    for key, result in rows.items():
        constants[f"SUM_{key}"] = len(sums)
        sums += result
    sums_constants, numbers, tables = _sum_tables(sums, [row.name for row in parameters])
    # An array of C has at least one entry.
    scales, offsets = ([getattr(row, key) for row in parameters] for key in ("scale", "offset"))
    tables |= {
        "parameter_scale": (np.array([*scales, 1.0]), "to SI units"),
        "parameter_offset": (np.array([*offsets, 0.0]), "to SI units"),
    }
    system = stepper.system
    weights = np.asarray(system.channel_weights, float)
    on_plate = np.broadcast_to(np.asarray(system.on_plate, float), len(weights))
    tables |= {
        "weights": (weights, "of the nodes in the channels"),
        "on_plate": (on_plate, "the shares of the channels' zones on the plate"),
    }
    if system.bridge.own_supply:
        square = np.where(system.bridge.own_supply, OWN_VOLTAGE.factor**2, 0.0)
        tables["own_square"] = square, "squares of the voltages of supplies of their own, V^2"
    branches = len(twin.netlist.links)
    return ParameterTables(
        constants | sums_constants | {"BRANCHES": branches},
        numbers | _branches(twin.wiring),
        tables,
    )


def _quantities(twin: Twin, stepper: Stepper, names: frozenset[str]) -> dict[str, list[Polynomial]]:
    """All quantities of the equations, by their names in C."""
    wiring, values, cells = twin.wiring, twin.numbers_si, len(twin.netlist.cells)

    def of(part: Expressions | None) -> list[Polynomial]:
        return [] if part is None else polynomials(part, values, names)

    branches, module = of(wiring.resistances), of(wiring.module_constants)
    for number, conductance in zip(
        wiring.conducting.tolist(), of(wiring.conducting_sums), strict=True
    ):
        branches[number] = conductance
    result = {
        "CAPACITANCE": of(wiring.capacitances),
        "BRANCH": branches,
        "ALPHA": module[:cells],
        "R": module[cells : 2 * cells],
        "BRIDGE": of(wiring.bridge_constants),
        "GAIN": of(wiring.gains),
        "LAG": of(wiring.lag),
        "DELAY": of(wiring.delay),
        "IMAX": of(wiring.current_limit),
        "RESERVOIR": of(wiring.reservoirs),
        "EXPONENT": of(wiring.exponent),
        "CONVECTION": of(wiring.convection),
        "DRIVE_EXPONENT": of(wiring.drive_exponents),
        "RADIATING": of(wiring.radiating),
        "BY_PRODUCT": effect_factors(stepper, values, names),
    }
    return {key: rows for key, rows in result.items() if rows}


def _sum_tables(
    sums: list[Polynomial], names: list[str]
) -> tuple[dict[str, int], dict[str, WholeTable], dict[str, LawTable]]:
    """Sums of monomials, and monomials of parameters, as lists one after the other."""
    monomials = list(dict.fromkeys(powers for row in sums for powers in row))
    place = {powers: number for number, powers in enumerate(monomials)}
    powers = [pair for monomial in monomials for pair in monomial]
    terms = [term for row in sums for term in row.items()]
    constants = {"SUMS": len(sums), "MONOMIALS": len(monomials)}
    numbers = {
        "monomial_start": (_starts(monomials), "where the powers of each product begin"),
        "monomial_parameter": ([*(names.index(name) for name, _ in powers), 0], "and their bases"),
        "sum_start": (_starts(sums), "where the terms of each sum begin"),
        "sum_monomial": ([place[powers] for powers, _ in terms], "and their products"),
    }
    exponents = np.array([*(exponent for _, exponent in powers), 0.0])
    factors = np.array([factor for _, factor in terms])
    return (
        constants,
        numbers,
        {
            "monomial_power": (exponents, "exponents of the parameters in each product"),
            "sum_factor": (factors, "of the products in each sum"),
        },
    )


def _starts(rows: Sequence[Sequence[object] | Polynomial]) -> list[int]:
    return [0, *accumulate(len(row) for row in rows)]


def _branches(wiring: Wiring) -> dict[str, WholeTable]:
    """The thermal resistances between nodes. Beyond the numbers of the nodes are those of the
    surroundings and of the bodies of given temperatures."""
    netlist = wiring.netlist
    ends = [*netlist.index, AMBIENT, *(body.name for body in netlist.reservoirs)]
    place = {name: number for number, name in enumerate(ends)}
    conducting = set(wiring.conducting.tolist())
    count = range(len(netlist.links))
    result = {
        "branch_from": ([place[link.a] for link in netlist.links], "nodes"),
        "branch_to": (
            [place[link.b] for link in netlist.links],
            "nodes, then the surroundings, then bodies of given temperatures",
        ),
        "branch_conducts": (
            [int(number in conducting) for number in count],
            "whether its sum is a conductance, not a resistance",
        ),
    }
    if wiring.film_sums is not None:
        films = set(wiring.film_sums.members[1].tolist())
        is_film = [int(number in films) for number in count]
        result["branch_is_film"] = is_film, "whether it is the film of an element"
    effects = wiring.input_wiring
    if effects is not None and len(effects.links):
        result["link_branch"] = effects.links.tolist(), "the branches that inputs change"
    return result


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
    name: str, tables: Mapping[str, LawTable], scalars: Sequence[str], *, has_delay: bool
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


def _in_instance(name: str, tables: Mapping[str, LawTable], scalars: Sequence[str]) -> str:
    """Puts the numbers of an instance in the place of constants."""
    places = {f"{name}_{key}": f"numbers->{key}" for key in tables}
    places |= {f"{name.upper()}_{key}": f"numbers->{key}" for key in scalars}
    places[f"{name.upper()}_PARTS"] = "numbers->parts"
    places[f"{name.upper()}_WAITING"] = "state->numbers->waiting"
    lines = "".join(f"#define {key} ({place})\n" for key, place in places.items())
    return f"/* The numbers of an instance, as twin_steps.c names them. */\n{lines}\n"
