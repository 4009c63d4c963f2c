"""The variables of an FMU, and the files that describe it: `modelDescription.xml`, and
`buildDescription.xml` of FMI 3."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from .._celsius import ZERO_CELSIUS
from ..c_export._parametric_twin_c import settable_parameters
from ..c_export._sources import ascii_text
from ..physics import Twin
from ..rig import Input, Parameter, parsed_unit
from ..simulation import Stepper

# The variables of an FMU of a twin, which are the same for FMI 2 and FMI 3.

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


# The units of the twin's own variables, by those of the SI.
UNITS = {
    "s": {"s": "1"},
    "1/s": {"s": "-1"},
    "degC": {"K": "1", "offset": str(ZERO_CELSIUS)},
    "K/s": {"K": "1", "s": "-1"},
}

# The dimensions of a unit of a rig file -> their units in FMI.
BASES = {
    "[mass]": "kg",
    "[length]": "m",
    "[time]": "s",
    "[current]": "A",
    "[temperature]": "K",
    "[substance]": "mol",
    "[luminosity]": "cd",
}


def model_description(
    variables: Sequence[Variable],
    *,
    version: str,
    title: str,
    identifier: str,
    token: str,
    step_size: float,
    generator: str,
    sources: Sequence[str],
    about: str = "A twin of a thermoelectric rig",
    has_model_exchange: bool = True,
) -> bytes:
    """The description of a model for co-simulation, and for model exchange.

    **Arguments:**

    - `version`: the version of FMI, "2.0" or "3.0".
    - `title`, `generator`: the title of the model, and the name of the program that made it.
    - `identifier`: the name of the binary.
    - `token`: the text that shows that binary and description belong together.
    - `step_size`: the step of the twin, s.
    - `sources`: the files to compile.
    - `about`: what it is. `has_model_exchange`: whether a solver from outside can integrate it.
    """
    is_2 = version == "2.0"
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": title,
            "guid" if is_2 else "instantiationToken": token,
            "description": about,
            "generationTool": generator,
            "variableNamingConvention": "flat",
        },
    )
    if is_2:
        root.set("numberOfEventIndicators", "0")
    common = {
        "modelIdentifier": identifier,
        "canGetAndSetFMUstate" if is_2 else "canGetAndSetFMUState": "true",
        "canSerializeFMUstate" if is_2 else "canSerializeFMUState": "true",
    }
    of_kind = {
        "ModelExchange": common,
        "CoSimulation": {**common, "canHandleVariableCommunicationStepSize": "true"},
    }
    if not has_model_exchange:
        del of_kind["ModelExchange"]
    for kind, attributes in of_kind.items():
        interface = ET.SubElement(root, kind, attributes)
        if is_2:
            files = ET.SubElement(interface, "SourceFiles")
            for name in sources:
                ET.SubElement(files, "File", {"name": name})
    units = ET.SubElement(root, "UnitDefinitions")
    for name, base in UNITS.items():
        ET.SubElement(ET.SubElement(units, "Unit", {"name": name}), "BaseUnit", base)
    for name in dict.fromkeys(v.unit for v in variables if v.unit and v.unit not in UNITS):
        ET.SubElement(ET.SubElement(units, "Unit", {"name": name}), "BaseUnit", _base_unit(name))
    _add_choices(root, variables, is_2=is_2)
    ET.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(step_size)})
    listed = ET.SubElement(root, "ModelVariables")
    for variable in variables:
        if is_2:
            _scalar_variable(listed, variable)
        else:
            _variable(listed, variable)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [variable.reference for variable in variables if variable.causality == "output"]
    slopes = [variable.reference for variable in variables if variable.state is not None]
    groups = {"Outputs": outputs, "Derivatives": slopes, "InitialUnknowns": outputs + slopes}
    if is_2:
        for kind, references in groups.items():
            if not references:
                continue  # the standard allows no empty group
            group = ET.SubElement(structure, kind)
            for reference in references:
                ET.SubElement(group, "Unknown", {"index": str(reference + 1)})
    else:
        names = ("Output", "ContinuousStateDerivative", "InitialUnknown")
        for kind, references in zip(names, groups.values(), strict=True):
            for reference in references:
                ET.SubElement(structure, kind, {"valueReference": str(reference)})
    return _text(root)


def _base_unit(name: str) -> dict[str, str]:
    """A unit of a rig file by those of the SI."""
    scale, offset, dimensions = parsed_unit(name)
    result = {base: str(int(dimensions.get(key, 0))) for key, base in BASES.items()}
    result = {base: power for base, power in result.items() if power != "0"}
    result |= {} if scale == 1 else {"factor": repr(scale)}
    return result | ({} if offset == 0 else {"offset": repr(offset)})


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """The build description of the sources, which FMI 3 requires."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": identifier})
    group = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in sources:
        ET.SubElement(group, "SourceFile", {"name": name})
    return _text(root)


def _attributes(variable: Variable) -> dict[str, str]:
    """The attributes that a variable has in both versions."""
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": "discrete" if variable.is_discrete else "continuous",
        "description": variable.description,
    }
    if variable.causality == "parameter":
        attributes["variability"] = "fixed"
    if variable.causality == "local" and variable.state is None:
        attributes["initial"] = "exact"
    return attributes


def _add_choices(root: ET.Element, variables: Sequence[Variable], *, is_2: bool) -> None:
    """The types of the inputs that have states."""
    chosen = [variable for variable in variables if variable.choices]
    if not chosen:
        return
    types = ET.SubElement(root, "TypeDefinitions")
    for variable in chosen:
        name = {"name": _type_name(variable)}
        if is_2:
            parent = ET.SubElement(ET.SubElement(types, "SimpleType", name), "Enumeration")
        else:
            parent = ET.SubElement(types, "EnumerationType", name)
        for number, state in enumerate(variable.choices):
            ET.SubElement(parent, "Item", {"name": state, "value": str(number)})


def _type_name(variable: Variable) -> str:
    """FMI 2 wants a name that no variable has."""
    return f"{variable.name}.states"


def _scalar_variable(listed: ET.Element, variable: Variable) -> None:
    row = ET.SubElement(listed, "ScalarVariable", _attributes(variable))
    numbers = _numbers(variable)
    if variable.state is not None:
        numbers["derivative"] = str(variable.state + 1)
    ET.SubElement(row, "Enumeration" if variable.choices else "Real", numbers)


def _variable(listed: ET.Element, variable: Variable) -> None:
    attributes = _attributes(variable)
    if variable.state is not None:
        attributes["derivative"] = str(variable.state)
    kind = "Enumeration" if variable.choices else "Float64"
    ET.SubElement(listed, kind, attributes | _numbers(variable))


def _numbers(variable: Variable) -> dict[str, str]:
    if variable.choices:
        return {"declaredType": _type_name(variable), "start": f"{variable.start:g}"}
    result = {"unit": variable.unit} if variable.unit else {}
    ends = zip(("min", "max"), variable.limits or (), strict=False)
    result |= {key: repr(limit) for key, limit in ends if math.isfinite(limit)}
    return result if variable.start is None else result | {"start": repr(variable.start)}


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)
