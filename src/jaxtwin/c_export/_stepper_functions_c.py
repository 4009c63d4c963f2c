"""The static C functions of a twin: heat of the cells, forces on the modes, losses of the plate,
and a part of a step."""

from ..physics._heat_loss import CALM
from ..rig._plate import FILM_REFERENCE
from ._stepper_tables import StepperSizes
from ._text import number


def stepper_functions_c(sizes: StepperSizes, name: str, real: str) -> str:
    """All functions, each after those that it calls."""
    return "".join(
        [
            _heat(sizes, name, real),
            _force(sizes, name, real),
            _losses(sizes, name, real) if sizes.has_loss else "",
            _part(sizes, name, real),
        ]
    )


def _heat(sizes: StepperSizes, name: str, real: str) -> str:
    """The heat flows of a cell, as `Bridge.heat` has them."""
    zero, half, one = (number(value, real) for value in (0.0, 0.5, 1.0))
    suffix = "f" if real == "float" else ""

    def limited(current: str) -> str:
        if not sizes.is_limited:
            return current
        return f"fmin{suffix}(fmax{suffix}({current}, -{name}_Imax), {name}_Imax)"

    if sizes.averaging == "voltage":
        current = f"""    const {real} drive = -duty * {name}_Vs;
    const {real} current = {limited(f"(drive - emf) / (loop + share * {name}_Rs)")};
    const {real} square = current * current;
"""
    else:
        is_braked = sizes.off_phase == "brake"
        off = "-emf / loop" if is_braked else zero
        off_square = f" + ({one} - share) * off * off" if is_braked else ""
        current = f"""    const {real} cools = duty < {zero} ? {name}_Vs : {zero};
    const {real} drive = duty > {zero} ? -{name}_Vs : cools;
    const {real} on = {limited(f"(drive - emf) / (loop + {name}_Rs)")}, off = {off};
    const {real} current = share * on + ({one} - share) * off;
    const {real} square = share * on * on{off_square};
"""
    return f"""/* Peltier and Joule heat of a cell into its two sides, W; temperatures in K. */
static void {name}_heat(int cell, {real} duty, {real} cold, {real} hot, {real} flow[2])
{{
    const {real} loop = {name}_R[cell] + {name}_Ron;
    const {real} emf = {name}_alpha[cell] * (hot - cold), share = fabs{suffix}(duty);
{current}    const {real} peltier = {name}_alpha[cell] * current;
    const {real} joule = {half} * {name}_R[cell] * square;
    flow[0] = joule - peltier * cold;
    flow[1] = joule + peltier * hot;
}}

"""


def _force(sizes: StepperSizes, name: str, real: str) -> str:
    zero, sides = number(0.0, real), 2 * sizes.cells
    rows = ", ".join(str(side) for side in sizes.sides)
    return f"""static const int {name}_side[{sides}] = {{{rows}}};

/* What drives the modes beside their own decay. */
static void {name}_force(const {real} z[{sizes.modes}], const {real} duty[{sizes.cells}],
                         const {real} steady[{sizes.modes}], {real} force[{sizes.modes}])
{{
    {real} at[{sides}], flow[{sides}], both[2];
    int i, j, m;
    for (i = 0; i < {sides}; ++i) {{
        at[i] = {zero};
        for (m = 0; m < {sizes.modes}; ++m) {{
            at[i] += {name}_shape[{name}_side[i]][m] * z[m];
        }}
    }}
    for (i = 0; i < {sizes.cells}; ++i) {{
        {name}_heat(i, duty[i], {name}_T0 + at[i], {name}_T0 + at[{sizes.cells} + i], both);
        flow[i] = both[0];
        flow[{sizes.cells} + i] = both[1];
    }}
    for (i = 0; i < {sides}; ++i) {{
        for (j = 0; j < {sides}; ++j) {{
            flow[i] += {name}_linearised_conductance[i][j] * at[j];
        }}
    }}
    for (m = 0; m < {sizes.modes}; ++m) {{
        force[m] = steady[m];
        for (i = 0; i < {sides}; ++i) {{
            force[m] += {name}_shape[{name}_side[i]][m] * flow[i];
        }}
    }}
}}

"""


