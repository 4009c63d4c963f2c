"""The quadratic programs of `control._quadratic_program` in C, solved by the same algorithm.

The limits are those of a plan: limits of each unknown and of its change from one sample to the
next, and soft limits of sums of unknowns.
"""

from ..control._quadratic_program import CENTERING, STEPS, TO_BOUNDARY
from ._text import number

LARGEST_GAP = {"double": 1e-4 * 2.0**-26, "float": 1e-4 * 2.0**-11.5}
"""The mean product of slack and multiplier below which no further step is taken; as in Python."""


def work_of(unknowns: int, limits: int) -> dict[str, int]:
    """Returns the memory of a program, field -> length.

    **Arguments:**

    - `unknowns`: the number of unknowns of the largest program.
    - `limits`: the number of its limits; a limit on both sides counts once.
    """
    return {
        "slope": unknowns,
        "z": unknowns,
        "dz": unknowns,
        "factor": unknowns * (unknowns + 1) // 2,
        "lowest": limits,
        "highest": limits,
        "value": limits,
        "weight": limits,
        "slack": 2 * limits,
        "multiplier": 2 * limits,
        "dslack": 2 * limits,
        "dmultiplier": 2 * limits,
    }


def quadratic_program_c(name: str, real: str) -> str:
    """The struct `name_program`, and the function `name_minimise`, which writes the minimum to
    `state->z`."""
    zero, one, half = (number(value, real) for value in (0.0, 1.0, 0.5))
    root = "sqrtf" if real == "float" else "sqrt"
    return f"""/* A cost z'Hz / 2 + slope'z, with limits of z, with a rate also of its change from
   sample to sample, and then soft ones of sums: lowest <= value <= highest. */
typedef struct {{
    const {real} *hessian;
    const {real} *sums;
    {real} softness;
    int size;
    int has_rate;
    int soft;
}} {name}_program;

static int {name}_limits(const {name}_program *program)
{{
    return program->size * (1 + program->has_rate) + program->soft;
}}

static {real} {name}_softness(const {name}_program *program, int i)
{{
    return i < {name}_limits(program) - program->soft ? {zero} : program->softness;
}}

/* What is limited. */
static void {name}_values(const {name}_program *program, const {real} *z, {real} *value)
{{
    const {real} *sum = program->sums;
    int i, j, row = program->size;
    for (i = 0; i < program->size; ++i) {{
        value[i] = z[i];
    }}
    for (i = 0; program->has_rate && i < program->size; ++i) {{
        value[row++] = i < {name.upper()}_CELLS ? z[i] : z[i] - z[i - {name.upper()}_CELLS];
    }}
    for (i = 0; i < program->soft; ++i, ++row) {{
        value[row] = {zero};
        for (j = 0; j < program->size; ++j) {{
            value[row] += *sum++ * z[j];
        }}
    }}
}}

/* Subtracts what is limited, transposed. */
static void {name}_pull(const {name}_program *program, const {real} *force, {real} *z)
{{
    const {real} *sum = program->sums;
    int i, j, row = program->size;
    for (i = 0; i < program->size; ++i) {{
        z[i] -= force[i];
    }}
    for (i = 0; program->has_rate && i < program->size; ++i, ++row) {{
        z[i] -= force[row];
        if (i >= {name.upper()}_CELLS) {{
            z[i - {name.upper()}_CELLS] += force[row];
        }}
    }}
    for (i = 0; i < program->soft; ++i, ++row) {{
        for (j = 0; j < program->size; ++j) {{
            z[j] -= *sum++ * force[row];
        }}
    }}
}}

/* Row i of a lower triangle. */
static {real} *{name}_row({real} *triangle, int i)
{{
    return triangle + i * (i + 1) / 2;
}}

/* The matrix of a step: the Hessian, and the weights of the limits. */
static void {name}_assemble({name}_state *state, const {name}_program *program)
{{
    const {real} *sum = program->sums, *weight = state->weight + program->size;
    int i, j, k;
    for (i = 0; i < program->size; ++i) {{
        {real} *row = {name}_row(state->factor, i);
        for (j = 0; j <= i; ++j) {{
            row[j] = program->hessian[i * program->size + j];
        }}
        row[i] += state->weight[i];
    }}
    for (i = 0; program->has_rate && i < program->size; ++i, ++weight) {{
        {name}_row(state->factor, i)[i] += *weight;
        if (i >= {name.upper()}_CELLS) {{
            j = i - {name.upper()}_CELLS;
            {name}_row(state->factor, i)[j] -= *weight;
            {name}_row(state->factor, j)[j] += *weight;
        }}
    }}
    for (k = 0; k < program->soft; ++k, ++weight, sum += program->size) {{
        for (i = 0; i < program->size; ++i) {{
            {real} *row = {name}_row(state->factor, i);
            const {real} part = *weight * sum[i];
            for (j = 0; j <= i; ++j) {{
                row[j] += part * sum[j];
            }}
        }}
    }}
}}

/* Cholesky's factor in place of the matrix; 0 where rounding left none. */
static int {name}_factorise({real} *triangle, int size)
{{
    int i, j, k;
    for (i = 0; i < size; ++i) {{
        {real} *row = {name}_row(triangle, i);
        for (j = 0; j <= i; ++j) {{
            const {real} *other = {name}_row(triangle, j);
            {real} rest = row[j];
            for (k = 0; k < j; ++k) {{
                rest -= row[k] * other[k];
            }}
            if (j < i) {{
                row[j] = rest / other[j];
            }} else if (rest > {zero}) {{
                row[i] = {root}(rest);
            }} else {{
                return 0;
            }}
        }}
    }}
    return 1;
}}

static void {name}_solve({real} *triangle, {real} *x, int size)
{{
    int i, j;
    for (i = 0; i < size; ++i) {{
        const {real} *row = {name}_row(triangle, i);
        for (j = 0; j < i; ++j) {{
            x[i] -= row[j] * x[j];
        }}
        x[i] /= row[i];
    }}
    for (i = size - 1; i >= 0; --i) {{
        const {real} *row = {name}_row(triangle, i);
        x[i] /= row[i];
        for (j = 0; j < i; ++j) {{
            x[j] -= row[j] * x[i];
        }}
    }}
}}

static {real} {name}_gap(const {name}_state *state, int count)
{{
    {real} sum = {zero};
    int k;
    for (k = 0; k < count; ++k) {{
        sum += state->slack[k] * state->multiplier[k];
    }}
    return sum / ({real})count;
}}

/* The part of a step after which the first of these is nearly 0. */
static {real} {name}_reach(const {real} *of, const {real} *change, int count, {real} reach)
{{
    int k;
    for (k = 0; k < count; ++k) {{
        if (change[k] < {zero}) {{
            const {real} until = {number(TO_BOUNDARY, real)} * (-of[k] / change[k]);
            reach = until < reach ? until : reach;
        }}
    }}
    return reach;
}}

/* A step of Newton's method towards the central path; 0 where there is none. */
static int {name}_newton({name}_state *state, const {name}_program *program, int is_last)
{{
    const int size = program->size, limits = {name}_limits(program);
    const {real} gap = {name}_gap(state, 2 * limits);
    {real} length = {one};
    int i, j, k;
    {name}_values(program, state->z, state->value);
    for (i = 0; i < limits; ++i) {{
        const {real} softness = {name}_softness(program, i);
        state->weight[i] = {zero};
        for (k = i; k < 2 * limits; k += limits) {{
            const {real} slack = state->slack[k], multiplier = state->multiplier[k];
            const {real} aim = is_last ? slack * multiplier : {number(CENTERING, real)} * gap;
            const {real} stiffness = slack + multiplier * softness;
            const {real} room = k < limits ? state->highest[i] - state->value[i]
                                           : state->value[i] - state->lowest[i];
            state->weight[i] += multiplier / stiffness;
            state->dslack[k] = slack - room - softness * multiplier;
            state->dmultiplier[k] = multiplier * state->dslack[k] - (slack * multiplier - aim);
            state->dmultiplier[k] /= stiffness;
        }}
        k = i + limits;
        state->value[i] = state->multiplier[i] - state->multiplier[k];
        state->value[i] += state->dmultiplier[i] - state->dmultiplier[k];
    }}
    for (i = 0; i < size; ++i) {{
        state->dz[i] = -state->slope[i];
        for (j = 0; j < size; ++j) {{
            state->dz[i] -= program->hessian[i * size + j] * state->z[j];
        }}
    }}
    {name}_pull(program, state->value, state->dz);
    {name}_assemble(state, program);
    if (!{name}_factorise(state->factor, size)) {{
        return 0;
    }}
    {name}_solve(state->factor, state->dz, size);
    {name}_values(program, state->dz, state->value);
    for (k = 0; k < 2 * limits; ++k) {{
        const {real} moved = k < limits ? state->value[k] : -state->value[k - limits];
        const {real} softness = {name}_softness(program, k % limits);
        const {real} stiffness = state->slack[k] + state->multiplier[k] * softness;
        state->dmultiplier[k] += state->multiplier[k] / stiffness * moved;
        state->dslack[k] = softness * state->dmultiplier[k] - state->dslack[k] - moved;
    }}
    if (!is_last) {{
        length = {name}_reach(state->slack, state->dslack, 2 * limits, length);
        length = {name}_reach(state->multiplier, state->dmultiplier, 2 * limits, length);
    }}
    for (i = 0; i < size; ++i) {{
        state->z[i] += length * state->dz[i];
    }}
    for (k = 0; k < 2 * limits; ++k) {{
        state->slack[k] += length * state->dslack[k];
        state->multiplier[k] += length * state->dmultiplier[k];
    }}
    return 1;
}}

/* Leaves in z what minimises the cost, after at most {STEPS + 1} steps. */
static void {name}_minimise({name}_state *state, const {name}_program *program)
{{
    const int limits = {name}_limits(program);
    int i, steps, goes_on = 1;
    for (i = 0; i < program->size; ++i) {{
        state->z[i] = {zero};
    }}
    for (i = 0; i < limits; ++i) {{
        const {real} middle = {half} * (state->highest[i] - state->lowest[i]);
        state->slack[i] = state->highest[i] > middle ? state->highest[i] : middle;
        state->slack[i + limits] = -state->lowest[i] > middle ? -state->lowest[i] : middle;
        state->multiplier[i] = {one};
        state->multiplier[i + limits] = {one};
    }}
    for (steps = 0; goes_on && steps < {STEPS}; ++steps) {{
        if (!({name}_gap(state, 2 * limits) > {number(LARGEST_GAP[real], real)})) {{
            break;
        }}
        goes_on = {name}_newton(state, program, 0);
    }}
    if (goes_on) {{
        {name}_newton(state, program, 1);
    }}
}}
"""
