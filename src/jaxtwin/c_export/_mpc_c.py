"""The law of an `MPC` as C: its Kalman filter, its target at rest and its plan.

The quadratic programs are scaled to a Hessian of about 1, as in Python, but here the scaled numbers
are constants of the code. The change of the estimated states in a sample, $(A - I) x$, is computed
and added, because slow poles lie near 1.
"""

import numpy as np

from .._errors import ControlError
from ..control import MPC
from ._law import Law, parameter_text
from ._quadratic_program_c import quadratic_program_c, work_of
from ._text import number


def mpc_law(controller: MPC, cells: int, name: str, precision: str) -> Law:
    """Returns the law.

    **Raises:** `ControlError` if it was designed for another number of cells.
    """
    if len(controller.duty) != cells:
        raise ControlError(
            f"export_c: model: expected a controller of the rig's {cells} cells, got one of "
            f"{len(controller.duty)}"
        )
    kalman, horizon = controller.kalman, controller.horizon
    A, L = np.asarray(kalman.A, float), np.asarray(kalman.L, float)
    states, outputs = L.shape
    moves, watched = horizon * cells, len(controller.temperature_limits)
    limits = moves * (1 if controller.rate_limit is None else 2) + horizon * watched
    plain = {
        "A": (A - np.eye(states), "of the filter: what a sample adds by the states"),
        "B": (kalman.B, "and by the duty"),
        "C": (kalman.C, "its outputs, K"),
        "L": (L, "of its correction by a reading"),
        "by_duty": (kalman.by_duty, "states at rest by the duty"),
        "by_rest": (kalman.by_disturbance, "and by a disturbance, 1/K"),
        "duty": (controller.duty, "operating point, -1 to 1"),
        "at": (controller.outputs, "operating point, degC"),
        **_plan_tables(controller),
        **_target_tables(controller),
    }
    return Law(
        f"model predictive control of {outputs} outputs over {horizon} samples",
        _parameter_lines(controller),
        0,
        {"x": states, "moved": cells, "targets": moves, **work_of(moves, limits)},
        {f"{name}_{key}": (np.ravel(values), text) for key, (values, text) in plain.items()},
        _init(name, precision, states, outputs, cells),
        _step(controller, name, precision),
        _functions(controller, name, precision),
        horizon,
    )


def _parameter_lines(controller: MPC) -> list[str]:
    y, u, change = controller.deviations
    rate = controller.rate_limit
    lines = [
        parameter_text("accepted deviations of the outputs", y, "K"),
        parameter_text("accepted deviations of the duty", u, ""),
        parameter_text("accepted changes of the duty", change, ""),
        f"limit of the rate of the duty: {'none' if rate is None else f'{rate!r} 1/s'}",
    ]
    if controller.preview:
        lines.append("designed for the references of the whole horizon: see ..._step_ahead")
    for channel, lowest, highest in controller.temperature_limits:
        lines.append(f"soft limits of {channel}: {lowest!r} to {highest!r} degC")
    if controller.soft is not None:
        lines.append(parameter_text("accepted excess", controller.soft.excess, "K"))
    return lines


def _scale(hessian: np.ndarray) -> float:
    """The number by which a quadratic program is divided."""
    return float(np.max(np.abs(np.diag(hessian))))


def _plan_tables(controller: MPC) -> dict[str, tuple[np.ndarray, str]]:
    cost = controller.condensed
    hessian = np.asarray(cost.hessian, float)
    scale = _scale(hessian)
    cells = len(controller.duty)
    # The last duty enters only the gradient of the first sample.
    by_last = np.asarray(cost.by_last_duty, float)[:cells]
    tables = {
        "hessian": (hessian / scale, "of the plan's cost by the moves"),
        "by_states": (np.asarray(cost.by_states, float) / scale, "its slope by the states"),
        "by_last": (by_last / scale, "by the last duty, of the first sample"),
        "by_target": (np.asarray(cost.by_target, float) / scale, "and by the duty at rest"),
    }
    soft = controller.soft
    if soft is not None:
        watched = len(soft.rest_gain)
        tables |= {
            "soft_by_states": (np.asarray(soft.by_states), "limited temperatures, K"),
            "soft_by_moves": (np.asarray(soft.by_moves), "and by the moves, K"),
            "lowest": (np.asarray(soft.lowest)[:watched], "their limits, K"),
            "highest": (np.asarray(soft.highest)[:watched], "their limits, K"),
        }
    return tables


