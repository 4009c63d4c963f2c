"""What inputs besides the duty change, as numbers for C: sums of products of powers of inputs and
of the shares of their states."""

import math
from collections.abc import Mapping

import numpy as np

from ..control import LawTable
from ..physics import Expressions
from ..rig import Input
from ..simulation import Stepper

# The powers of inputs and shares that are multiplied: pairs (name, exponent).
Product = tuple[tuple[str, float], ...]

# A sum of products of parameters: product -> factor.
Polynomial = dict[Product, float]

# For each effect the factor of each product of inputs and shares.
Effects = list[dict[Product, Polynomial]]

NO_NAMES: frozenset[str] = frozenset()


def input_constants(stepper: Stepper) -> dict[str, int | float]:
    """The sizes of the tables of the inputs; none for a rig without any."""
    wiring = stepper.system.wiring.input_wiring
    if wiring is None:
        return {}
    sums = effects_of_inputs(stepper)
    links = {"LINKS": len(wiring.links)} if len(wiring.links) else {}
    return {
        "EFFECTS": len(sums),
        "PRODUCTS": len(_products(sums)),
        "SHARES": len(_shares(wiring.inputs)),
        "BODIES": wiring.to_reservoir.shape[1],
        **links,
    }


def input_tables(stepper: Stepper) -> dict[str, LawTable]:
    """The arrays of the inputs, name -> values and comment; none for a rig without any."""
    system, field = stepper.system, stepper.field
    wiring, inputs = system.wiring.input_wiring, system.wiring.inputs
    if wiring is None:
        return {}
    sums = effects_of_inputs(stepper)
    products, names = _products(sums), [name for name, *_ in _shares(inputs)]
    tables = {
        "input_start": (
            np.array([rig_input.value for rig_input in inputs]),
            "those of the rig file",
        ),
        "input_scale": (np.array([rig_input.scale for rig_input in inputs]), "to SI units"),
        "input_offset": (np.array([rig_input.offset for rig_input in inputs]), "to SI units"),
        "exponent": (
            np.array([[dict(product).get(name, 0.0) for name in names] for product in products]),
            "of each input or share in each product",
        ),
        "by_product": (
            np.array([[row.get(p, {}).get((), 0.0) for p in products] for row in sums]),
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
    for number, rig_input in enumerate(inputs):
        states = ", ".join(f"{place} {state}" for place, state in enumerate(rig_input.states))
        unit = states or rig_input.unit
        lines.append(f"  {number}: {rig_input.name}{unit and f', {unit}'} ({rig_input.value:g})")
    return ["Other inputs, in the state (in the rig file):", *lines] if inputs else []


def _shares(inputs: tuple[Input, ...]) -> list[tuple[str, int, int]]:
    """Each input and each share of a state: its name, the input, and the state or -1."""
    return [
        row
        for number, rig_input in enumerate(inputs)
        for row in (
            (rig_input.name, number, -1),
            *(
                (rig_input.share(state), number, place)
                for place, state in enumerate(rig_input.states)
            ),
        )
    ]


def _products(sums: Effects) -> list[Product]:
    return list(dict.fromkeys(product for row in sums for product in row))


def effect_factors(
    stepper: Stepper, numbers: Mapping[str, float], settable: frozenset[str]
) -> list[Polynomial]:
    """The entries of the table `by_product`, row by row, with these parameters left open; none for
    a rig without inputs. `numbers` are the values of the others, in SI units."""
    if stepper.system.wiring.input_wiring is None:
        return []
    sums = effects_of_inputs(stepper, numbers, settable)
    return [row.get(product, {}) for row in sums for product in _products(sums)]


def effects_of_inputs(
    stepper: Stepper,
    numbers: Mapping[str, float] | None = None,
    settable: frozenset[str] = NO_NAMES,
) -> Effects:
    """The effects in the order of C: bodies and links as changes from the rig file, the supply."""
    wiring, values = stepper.system.wiring.input_wiring, stepper.system.input_values
    assert wiring is not None
    assert values is not None
    known = {name: float(value) for name, value in values.items()} if numbers is None else numbers
    nominal = {
        name: number for rig_input in wiring.inputs for name, number in rig_input.nominal.items()
    }
    result = []
    for expressions in (wiring.reservoirs, wiring.conductances):
        before = polynomials(expressions, {**known, **nominal}, settable)
        rows = _sums(expressions, known, nominal, settable)
        for row, constant in zip(rows, before, strict=True):
            own = row.setdefault((), {})
            for powers, factor in constant.items():
                own[powers] = own.get(powers, 0.0) - factor
            result.append(row)
    return [*result, *_sums(wiring.supply_voltage, known, nominal, settable)]


def polynomials(
    expressions: Expressions, numbers: Mapping[str, float], settable: frozenset[str] = NO_NAMES
) -> list[Polynomial]:
    """The sums with numbers in place of all parameters but those that are left open."""
    return [row.get((), {}) for row in _sums(expressions, numbers, {}, settable)]


def _sums(
    expressions: Expressions,
    numbers: Mapping[str, float],
    inputs: Mapping[str, float],
    settable: frozenset[str],
) -> Effects:
    """The sums with numbers in place of the parameters; powers of inputs, and of parameters that
    are left open, stay."""
    rows: Effects = [{} for _ in expressions.factors]
    for value, column in zip(expressions.products, expressions.factors.T, strict=True):
        product = tuple((name, power) for name, power in value.powers if name in inputs)
        others = [pair for pair in value.powers if pair[0] not in inputs]
        powers = tuple(pair for pair in others if pair[0] in settable)
        rest = math.prod(numbers[name] ** power for name, power in others if name not in settable)
        for row, factor in zip(rows, column.tolist(), strict=True):
            if factor:
                of_product = row.setdefault(product, {})
                of_product[powers] = of_product.get(powers, 0.0) + factor * rest
    return rows