def _losses(sizes: StepperSizes, name: str, real: str) -> str:
    suffix = "f" if real == "float" else ""
    zero, one = number(0.0, real), number(1.0, real)
    calm = number(CALM**2, real)
    scale = number(1 / (FILM_REFERENCE**2 + CALM**2), real)
    return f"""/* Forces by the ambient and by what the plate loses beyond its linear losses. */
static void {name}_losses(const {real} z[{sizes.modes}], {real} ambient,
                          {real} force[{sizes.modes}])
{{
    const {real} room = {name}_T0 + ambient;
    int i, m;
    for (m = 0; m < {sizes.modes}; ++m) {{
        force[m] = {name}_surroundings[m] * ambient{_reservoir_term(sizes, name)};
    }}
    for (i = 0; i < {sizes.elements}; ++i) {{
        {real} at = {zero}, rise, hot, film, left;
        for (m = 0; m < {sizes.modes}; ++m) {{
            at += {name}_shape[i][m] * z[m];
        }}
        rise = at - ambient;
        hot = room + rise;
        film = exp{suffix}({name}_half_exponent * log{suffix}((rise * rise + {calm}) * {scale}));
        left = {name}_linearised_loss[i] * at - {name}_film[i] * (film - {one}) * rise;
        left -= {name}_radiating[i] * rise * (hot + room) * (hot * hot + room * room);
        for (m = 0; m < {sizes.modes}; ++m) {{
            force[m] += {name}_shape[i][m] * left;
        }}
    }}
}}

"""


def linear_forces_c(sizes: StepperSizes, name: str) -> str:
    """The C that computes the forces of the ambient temperature if all losses are linear."""
    return f"""    for (m = 0; m < {sizes.modes}; ++m) {{
        first[m] = {name}_surroundings[m] * deviation{_reservoir_term(sizes, name)};
    }}
"""


def _reservoir_term(sizes: StepperSizes, name: str) -> str:
    """The C that adds the forces of reservoirs; empty without any."""
    return f" + {name}_reservoirs[m]" if sizes.has_reservoirs else ""


def _part(sizes: StepperSizes, name: str, real: str) -> str:
    n, cells = sizes.modes, sizes.cells
    if sizes.has_loss:
        steady = [f"first[m] + {name}_at[part][{stage}] * slope[m]" for stage in range(3)]
        arguments = f"const {real} first[{n}],\n    const {real} slope[{n}]"
    else:
        steady = ["first[m]"] * 3
        arguments = f"const {real} first[{n}]"
    if sizes.has_lag:
        duty = f"""    for (i = 0; i < {cells}; ++i) {{
        const {real} away = state->duty[i] - command[i];
        u[i] = command[i] + away * {name}_lag[part][0];
        end[i] = command[i] + away * {name}_lag[part][1];
    }}
"""
        start, middle, end = "state->duty", "u", "end"
        after = f"""    for (i = 0; i < {cells}; ++i) {{
        state->duty[i] = end[i];
    }}
"""
        declared = f"    {real} u[{cells}], end[{cells}];\n    int i, m;\n"
    else:
        duty = ""
        start = middle = end = "command"
        after = f"""    for (i = 0; i < {cells}; ++i) {{
        state->duty[i] = command[i];
    }}
"""
        declared = "    int i, m;\n"

    def each(*lines: str) -> str:
        body = "".join(f"        {line}\n" for line in lines)
        return f"    for (m = 0; m < {n}; ++m) {{\n{body}    }}\n"

    key, z = f"{name}_", "state->z[m]"
    after_half = f"b[m] = {z} + {key}half_decay[part][m] * {z};"
    lines = [
        each(f"p[m] = {steady[0]};"),
        f"    {key}force(state->z, {start}, p, f0);\n",
        each(f"p[m] = {steady[1]};", after_half, f"b[m] += {key}half[part][m] * f0[m];"),
        f"    {key}force(b, {middle}, p, fa);\n",
        each(
            after_half,
            f"b[m] += {key}half_start[part][m] * f0[m] + {key}half_middle[part][m] * fa[m];",
        ),
        f"    {key}force(b, {middle}, p, fb);\n",
        each(
            f"p[m] = {steady[2]};",
            f"b[m] = {z} + {key}decay[part][m] * {z};",
            f"b[m] += {key}whole_start[part][m] * f0[m] + {key}whole_middle[part][m] * fb[m];",
        ),
        f"    {key}force(b, {end}, p, fc);\n",
        each(
            f"{z} += {key}decay[part][m] * {z} + {key}first[part][m] * f0[m]",
            f"    + {key}middle[part][m] * (fa[m] + fb[m]) + {key}last[part][m] * fc[m];",
        ),
    ]
    return f"""/* A part of a step by ETDRK4-B (Krogstad, J. Comput. Phys. 203, 2005, eq. 51). */
static void {name}_part(
    {name}_state *state, int part, const {real} command[{cells}], {arguments})
{{
    {real} p[{n}], b[{n}], f0[{n}], fa[{n}], fb[{n}], fc[{n}];
{declared}{duty}{"".join(lines)}{after}}}

"""