def _target_tables(controller: MPC) -> dict[str, tuple[np.ndarray, str]]:
    hessian, by_missing = _rest_cost(controller)
    scale = _scale(hessian)
    tables = {
        "rest_hessian": (hessian / scale, "of the cost of a duty at rest"),
        "by_missing": (by_missing / scale, "its slope by what is missing, 1/K"),
    }
    soft = controller.soft
    if soft is not None:
        by_disturbance = np.asarray(soft.rest_gain) @ np.asarray(controller.inverse)
        tables |= {
            "soft_at_rest": (np.asarray(soft.rest_gain), "limited temperatures at rest, K"),
            "soft_by_rest": (by_disturbance, "and by a disturbance"),
        }
    return tables


def _rest_cost(controller: MPC) -> tuple[np.ndarray, np.ndarray]:
    """The Hessian of the program of `MPC._target`, and the derivatives of its gradient with respect
    to the distance from the reference."""
    gain, inverse = np.asarray(controller.gain, float), np.asarray(controller.inverse, float)
    accepted = np.asarray(controller.deviations.output, float)
    scaled = gain / accepted[:, None]
    unseen = np.eye(gain.shape[1]) - inverse @ gain
    hessian = scaled.T @ scaled + np.sum(scaled**2) / len(gain) * unseen
    return hessian, -scaled.T / accepted


def _init(name: str, real: str, states: int, outputs: int, cells: int) -> str:
    return f"""    {{
        {real} y[{outputs}];
        for (i = 0; i < {cells}; ++i) {{
            state->moved[i] = duty[i] - {name}_duty[i];
        }}
        for (i = 0; i < {states}; ++i) {{
            state->x[i] = {number(0.0, real)};
        }}
        {name}_add(state->x, {name}_by_duty, state->moved, {states}, {cells});
        {name}_missed(state, measurement, y);
        {name}_add(state->x, {name}_by_rest, y, {states}, {outputs});
    }}
"""


def _step(controller: MPC, name: str, real: str) -> str:
    states, outputs = np.shape(controller.kalman.L)
    cells, horizon = len(controller.duty), controller.horizon
    upper = name.upper()
    rate_limit = ""
    if controller.rate_limit is not None:
        rate_limit = f"""        if (now < state->moved[i] - {upper}_REACH) {{
            now = state->moved[i] - {upper}_REACH;
        }}
        if (now > state->moved[i] + {upper}_REACH) {{
            now = state->moved[i] + {upper}_REACH;
        }}
"""
    return f"""    {real} y[{outputs}], change[{states}];
    int i, k;
    {name}_missed(state, state->seen, y);
    {name}_add(state->x, {name}_L, y, {states}, {outputs});
    for (k = 0; k < {horizon}; ++k) {{
        if (k < samples) {{
            {name}_target(state, reference + k * {outputs});
        }}
        for (i = 0; i < {cells}; ++i) {{
            state->targets[k * {cells} + i] = state->z[i];
        }}
    }}
    {name}_plan(state);
    for (i = 0; i < {cells}; ++i) {{
        {real} now = state->z[i];
{rate_limit}        duty[i] = {name}_limited(now + {name}_duty[i]);
        state->moved[i] = duty[i] - {name}_duty[i];
    }}
    for (i = 0; i < {states}; ++i) {{
        change[i] = {number(0.0, real)};
    }}
    {name}_add(change, {name}_A, state->x, {states}, {states});
    {name}_add(change, {name}_B, state->moved, {states}, {cells});
    for (i = 0; i < {states}; ++i) {{
        state->x[i] += change[i];
    }}
"""


