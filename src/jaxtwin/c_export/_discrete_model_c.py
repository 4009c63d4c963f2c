r"""A linear model at sample times as C.

The states that are commands in a delay are shifted, not multiplied. For the others the change
$(A - I) x + B u$ is computed and added: the entries of $A - I$ keep all digits of a `float` even if
a slow pole lies at 0.999.
"""

import numpy as np
from jaxtyping import Float

from ..control import DiscreteModel
from ._text import Code, comment_block, tables_c


def discrete_model_c(model: DiscreteModel, name: str, precision: str, origin: str) -> Code:
    """Returns header and source.

    **Raises:** `ControlError` if a number of the model is not finite in this precision.
    """
    A, B, C, D = (np.asarray(m, float) for m in (model.A, model.B, model.C, model.D))
    states, inputs = B.shape
    moved = _moved_commands(A, B)
    own = states - moved
    tables = {
        f"{name}_A": (A[:own] - np.eye(states)[:own], "what a step adds by the state, A - I"),
        f"{name}_B": (B[:own], "and by the duty, K per unit"),
        f"{name}_C": (C, "temperatures by the state, K per unit"),
        f"{name}_D": (D, "and by the duty, K per unit"),
        f"{name}_duty": (np.asarray(model.operating_point.duty, float), "operating point, -1 to 1"),
        f"{name}_at": (np.asarray(model.operating_point.outputs, float), "operating point, degC"),
    }
    if not D.any():
        del tables[f"{name}_D"]
    constants, coefficients = tables_c(tables, precision)
    source = "".join(
        [
            f'#include "{name}.h"\n\n',
            constants,
            _functions(name, precision, states, own, inputs, len(C), has_direct=bool(D.any())),
        ]
    )
    return Code(_header(model, name, precision, origin, states), source, coefficients, states)


def _moved_commands(A: Float[np.ndarray, "n n"], B: Float[np.ndarray, "n inputs"]) -> int:
    """The number of states that are commands in a delay; they are the last ones."""
    states, inputs = B.shape
    shifts = 0
    while (shifts + 1) * inputs < states:
        first = states - (shifts + 1) * inputs
        rows = np.hstack([A[first:], B[first:]])
        expected = np.zeros_like(rows)
        expected[:inputs, states:] = np.eye(inputs)
        later = np.arange(inputs, len(rows))
        expected[later, first + later - inputs] = 1.0
        if np.array_equal(rows, expected):
            return (shifts + 1) * inputs
        shifts += 1
    return 0


def _header(model: DiscreteModel, name: str, precision: str, origin: str, states: int) -> str:
    upper = name.upper()
    duty = np.asarray(model.operating_point.duty, float)
    readings = np.asarray(model.operating_point.outputs, float)
    about = comment_block(
        [
            f"{name}: a linear model of a thermoelectric rig, written by jaxtwin.",
            f"Coefficients: {origin}" if origin else "Coefficients: a jaxtwin.DiscreteModel",
            "",
            f"Sample time: {model.sample_time_s!r} s. Numbers: {precision}.",
            "Inputs, duty cycles from -1 to 1, positive heats (at the operating point):",
            *(f"  {n}: {u} ({duty[n]:g})" for n, u in enumerate(model.input_names)),
            "Outputs, degC (at the operating point):",
            *(f"  {n}: {y} ({readings[n]:.2f})" for n, y in enumerate(model.output_names)),
            "States, as deviations from the operating point:",
            *(f"  {n}: {x}" for n, x in enumerate(model.state_names)),
        ]
    )
    return f"""{about}#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_SAMPLE_TIME_S {model.sample_time_s!r}
#define {upper}_STATES {states}
#define {upper}_INPUTS {len(model.input_names)}
#define {upper}_OUTPUTS {len(model.output_names)}

typedef struct {{
    {precision} x[{upper}_STATES];
}} {name}_state;

/* At rest at the operating point. */
void {name}_init({name}_state *state);

/* A sample time later, under duty cycles held until then. */
void {name}_step({name}_state *state, const {precision} duty[{upper}_INPUTS]);

/* What the channels read now, degC. */
void {name}_output(const {name}_state *state, const {precision} duty[{upper}_INPUTS],
                   {precision} temperatures[{upper}_OUTPUTS]);

#ifdef __cplusplus
}}
#endif

#endif
"""


def _functions(
    name: str, real: str, states: int, own: int, inputs: int, outputs: int, *, has_direct: bool
) -> str:
    zero = "0.0f" if real == "float" else "0.0"
    move = ""
    if states - own > inputs:
        move += f"""    for (i = {states - 1}; i >= {own + inputs}; --i) {{
        state->x[i] = state->x[i - {inputs}];
    }}
"""
    if states > own:
        move += f"""    for (i = 0; i < {inputs}; ++i) {{
        state->x[{own} + i] = u[i];
    }}
"""
    if has_direct:
        direct = f"""        for (j = 0; j < {inputs}; ++j) {{
            sum += {name}_D[i][j] * (duty[j] - {name}_duty[j]);
        }}
"""
        unused = ""
    else:
        direct, unused = "", "    (void)duty;\n"
    return f"""void {name}_init({name}_state *state)
{{
    int i;
    for (i = 0; i < {states}; ++i) {{
        state->x[i] = {zero};
    }}
}}

void {name}_step({name}_state *state, const {real} duty[{inputs}])
{{
    {real} u[{inputs}];
    {real} change[{own}];
    int i, j;
    for (i = 0; i < {inputs}; ++i) {{
        u[i] = duty[i] - {name}_duty[i];
    }}
    for (i = 0; i < {own}; ++i) {{
        {real} sum = {zero};
        for (j = 0; j < {states}; ++j) {{
            sum += {name}_A[i][j] * state->x[j];
        }}
        for (j = 0; j < {inputs}; ++j) {{
            sum += {name}_B[i][j] * u[j];
        }}
        change[i] = sum;
    }}
    for (i = 0; i < {own}; ++i) {{
        state->x[i] += change[i];
    }}
{move}}}

void {name}_output(const {name}_state *state, const {real} duty[{inputs}],
                   {real} temperatures[{outputs}])
{{
    int i, j;
{unused}    for (i = 0; i < {outputs}; ++i) {{
        {real} sum = {name}_at[i];
        for (j = 0; j < {states}; ++j) {{
            sum += {name}_C[i][j] * state->x[j];
        }}
{direct}        temperatures[i] = sum;
    }}
}}
"""
