"""A controller as C, which treats missing readings as the closed loop in Python does.

The controllers differ in their law, `_pid_c`, `_decoupled_pi_c`, `_lqi_c` and `_mpc_c`; the code
that they share is here. In `float` an integral is a compensated sum (Kahan 1965), because the
increment of a few millikelvins in a tenth of a second would be lost in rounding.
"""

import numpy as np

from .._errors import ControlError
from ..control import LQI, MPC, PID, DecoupledPI
from ..rig import Rig
from ._decoupled_pi_c import decoupled_pi_law
from ._law import Law
from ._lqi_c import lqi_law
from ._mpc_c import mpc_law
from ._pid_c import pid_law
from ._text import Code, comment_block, number, tables_c

SILENCE_S = 3.0
"""The time without a reading after which the cells are switched off, s, as in
`simulate_closed_loop`."""


def controller_c(
    controller: PID | DecoupledPI | LQI | MPC, rig: Rig, name: str, precision: str, origin: str
) -> Code:
    """Returns header and source.

    **Raises:** `ControlError` if the controller is not for the rig, or a number of it is not
    finite in this precision.
    """
    weights = controller.output_weights([channel.name for channel in rig.channels])
    cells, outputs = len(rig.cells), len(weights)
    is_free = isinstance(controller, LQI | MPC) or (outputs == 1 and isinstance(controller, PID))
    if outputs != cells and not is_free:
        raise ControlError(
            f"export_c: measured: expected an output for each of the {cells} cells of {rig.name}, "
            f"got {outputs}"
        )
    if isinstance(controller, PID):
        law = pid_law(controller, cells, outputs, name, precision)
    elif isinstance(controller, LQI):
        law = lqi_law(controller, cells, name, precision)
    elif isinstance(controller, MPC):
        law = mpc_law(controller, cells, name, precision)
    else:
        law = decoupled_pi_law(controller, name, precision)
    tables, coefficients = tables_c(law.tables, precision)
    fields = {**law.fields, "seen": outputs}
    if law.integrals:
        fields = {"integral": law.integrals, **fields}
        if precision == "float":
            fields["lost"] = law.integrals
    source = f"""#include <math.h>

#include "{name}.h"

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math takes NaN for a reading: compile without it"
#endif

{tables}{_functions(controller, law, name, precision)}"""
    header = _header(controller, rig, weights, law, fields, name, precision, origin)
    return Code(header, source, coefficients, sum(fields.values()) + 1)


def _header(
    controller: PID | DecoupledPI | LQI | MPC,
    rig: Rig,
    weights: np.ndarray,
    law: Law,
    fields: dict[str, int],
    name: str,
    real: str,
    origin: str,
) -> str:
    upper = name.upper()
    channels = np.array([channel.name for channel in rig.channels])
    lowest, highest = controller.limits
    about = comment_block(
        [
            f"{name}: {law.kind} for the rig {rig.name}, written by jaxtwin.",
            f"Parameters: {origin}" if origin else "Parameters of a jaxtwin.control controller:",
            *(f"  {line}" for line in law.parameter_lines),
            "",
            f"Sample time: {controller.sample_time_s!r} s. Numbers: {real}.",
            "References and measurements, degC, each the mean of these channels:",
            *(f"  {n}: {', '.join(channels[row > 0])}" for n, row in enumerate(weights)),
            f"Duty cycles from {lowest:g} to {highest:g}, positive heats, of the cells:",
            *(f"  {n}: {cell.name}" for n, cell in enumerate(rig.cells)),
            "",
            "A measurement that is no finite number leaves the last ones standing. After",
            f"{upper}_SILENCE_S without any, all duty cycles are 0 until {name}_init is called;",
            "they are at once where a reference or a duty is no finite number. missing_s is above",
            f"{upper}_SILENCE_S then. Whoever calls must switch off where calls stop (a watchdog).",
        ]
    )
    horizon = ahead = ""
    if law.horizon:
        horizon = f"#define {upper}_HORIZON {law.horizon}\n"
        arguments = [
            f"const {real} references[{upper}_HORIZON * {upper}_OUTPUTS]",
            f"const {real} measurement[{upper}_OUTPUTS]",
            f"{real} duty[{upper}_CELLS]",
        ]
        ahead = f"""
/* The same with the references of this sample and of the next ones, {upper}_OUTPUTS each. */
{_begin(f"void {name}_step_ahead", f"{name}_state *state", *arguments)};
"""
    struct = "".join(f"    {real} {field}[{size}];\n" for field, size in fields.items())
    return f"""{about}#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_SAMPLE_TIME_S {number(controller.sample_time_s, real)}
#ifndef {upper}_SILENCE_S
#define {upper}_SILENCE_S {number(SILENCE_S, real)}
#endif
#define {upper}_OUTPUTS {len(weights)}
#define {upper}_CELLS {len(rig.cells)}
{horizon}
typedef struct {{
{struct}    {real} missing_s; /* since the last measurement */
}} {name}_state;

/* Starts without a bump: with the reference at the measurement, the duty goes on where it is. */
void {name}_init({name}_state *state, const {real} duty[{upper}_CELLS],
                 const {real} measurement[{upper}_OUTPUTS]);

/* The duty cycles until the next sample. */
void {name}_step({name}_state *state, const {real} reference[{upper}_OUTPUTS],
                 const {real} measurement[{upper}_OUTPUTS], {real} duty[{upper}_CELLS]);
{ahead}
#ifdef __cplusplus
}}
#endif

#endif
"""


