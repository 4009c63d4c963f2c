"""What inputs besides the duty change, as numbers for C: sums of products of powers of inputs and
of the shares of their states."""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..control.controllers._law import Table
from ..physics._expressions import Expressions
from ..physics._input_effects import InputWiring
from ..rig import Input
from ..simulation import Stepper

Product = tuple[tuple[str, float], ...]
"""The powers of inputs and shares that are multiplied: pairs (name, exponent)."""

Sums = list[dict[Product, float]]
"""For each effect the factor of each product."""


def input_constants(stepper: Stepper) -> dict[str, int | float]:
    """The sizes of the tables of the inputs; none for a rig without any."""
    wiring = stepper.system.wiring.input_wiring
    if wiring is None:
        return {}
    sums = _effects(wiring, stepper)
    links = {"LINKS": len(wiring.links)} if len(wiring.links) else {}
    return {
        "EFFECTS": len(sums),
        "PRODUCTS": len(_products(sums)),
        "SHARES": len(_shares(wiring.inputs)),
        "BODIES": wiring.to_reservoir.shape[1],
        **links,
    }


def input_tables(stepper: Stepper) -> dict[str, Table]:
    """The arrays of the inputs, name -> values and comment; none for a rig without any."""
    system, field = stepper.system, stepper.field
    wiring, inputs = system.wiring.input_wiring, system.wiring.inputs
    if wiring is None:
        return {}
    sums = _effects(wiring, stepper)
    products, names = _products(sums), [name for name, *_ in _shares(inputs)]
    tables = {
        "input_start": (np.array([one.value for one in inputs]), "those of the rig file"),
        "input_scale": (np.array([one.scale for one in inputs]), "to SI units"),
        "input_offset": (np.array([one.offset for one in inputs]), "to SI units"),
        "exponent": (
            np.array([[dict(product).get(name, 0.0) for name in names] for product in products]),
            "of each input or share in each product",
        ),
        "by_product": (
            np.array([[row.get(product, 0.0) for product in products] for row in sums]),
            "effects by the products: of bodies, K, of links, W/K, and of the supply, V",
        ),
    }
    if field.reservoir_shapes is not None:
        tables["by_body"] = np.asarray(field.reservoir_shapes, float), "forces by a body's change"
    if len(wiring.links):
        held = np.zeros(wiring.to_reservoir.shape[1])
        if system.reservoirs is not None:
            held = np.asarray(system.reservoirs.temperature, float) - float(stepper.reference)
        tables |= {
            "across": (
                np.asarray(field.modes.switched, float),
                "temperature differences of the links that inputs change, by the modes, K",
            ),
            "link_ambient": (wiring.to_ambient, "and by the ambient"),
            "link_held": (wiring.to_reservoir @ held, "and by bodies at given temperatures, K"),
        }
        if wiring.to_reservoir.shape[1]:
            tables["link_body"] = wiring.to_reservoir, "and by their changes"
    return tables


def input_numbers(inputs: tuple[Input, ...]) -> dict[str, list[int]]:
    """The input of each share, and the number of its state, -1 for the input itself."""
    shares = _shares(inputs)
    return {
        "input_of": [number for _, number, _ in shares],
        "input_state": [state for *_, state in shares],
    }


def input_lines(inputs: tuple[Input, ...]) -> list[str]:
    """The lines of the header's comment: each input with its unit or its states."""
    lines = []
    for number, one in enumerate(inputs):
        states = ", ".join(f"{place} {state}" for place, state in enumerate(one.states))
        unit = states or one.unit
        lines.append(f"  {number}: {one.name}{unit and f', {unit}'} ({one.value:g})")
    return ["Other inputs, in the state (in the rig file):", *lines] if inputs else []


def _shares(inputs: tuple[Input, ...]) -> list[tuple[str, int, int]]:
    """Each input and each share of a state: its name, the input, and the state or -1."""
    return [
        row
        for number, one in enumerate(inputs)
        for row in (
            (one.name, number, -1),
            *((one.share(state), number, place) for place, state in enumerate(one.states)),
        )
    ]


def _products(sums: Sums) -> list[Product]:
    return list(dict.fromkeys(product for row in sums for product in row))


def _effects(wiring: InputWiring, stepper: Stepper) -> Sums:
    """The effects in the order of C: bodies and links as changes from the rig file, the supply."""
    assert stepper.system.input_values is not None
    values = {name: float(value) for name, value in stepper.system.input_values.items()}
    nominal = {name: number for one in wiring.inputs for name, number in one.nominal.items()}
    found = []
    for expressions in (wiring.reservoirs, wiring.conductances):
        before = np.asarray(expressions({**values, **nominal}), float)
        for row, number in zip(_sums(expressions, values, nominal), before, strict=True):
            row[()] = row.get((), 0.0) - float(number)
            found.append(row)
    return [*found, *_sums(wiring.supply_voltage, values, nominal)]


def _sums(
    expressions: Expressions, values: Mapping[str, float], nominal: Mapping[str, float]
) -> Sums:
    """The sums with numbers in place of the parameters; powers of inputs stay."""
    rows: Sums = [defaultdict(float) for _ in expressions.factors]
    for value, column in zip(expressions.products, expressions.factors.T, strict=True):
        product = tuple((name, power) for name, power in value.powers if name in nominal)
        rest = [(name, power) for name, power in value.powers if name not in nominal]
        factors: Float[np.ndarray, " sums"] = column * np.prod([values[n] ** p for n, p in rest])
        for row, factor in zip(rows, factors.tolist(), strict=True):
            if factor:
                row[product] += factor
    return rows
