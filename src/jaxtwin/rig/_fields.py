"""Fields of one rig file: text -> `Value`, with the checks that need the parameter table."""

import functools
from collections.abc import Iterator, Mapping
from typing import final

from ._parameter import Parameter
from ._problems import refuse, unknown
from ._units import Kind, is_quantity, parse_quantity, unit_scale
from ._value import Value


@final
class Fields:
    """Converts the fields of one file and remembers which parameters they use.

    **Arguments:**

    - `source`: the file, for messages.
    - `parameters`: its parameter table.
    - `parameter_sets`: its sets; a value must be in range for each of them.
    """

    def __init__(
        self,
        source: str,
        parameters: Mapping[str, Parameter],
        parameter_sets: Mapping[str, Mapping[str, float]],
    ):
        self.source = source
        self.parameters = parameters
        self.parameter_sets = parameter_sets
        self.used: set[str] = set()
        self.refuse = functools.partial(refuse, source)

    def value(self, field: str, text: str, kind: Kind) -> Value:
        """A quantity or the name of a parameter, as a value of a kind.

        **Raises:** `RigError` where it is neither, has a wrong unit or is out of range.
        """
        if is_quantity(text):
            return Value(self.constant(field, text, kind))
        if not text.isidentifier():
            self.refuse(field, f"found {text!r}, allowed is {kind} or the name of a parameter")
        if text not in self.parameters:
            self.refuse(field, unknown("parameter", text, self.parameters))
        self.used.add(text)
        parameter = self.parameters[text]
        try:
            unit_scale(parameter.unit, kind)
        except ValueError as problem:
            self.refuse(field, f"parameter {text!r}: {problem}, allowed is {kind}")
        for which, number in self._candidates(parameter):
            if not _in_range(parameter.to_si(number), kind):
                self.refuse(
                    field, f"{which} of {text!r} is {number:g} {parameter.unit}, allowed is {kind}"
                )
        return Value(1.0, ((text, 1.0),))

    def constant(self, field: str, text: str, kind: Kind) -> float:
        """A quantity of a kind, in SI units.

        **Raises:** `RigError` where it is none, has a wrong unit or is out of range.
        """
        try:
            number = parse_quantity(text, kind)
        except ValueError as problem:
            self.refuse(field, f"{problem}, allowed is {kind}")
        if not _in_range(number, kind):
            self.refuse(field, f"found {text!r}, allowed is {kind}")
        return number

    def check_all_used(self) -> None:
        """Refuses a parameter that nothing uses: it could be matched without any effect."""
        for name in self.parameters:
            if name not in self.used:
                self.refuse(
                    f"parameters.{name}",
                    "nothing uses it, allowed are parameters that a field of the rig names",
                )

    def _candidates(self, parameter: Parameter) -> Iterator[tuple[str, float]]:
        yield "the value", parameter.value
        if abs(parameter.lower) != float("inf"):
            yield "the lower bound", parameter.lower
        for name, values in self.parameter_sets.items():
            if parameter.name in values:
                yield f"the value in the parameter set {name!r}", values[parameter.name]


def _in_range(number: float, kind: Kind) -> bool:
    return number > 0 or (number == 0 and kind.least == "zero")