def _functions(controller: MPC, name: str, real: str) -> str:
    states, outputs = np.shape(controller.kalman.L)
    cells, horizon = len(controller.duty), controller.horizon
    moves, watched = horizon * cells, len(controller.temperature_limits)
    rate, upper = controller.rate_limit, name.upper()
    zero = number(0.0, real)
    lowest, highest = (number(limit, real) for limit in controller.limits)
    has_rate = int(rate is not None)
    reach = ""
    if rate is not None:
        reach = number(rate * controller.sample_time_s, real)
        reach = f"#define {upper}_REACH {reach} /* of the duty in a sample */\n\n"

    def program(tables: tuple[str, str], scale: float, size: int, has_rate: int, soft: int) -> str:
        hessian, sums = (f"{name}_{table}" for table in tables)
        excess = 0.0 if controller.soft is None else float(controller.soft.excess)
        softness = number(excess**2 * scale, real)
        return f"{{{hessian}, {sums if soft else 0}, {softness}, {size}, {has_rate}, {soft}}}"

    of_target = program(
        ("rest_hessian", "soft_at_rest"), _scale(_rest_cost(controller)[0]), cells, 0, watched
    )
    of_plan = program(
        ("hessian", "soft_by_moves"),
        _scale(np.asarray(controller.condensed.hessian, float)),
        moves,
        has_rate,
        horizon * watched,
    )
    soft_targets = soft_plan = rates = ""
    if watched:

        def soft_limits(first: int, rows: int, by: str, vector: str, columns: int) -> str:
            return f"""    for (i = 0; i < {rows}; ++i) {{
        {real} coming = {zero};
        {name}_add(&coming, {name}_{by} + i * {columns}, {vector}, 1, {columns});
        state->lowest[{first} + i] = {name}_lowest[i % {watched}] - coming;
        state->highest[{first} + i] = {name}_highest[i % {watched}] - coming;
    }}
"""

        disturbance = f"state->x + {states - outputs}"
        soft_targets = soft_limits(cells, watched, "soft_by_rest", disturbance, outputs)
        soft_plan = soft_limits(
            moves * (1 + has_rate), horizon * watched, "soft_by_states", "state->x", states
        )
    if rate is not None:
        rates = f"""    for (i = 0; i < {moves}; ++i) {{
        const {real} last = i < {cells} ? state->moved[i] : {zero};
        state->lowest[{moves} + i] = last - {upper}_REACH;
        state->highest[{moves} + i] = last + {upper}_REACH;
    }}
"""
    return f"""{reach}{quadratic_program_c(name, real)}
/* Adds a matrix times a vector. */
static void {name}_add({real} *to, const {real} *matrix, const {real} *vector, int rows,
{" " * len(f"static void {name}_add(")}int columns)
{{
    int i, j;
    for (i = 0; i < rows; ++i) {{
        for (j = 0; j < columns; ++j) {{
            to[i] += *matrix++ * vector[j];
        }}
    }}
}}

/* What the estimated states miss of a reading, K. */
static void {name}_missed(const {name}_state *state, const {real} *reading, {real} *missed)
{{
    int i;
    for (i = 0; i < {outputs}; ++i) {{
        {real} expected = {zero};
        {name}_add(&expected, {name}_C + i * {states}, state->x, 1, {states});
        missed[i] = reading[i] - {name}_at[i] - expected;
    }}
}}

static void {name}_box({name}_state *state, int size)
{{
    int i;
    for (i = 0; i < size; ++i) {{
        state->slope[i] = {zero};
        state->lowest[i] = {lowest} - {name}_duty[i % {cells}];
        state->highest[i] = {highest} - {name}_duty[i % {cells}];
    }}
}}

/* The duty at rest that comes nearest to a reference. */
static void {name}_target({name}_state *state, const {real} *reference)
{{
    static const {name}_program program = {of_target};
    {real} missing[{outputs}];
    int i;
    for (i = 0; i < {outputs}; ++i) {{
        missing[i] = reference[i] - {name}_at[i] - state->x[{states - outputs} + i];
    }}
    {name}_box(state, {cells});
{soft_targets}    {name}_add(state->slope, {name}_by_missing, missing, {cells}, {outputs});
    {name}_minimise(state, &program);
}}

/* The duty of the next samples. */
static void {name}_plan({name}_state *state)
{{
    static const {name}_program program = {of_plan};
{"    int i;" + chr(10) if watched or rate is not None else ""}    {name}_box(state, {moves});
{rates}{soft_plan}    {name}_add(state->slope, {name}_by_states, state->x, {moves}, {states});
    {name}_add(state->slope, {name}_by_last, state->moved, {cells}, {cells});
    {name}_add(state->slope, {name}_by_target, state->targets, {moves}, {moves});
    {name}_minimise(state, &program);
}}

"""