def _functions(controller: PID | DecoupledPI | LQI | MPC, law: Law, name: str, real: str) -> str:
    upper = name.upper()
    zero = number(0.0, real)
    lowest, highest = (number(limit, real) for limit in controller.limits)
    add = forget = ""
    if law.integrals and real == "float":
        add = """    const float rest = change - state->lost[i];
    const float sum = state->integral[i] + rest;
    state->lost[i] = (sum - state->integral[i]) - rest;
    state->integral[i] = sum;
"""
        forget = f"""    for (i = 0; i < {law.integrals}; ++i) {{
        state->lost[i] = 0.0f;
    }}
"""
    elif law.integrals:
        add = "    state->integral[i] += change;\n"
    if add:
        add = f"""static void {name}_integrate({name}_state *state, int i, {real} change)
{{
{add}}}

"""
    reading, cells = f"const {real} measurement[{upper}_OUTPUTS]", f"{real} duty[{upper}_CELLS]"
    state, now = f"{name}_state *state", f"const {real} reference[{upper}_OUTPUTS]"
    step, wanted, public = f"void {name}_step", now, ""
    samples, passed, many = [], "", ""
    if law.horizon:
        step, wanted = f"static void {name}_sample", f"const {real} *reference"
        samples, passed, many = ["int samples"], ", samples", "samples * "
        coming = f"const {real} references[{upper}_HORIZON * {upper}_OUTPUTS]"
        public = f"""
{_begin(f"void {name}_step", state, now, reading, cells)}
{{
    {name}_sample(state, reference, 1, measurement, duty);
}}

{_begin(f"void {name}_step_ahead", state, coming, reading, cells)}
{{
    {name}_sample(state, references, {upper}_HORIZON, measurement, duty);
}}
"""
    return f"""static int {name}_all_finite(const {real} *values, int count)
{{
    int i;
    for (i = 0; i < count; ++i) {{
        if (!isfinite(values[i])) {{
            return 0;
        }}
    }}
    return 1;
}}

static {real} {name}_limited({real} duty)
{{
    if (duty < {lowest}) {{
        return {lowest};
    }}
    return duty > {highest} ? {highest} : duty;
}}

{add}static void {name}_stop({name}_state *state)
{{
    state->missing_s = {upper}_SILENCE_S + {upper}_SAMPLE_TIME_S;
}}

{law.functions}{_begin(f"void {name}_init", state, f"const {cells}", reading)}
{{
    int i;
    for (i = 0; i < {upper}_OUTPUTS; ++i) {{
        state->seen[i] = measurement[i];
    }}
{law.init}{forget}    state->missing_s = {zero};
    if (!{name}_all_finite(duty, {upper}_CELLS)
        || !{name}_all_finite(measurement, {upper}_OUTPUTS)) {{
        {name}_stop(state);
    }}
}}

{_begin(f"static void {name}_law", state, wanted, *samples, cells)}
{{
{law.step}}}

{_begin(step, state, wanted, *samples, reading, cells)}
{{
    int i;
    if (state->missing_s <= {upper}_SILENCE_S) {{
        if ({name}_all_finite(measurement, {upper}_OUTPUTS)) {{
            for (i = 0; i < {upper}_OUTPUTS; ++i) {{
                state->seen[i] = measurement[i];
            }}
            state->missing_s = {zero};
        }} else {{
            state->missing_s += {upper}_SAMPLE_TIME_S;
        }}
    }}
    if (state->missing_s <= {upper}_SILENCE_S) {{
        {name}_law(state, reference{passed}, duty);
        if ({name}_all_finite(reference, {many}{upper}_OUTPUTS)
            && {name}_all_finite(duty, {upper}_CELLS)) {{
            return;
        }}
        {name}_stop(state);
    }}
    for (i = 0; i < {upper}_CELLS; ++i) {{
        duty[i] = {zero};
    }}
}}
{public}"""


def _begin(function: str, *arguments: str) -> str:
    """The type, the name and the arguments of a function."""
    return f"{function}(" + (",\n" + " " * (len(function) + 1)).join(arguments) + ")"
