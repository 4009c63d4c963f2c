"""Converts the fields of a rig file to `Value`s, with the checks that need the parameter table."""

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import final

from .._name_suggestions import unknown_name
from ._toml import refuse
from ._units import (
    CURRENT,
    HEATER_POWER,
    THERMAL_RESISTANCE,
    VOLTAGE,
    Kind,
    is_infinite,
    is_quantity,
    parse_quantity,
    range_problem,
    unit_scale,
)
from ._value import Input, Parameter, Switched, Value, depends_on


@final
class Fields:
    """Converts the fields of one file and remembers which parameters they use.

    **Arguments:**

    - `source`: the file, for messages.
    - `parameters`: its parameter table.
    - `parameter_sets`: its sets; a value must be in range for each of them.
    - `inputs`: its inputs, which some fields may name in place of a parameter.
    """

    def __init__(
        self,
        source: str,
        parameters: Mapping[str, Parameter],
        parameter_sets: Mapping[str, Mapping[str, float]],
        inputs: Sequence[Input] = (),
    ):
        self.refuse = functools.partial(refuse, source)
        self._parameters = parameters
        self._parameter_sets = parameter_sets
        self._inputs = {rig_input.name: rig_input for rig_input in inputs}
        self._used: set[str] = set()

    def value(self, field: str, text: str, kind: Kind) -> Value:
        """Converts a quantity, or the name of a parameter, to a value of a kind.

        **Raises:** `RigError` if it is neither, has a wrong unit or is out of range. A parameter
        must be in range with its value, with its finite bounds and with its value in every set.
        """
        if is_quantity(text):
            return Value(self.constant(field, text, kind))
        if not text.isidentifier():
            self.refuse(field, f"expected {kind} or the name of a parameter, got {text!r}")
        if text in self._inputs:
            self.refuse(
                field,
                f"expected {kind} or the name of a parameter, got the input {text!r}; an input may "
                "stand for a resistance or a fan's speed of links and sinks, the driver's "
                "supply_voltage, and the temperature of a body",
            )
        self.check_known(field, "parameter", text, self._parameters)
        parameter = self._parameters[text]
        try:
            unit_scale(parameter.unit, kind)
        except ValueError as problem:
            self.refuse(field, f"expected {kind}, got the parameter {text!r}, {problem}")
        for which, number in self._numbers(parameter):
            problem = range_problem(parameter.to_si(number), kind)
            if problem:
                result = f"{number:g} {parameter.unit}".strip()
                self.refuse(field, f"expected {problem}, got {result} as the {which} of {text!r}")
        self._used.add(text)
        return Value(1.0, ((text, 1.0),))

    def optional(self, at: str, table: object, key: str, kind: Kind) -> Value | None:
        """Converts the quantity of a key of a table as `value`; None where the file gives none.

        **Raises:** `RigError` as `value`.
        """
        text = getattr(table, key)
        return None if text is None else self.value(f"{at}.{key}", text, kind)

    def depends_on_input(self, value: Value) -> bool:
        """Whether a value depends on an input."""
        return depends_on(value, tuple(self._inputs.values()))

    def bounds(self, value: Value) -> tuple[float, float]:
        """The lowest and the highest number that a `value` may have: the bounds of a parameter, in
        SI units."""
        if value.is_constant:
            return value.factor, value.factor
        ((name, _),) = value.powers
        parameter = self._parameters[name]
        return parameter.to_si(parameter.lower), parameter.to_si(parameter.upper)

    def path(self, field: str, text: str) -> Value | None:
        """Converts a thermal resistance of a path that may be absent: `"inf K/W"` is None.

        **Raises:** `RigError` as `value`.
        """
        try:
            if is_infinite(text, THERMAL_RESISTANCE):
                return None
        except ValueError as problem:
            self.refuse(field, f"expected {THERMAL_RESISTANCE}, got {text!r}, {problem}")
        return self.value(field, text, THERMAL_RESISTANCE)

    def varying_path(self, field: str, given: str | Mapping[str, str]) -> Value | Switched | None:
        """Converts a thermal resistance as `path`, which an input may change: it may be the name of
        an input, or a resistance for each state of an input.

        **Raises:** `RigError` as `value`, and if the states are not those of the input.
        """
        if isinstance(given, str):
            if given in self._inputs:
                return self.input_or_value(field, given, THERMAL_RESISTANCE)
            return self.path(field, given)
        by = given["by"]
        self.check_known(f"{field}.by", "input", by, self._inputs)
        source = self._inputs[by]
        states = [key for key in given if key != "by"]
        if sorted(states) != sorted(source.states):
            known = ", ".join(source.states) or "none, because it is a number"
            self.refuse(
                field,
                f"expected a value for each state of {by!r}, {known}, got {', '.join(states)}",
            )
        self._used.add(by)
        values = [
            (source.share(state), self.path(f"{field}.{state}", given[state]))
            for state in source.states
        ]
        finite = tuple((share, value) for share, value in values if value is not None)
        return Switched(finite) if finite else None

    def input_or_value(self, field: str, text: str, kind: Kind) -> Value:
        """Converts a quantity, or the name of a parameter or an input.

        **Raises:** `RigError` as `value`, and for an input that has states or another unit.
        """
        if text not in self._inputs:
            return self.value(field, text, kind)
        source = self._inputs[text]
        if source.states:
            self.refuse(
                field,
                f"expected a value for each state of {text!r}, such as {{ {source.states[0]} = "
                f'..., by = "{text}" }}, got the input itself',
            )
        try:
            unit_scale(source.unit, kind)
        except ValueError as problem:
            self.refuse(field, f"expected {kind}, got the input {text!r}, {problem}")
        self._used.add(text)
        return Value(1.0, ((text, 1.0),))

    def constant(self, field: str, text: str, kind: Kind) -> float:
        """Converts a quantity of a kind to SI units.

        **Raises:** `RigError` if it is none, has a wrong unit or is out of range.
        """
        try:
            number = parse_quantity(text, kind)
        except ValueError as problem:
            self.refuse(field, f"expected {kind}, got {text!r}, {problem}")
        problem = range_problem(number, kind)
        if problem:
            self.refuse(field, f"expected {problem}, got {text!r}")
        return number

    def optional_constant(self, at: str, table: object, key: str, kind: Kind) -> float | None:
        """Converts the quantity of a key of a table as `constant`; None where the file gives none.

        **Raises:** `RigError` as `constant`.
        """
        text = getattr(table, key)
        return None if text is None else self.constant(f"{at}.{key}", text, kind)

    def full_scale(self, field: str, text: str | None) -> tuple[float, str] | None:
        """Converts the power, the voltage or the current of full duty to a number and its unit.

        **Raises:** `RigError` if it is none of them, or not above 0.
        """
        if text is None:
            return None
        kinds = [kind for kind in (HEATER_POWER, VOLTAGE, CURRENT) if _measures(text, kind)]
        if not kinds:
            self.refuse(
                field, f'expected a power, a voltage or a current such as "12 V", got {text!r}'
            )
        return self.constant(field, text, kinds[0]), kinds[0].unit

    def check_known(self, field: str, what: str, name: str, known: Iterable[str]) -> None:
        """Refuses a name that is not among the known ones, and suggests the nearest."""
        if name not in known:
            self.refuse(field, unknown_name(what, name, known))

    def check_element(
        self, field: str, name: str, elements: tuple[str, ...], bodies: Sequence[str] = ()
    ) -> None:
        """Refuses a name that is neither an element of the plate nor one of the given bodies."""
        if name not in elements and name not in bodies:
            known = []
            if elements:
                known.append(f"one of the plate's elements {elements[0]} to {elements[-1]}")
            if bodies:
                known.append(f"one of the bodies {', '.join(bodies)}")
            expected = ", or ".join(known) or "a [plate] or [[bodies]] in the file"
            self.refuse(field, f"expected {expected}, got {name!r}")

    def check_unique(self, field: str, names: list[str]) -> None:
        """Refuses a name that occurs twice."""
        for name in names:
            if names.count(name) > 1:
                self.refuse(field, f"expected each name once, got {name!r} twice")

    def check_all_used(self) -> None:
        """Refuses an input or a parameter that nothing uses: it would be matched without any
        effect."""
        for name in self._inputs:
            if name not in self._used:
                self.refuse(
                    f"inputs[{name}]",
                    "expected an input that a field of the rig names, got one that nothing uses; "
                    "remove it or use it",
                )
        for name in self._parameters:
            if name not in self._used:
                self.refuse(
                    f"parameters.{name}",
                    "expected a parameter that a field of the rig names, got one that nothing "
                    "uses; remove it or use it",
                )

    def _numbers(self, parameter: Parameter) -> Iterator[tuple[str, float]]:
        yield "value", parameter.value
        for which, bound in (("lower bound", parameter.lower), ("upper bound", parameter.upper)):
            if abs(bound) != float("inf"):
                yield which, bound
        for name, values in self._parameter_sets.items():
            if parameter.name in values:
                yield f"value in the parameter set {name!r}", values[parameter.name]


def _measures(text: str, kind: Kind) -> bool:
    """Whether a text is a quantity of a kind."""
    try:
        parse_quantity(text, kind)
    except ValueError:
        return False
    return True
