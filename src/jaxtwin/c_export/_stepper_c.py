r"""A twin as C: the steps of `Stepper`, in the modes of the network, with nonlinear Peltier terms
and losses.

The decay of the modes in a step, $(e^{-\lambda h} - 1) z$, is computed and added: these factors
keep all digits of a `float` even if a slow mode decays by a thousandth.
"""

import numpy as np

from .._jax_settings import own_settings
from ..simulation import Stepper
from ..simulation._stepper import ZERO_CELSIUS
from ._stepper_functions_c import linear_forces_c, stepper_functions_c
from ._stepper_tables import StepperSizes, stepper_scalars, stepper_tables
from ._text import Code, comment_block, number, tables_c


def stepper_c(
    stepper: Stepper, name: str, precision: str, origin: str, *, with_slopes: bool = False
) -> Code:
    """Returns header and source.

    **Arguments:**

    - `with_slopes`: whether to write also a function for the derivatives of the nodes'
      temperatures, which an external solver needs.

    **Raises:** `ControlError` if a number of the twin is not finite in this precision.
    """
    with own_settings():
        sizes = StepperSizes(stepper)
        tables = stepper_tables(stepper, sizes, name)
        if with_slopes:
            rates = np.asarray(stepper.field.modes.rates, float)
            tables[f"{name}_rate"] = (rates, "by which the modes decay, 1/s")
        constants, coefficients = tables_c(tables, precision)
        scalars, count = stepper_scalars(stepper, name, precision)
        source = f'#include <math.h>\n\n#include "{name}.h"\n\n{scalars}\n{constants}'
        source += stepper_functions_c(sizes, name, precision)
        for function in (_init, _step, _output, _nodes):
            source += function(sizes, name, precision)
        states = sizes.modes + sizes.cells * (1 + sizes.queue)
        further = ""
        if with_slopes:
            source += _slopes(sizes, name, precision)
            further = _declared_slopes(name, precision)
        header = _header(stepper, sizes, name, precision, origin, further)
        return Code(header, source, coefficients + count, states)


def _header(
    stepper: Stepper, sizes: StepperSizes, name: str, real: str, origin: str, further: str
) -> str:
    """The header. `further` are declarations that follow those of every twin."""
    upper, wiring = name.upper(), stepper.system.wiring
    step = float(np.asarray(stepper.sizes).sum())
    room = float(stepper.reference) - ZERO_CELSIUS
    kept = f"{sizes.modes} modes"
    if sizes.modes < sizes.nodes:
        kept += f", of a network of {sizes.nodes} nodes reduced to them,"
    about = comment_block(
        [
            f"{name}: a twin of a thermoelectric rig, written by jaxtwin.",
            f"Parameters: {origin}" if origin else "Parameters: those of a jaxtwin.Twin",
            "",
            f"Sample time: {step!r} s. Numbers: {real}.",
            f"Its {kept} are exact; Peltier and Joule heat and losses are nonlinear.",
            "Duty cycles from -1 to 1, positive heats, of the cells:",
            *(f"  {n}: {cell.name}" for n, cell in enumerate(wiring.netlist.cells)),
            "Readings, degC, of the channels:",
            *(f"  {n}: {channel}" for n, channel in enumerate(wiring.channels)),
            "Nodes, degC:",
            *(f"  {n}: {node.name}" for n, node in enumerate(wiring.netlist.nodes)),
        ]
    )
    fields = f"    {real} z[{upper}_MODES]; /* amplitudes of the modes */\n"
    fields += f"    {real} duty[{upper}_CELLS]; /* that reaches the cells */\n"
    if sizes.queue:
        fields += f"    {real} late[{sizes.queue}][{upper}_CELLS]; /* commands on their way */\n"
    return f"""{about}#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_SAMPLE_TIME_S {step!r}
#define {upper}_AMBIENT {number(room, real)} /* of the rig, degC */
#define {upper}_CELLS {sizes.cells}
#define {upper}_CHANNELS {sizes.channels}
#define {upper}_NODES {sizes.nodes}
#define {upper}_MODES {sizes.modes}

typedef struct {{
{fields}}} {name}_state;

/* From temperatures of the nodes, degC, and duty cycles that have been commanded for long. */
void {name}_init({name}_state *state, const {real} nodes[{upper}_NODES],
                 const {real} duty[{upper}_CELLS]);

/* A sample time later, under duty cycles held until then; the ambient in degC. */
void {name}_step({name}_state *state, const {real} duty[{upper}_CELLS], {real} ambient);

/* What the channels read now, degC. */
void {name}_output(const {name}_state *state, {real} ambient,
                   {real} temperatures[{upper}_CHANNELS]);

/* The temperatures of the nodes now, degC: a sensor where there is none. */
void {name}_nodes(const {name}_state *state, {real} nodes[{upper}_NODES]);

{further}#ifdef __cplusplus
}}
#endif

#endif
"""


def _init(sizes: StepperSizes, name: str, real: str) -> str:
    n, cells, zero, celsius = sizes.modes, sizes.cells, number(0.0, real), _celsius(real)
    begin, fill = f"void {name}_init(", ""
    if sizes.queue:
        fill = f"""        for (m = 0; m < {sizes.queue}; ++m) {{
            state->late[m][i] = duty[i];
        }}
"""
    return f"""{begin}{name}_state *state, const {real} nodes[{sizes.nodes}],
{" " * len(begin)}const {real} duty[{cells}])
{{
    int i, m;
    for (m = 0; m < {n}; ++m) {{
        state->z[m] = {zero};
        for (i = 0; i < {sizes.nodes}; ++i) {{
            const {real} rise = nodes[i] + {celsius} - {name}_T0;
            state->z[m] += {name}_shape[i][m] * {name}_capacitance[i] * rise;
        }}
    }}
    for (i = 0; i < {cells}; ++i) {{
        state->duty[i] = duty[i];
{fill}    }}
}}

"""


def _step(sizes: StepperSizes, name: str, real: str) -> str:
    cells = sizes.cells
    # The commands in the delay, the newest first: late[0] was given a step ago.
    in_transit = ["duty", *(f"state->late[{k}]" for k in range(sizes.queue))]
    delayed = in_transit[-sizes.parts :][::-1]
    now = "state->duty" if sizes.has_lag else delayed[0]
    forces, declared, given = _forces(sizes, name, real, now)
    calls = "".join(
        f"    {name}_part(state, {part}, {command}, {given});\n"
        for part, command in enumerate(delayed)
    )
    counters = "int i, m;" if sizes.queue else "int m;"
    return f"""void {name}_step({name}_state *state, const {real} duty[{cells}], {real} ambient)
{{
    const {real} deviation = ambient + {_celsius(real)} - {name}_T0;
    {declared}
    {counters}
{forces}{calls}{_shift(sizes)}}}

"""


def _forces(sizes: StepperSizes, name: str, real: str, duty: str) -> tuple[str, str, str]:
    """The C of the forces that all parts of a step share, its variables, and the variables that a
    part uses. Losses are computed at the start and in the middle of the step, and are interpolated
    linearly between, as in `Stepper`."""
    n = sizes.modes
    if not sizes.has_loss:
        return linear_forces_c(sizes, name), f"{real} first[{n}];", "first"
    forces = f"""    {name}_losses(state->z, deviation, first);
    {name}_force(state->z, {duty}, first, slope);
    for (m = 0; m < {n}; ++m) {{
        b[m] = state->z[m] + {name}_to_half_decay[m] * state->z[m] + {name}_to_half[m] * slope[m];
    }}
    {name}_losses(b, deviation, slope);
    for (m = 0; m < {n}; ++m) {{
        slope[m] -= first[m];
    }}
"""
    return forces, f"{real} first[{n}], slope[{n}], b[{n}];", "first, slope"


def _shift(sizes: StepperSizes) -> str:
    """The C that shifts the commands in the delay by a step; empty without a delay."""
    if not sizes.queue:
        return ""
    return f"""    for (m = {sizes.queue - 1}; m > 0; --m) {{
        for (i = 0; i < {sizes.cells}; ++i) {{
            state->late[m][i] = state->late[m - 1][i];
        }}
    }}
    for (i = 0; i < {sizes.cells}; ++i) {{
        state->late[0][i] = duty[i];
    }}
"""


def _output(sizes: StepperSizes, name: str, real: str) -> str:
    begin, celsius = f"void {name}_output(", _celsius(real)
    return f"""{begin}const {name}_state *state, {real} ambient,
{" " * len(begin)}{real} temperatures[{sizes.channels}])
{{
    const {real} deviation = ambient + {celsius} - {name}_T0;
    int i, m;
    for (i = 0; i < {sizes.channels}; ++i) {{
        {real} sum = {name}_by_ambient[i] * deviation;
        for (m = 0; m < {sizes.modes}; ++m) {{
            sum += {name}_by_modes[i][m] * state->z[m];
        }}
        temperatures[i] = sum + ({name}_T0 - {celsius});
    }}
}}

"""


def _nodes(sizes: StepperSizes, name: str, real: str) -> str:
    return f"""void {name}_nodes(const {name}_state *state, {real} nodes[{sizes.nodes}])
{{
    int i, m;
    for (i = 0; i < {sizes.nodes}; ++i) {{
        {real} sum = {number(0.0, real)};
        for (m = 0; m < {sizes.modes}; ++m) {{
            sum += {name}_shape[i][m] * state->z[m];
        }}
        nodes[i] = sum + ({name}_T0 - {_celsius(real)});
    }}
}}
"""


def _celsius(real: str) -> str:
    return number(ZERO_CELSIUS, real)


def _declared_slopes(name: str, real: str) -> str:
    upper = name.upper()
    return f"""/* How fast the temperatures of the nodes change, K/s; the duty is what reaches
   the cells, the ambient in degC. */
void {name}_slopes(const {real} nodes[{upper}_NODES], const {real} duty[{upper}_CELLS],
                   {real} ambient, {real} slopes[{upper}_NODES]);

"""


def _slopes(sizes: StepperSizes, name: str, real: str) -> str:
    n, zero, celsius = sizes.modes, number(0.0, real), _celsius(real)
    forces = f"    {name}_losses(state.z, deviation, first);\n"
    if not sizes.has_loss:
        forces = linear_forces_c(sizes, name)
    return f"""
void {name}_slopes(const {real} nodes[{sizes.nodes}], const {real} duty[{sizes.cells}],
                   {real} ambient, {real} slopes[{sizes.nodes}])
{{
    const {real} deviation = ambient + {celsius} - {name}_T0;
    {real} first[{n}], force[{n}];
    {name}_state state;
    int i, m;
    {name}_init(&state, nodes, duty);
{forces}    {name}_force(state.z, duty, first, force);
    for (m = 0; m < {n}; ++m) {{
        force[m] -= {name}_rate[m] * state.z[m];
    }}
    for (i = 0; i < {sizes.nodes}; ++i) {{
        slopes[i] = {zero};
        for (m = 0; m < {n}; ++m) {{
            slopes[i] += {name}_shape[i][m] * force[m];
        }}
    }}
}}
"""
