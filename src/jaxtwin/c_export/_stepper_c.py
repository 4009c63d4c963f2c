r"""A twin as C: the steps of `Stepper`, in the modes of the network, with the Peltier terms and the
losses as they are.

What the modes decay by in a step is computed and added, $(e^{-\lambda h} - 1) z$: these numbers
keep all digits of a `float` where a slow mode decays by a thousandth.
"""

import numpy as np

from .._errors import ControlError
from .._jax_settings import own_settings
from ..physics._loss import CALM, STEFAN_BOLTZMANN
from ..rig._plate import FILM_REFERENCE
from ..simulation import Stepper
from ..simulation._stepper import ZERO_CELSIUS
from ._text import Code, comment_block, number, tables_c


def stepper_c(
    stepper: Stepper, name: str, precision: str, origin: str, *, with_slopes: bool = False
) -> Code:
    """Header and source.

    **Arguments:**

    - `with_slopes`: whether a function for the slopes of the nodes' temperatures is written too,
      for a solver from outside.

    **Raises:** `ControlError` where a number of the twin is not finite in this precision.
    """
    with own_settings():
        sizes = _Sizes(stepper)
        tables = _tables(stepper, sizes, name)
        if with_slopes:
            rates = np.asarray(stepper.field.modes.rates, float)
            tables[f"{name}_rate"] = (rates, "by which the modes decay, 1/s")
        constants, coefficients = tables_c(tables, precision)
        scalars, count = _scalars(stepper, name, precision)
        source = f'#include <math.h>\n\n#include "{name}.h"\n\n{scalars}\n{constants}'
        source += _functions(sizes, name, precision)
        states = sizes.modes + sizes.cells * (1 + sizes.queue)
        further = ""
        if with_slopes:
            source += _slopes(sizes, name, precision)
            further = _declared_slopes(name, precision)
        header = _header(stepper, sizes, name, precision, origin, further)
        return Code(header, source, coefficients + count, states)


class _Sizes:
    """The sizes of all arrays, and the terms of the equations."""

    def __init__(self, stepper: Stepper):
        system = stepper.system
        self.nodes, self.modes = np.shape(stepper.field.modes.shapes)
        self.cells = len(system.wiring.cold)
        self.channels = len(system.wiring.channels)
        self.elements = system.wiring.elements
        self.parts = len(stepper.sizes)
        self.has_delay, self.has_lag = system.delay is not None, system.lag is not None
        self.has_loss = stepper.plate is not None
        self.has_reservoirs = system.reservoirs is not None
        self.averaging, self.off_phase = system.bridge.averaging, system.bridge.off_phase
        self.is_limited = system.bridge.current_limit is not None
        self.queue = int(stepper.delay_steps) + self.parts - 1 if self.has_delay else 0
        self.sides = [*system.wiring.cold.tolist(), *system.wiring.hot.tolist()]


def _tables(stepper: Stepper, sizes: _Sizes, name: str) -> dict[str, tuple[np.ndarray, str]]:
    system, field = stepper.system, stepper.field
    modes, shapes = field.modes, np.asarray(field.modes.shapes, float)
    gain = np.asarray(system.gain, float)
    weights = np.asarray(system.channel_weights, float)
    on_plate = np.broadcast_to(np.asarray(system.on_plate, float), gain.shape)
    module = system.module
    rates, h = np.asarray(modes.rates, float), np.asarray(stepper.sizes, float)
    factors = {
        "half": "by the force at the start, half a step",
        "half_start": "the second try",
        "half_middle": "and by the force in the middle",
        "whole_start": "by the force at the start, the whole step",
        "whole_middle": "and by that in the middle",
        "first": "by the force at the start, in the end",
        "middle": "those in the middle",
        "last": "and that at the end",
    }
    tables = {
        f"{name}_shape": (shapes, "temperatures of the nodes by the modes, K"),
        f"{name}_by_modes": (gain[:, None] * (weights @ shapes), "readings of the channels, K"),
        f"{name}_by_ambient": (1 - gain * on_plate, "and by the ambient"),
        f"{name}_capacitance": (np.asarray(modes.capacitance, float), "of the nodes, J/K"),
        f"{name}_surroundings": (np.asarray(field.surroundings, float), "forces by the ambient"),
        **(
            {}
            if field.reservoir_force is None
            else {
                f"{name}_reservoirs": (
                    np.asarray(field.reservoir_force, float),
                    "forces by coolant and the like",
                )
            }
        ),
        f"{name}_linearised_conductance": (
            np.asarray(modes.linearised_conductance, float),
            "heat flows out of the sides of the cells that are in the modes, W/K",
        ),
        f"{name}_alpha": (np.asarray(module.seebeck_coefficient, float), "Seebeck, V/K"),
        f"{name}_R": (np.asarray(module.electrical_resistance, float), "of the cells, ohm"),
        f"{name}_half_decay": (np.expm1(-rates * h[:, None] / 2), "less 1, of each part of a step"),
        f"{name}_decay": (np.expm1(-rates * h[:, None]), "less 1, of each part of a step"),
        **{
            f"{name}_{key}": (np.asarray(getattr(stepper.factors, key), float), text)
            for key, text in factors.items()
        },
    }
    if sizes.has_lag:
        lag = float(system.lag)  # pyright: ignore[reportArgumentType]
        tables[f"{name}_lag"] = (
            np.exp(-h[:, None] * np.array([0.5, 1.0]) / lag),
            "how much is left of a difference to the command in the middle and at the end",
        )
    if sizes.has_loss:
        loss = system.loss
        assert loss is not None
        begin = np.cumsum(h) - h
        stages = begin[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
        tables |= {
            f"{name}_at": (stages / h.sum() * 2, "start, middle and end of a part, in half steps"),
            f"{name}_to_half_decay": (np.asarray(stepper.half_decay, float) - 1, "to the middle"),
            f"{name}_to_half": (np.asarray(stepper.half, float), "and by the force"),
            f"{name}_film": (np.asarray(loss.film, float), "of the elements, W/K"),
            f"{name}_radiating": (
                STEFAN_BOLTZMANN * np.asarray(loss.radiating, float),
                "of the elements, W/K^4",
            ),
            f"{name}_linearised_loss": (
                np.asarray(modes.linearised_loss, float),
                "losses of the elements that are in the modes, W/K",
            ),
        }
    return {key: (np.asarray(value, float), text) for key, (value, text) in tables.items()}


def _scalars(stepper: Stepper, name: str, real: str) -> tuple[str, int]:
    bridge, loss = stepper.system.bridge, stepper.system.loss
    values = {
        "T0": (stepper.reference, "what deviations are counted from, K"),
        "Vs": (bridge.supply_voltage, "V"),
        "Rs": (bridge.supply_resistance, "of the supply, ohm"),
        "Ron": (bridge.on_resistance, "of the switches, ohm"),
    }
    if bridge.current_limit is not None:
        values["Imax"] = (bridge.current_limit, "through a connected cell, A")
    if stepper.plate is not None and loss is not None:
        values["half_exponent"] = (float(np.asarray(loss.exponent)) / 2, "of the film")
    lines = []
    for key, (value, unit) in values.items():
        if not np.isfinite(np.asarray(value)):
            raise ControlError(f"export_c: {name}_{key}: expected a finite number, got {value}")
        constant = number(float(value), real)
        lines.append(f"static const {real} {name}_{key} = {constant}; /* {unit} */\n")
    return "".join(lines), len(values)


def _header(
    stepper: Stepper, sizes: _Sizes, name: str, real: str, origin: str, further: str
) -> str:
    """The header; `further`: declarations after those that every twin has."""
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


def _functions(sizes: _Sizes, name: str, real: str) -> str:
    return "".join(
        [
            _heat(sizes, name, real),
            _force(sizes, name, real),
            _losses(sizes, name, real) if sizes.has_loss else "",
            _part(sizes, name, real),
            _public(sizes, name, real),
        ]
    )


def _heat(sizes: _Sizes, name: str, real: str) -> str:
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


def _force(sizes: _Sizes, name: str, real: str) -> str:
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


def _losses(sizes: _Sizes, name: str, real: str) -> str:
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


def _reservoir_term(sizes: _Sizes, name: str) -> str:
    """The C that adds the forces of reservoirs; empty without any."""
    return f" + {name}_reservoirs[m]" if sizes.has_reservoirs else ""


def _part(sizes: _Sizes, name: str, real: str) -> str:
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


def _public(sizes: _Sizes, name: str, real: str) -> str:
    n, cells, queue = sizes.modes, sizes.cells, sizes.queue
    zero = number(0.0, real)
    celsius = number(ZERO_CELSIUS, real)
    fill = ""
    if queue:
        fill = f"""        for (m = 0; m < {queue}; ++m) {{
            state->late[m][i] = duty[i];
        }}
"""
    # Commands on their way, the newest first: late[0] was given a step ago.
    in_transit = [("duty" if k == 0 else f"state->late[{k - 1}]") for k in range(queue + 1)]
    delayed = in_transit[-sizes.parts :][::-1]
    shift = ""
    if queue:
        shift = f"""    for (m = {queue - 1}; m > 0; --m) {{
        for (i = 0; i < {cells}; ++i) {{
            state->late[m][i] = state->late[m - 1][i];
        }}
    }}
    for (i = 0; i < {cells}; ++i) {{
        state->late[0][i] = duty[i];
    }}
"""
    now = "state->duty" if sizes.has_lag else delayed[0]
    if sizes.has_loss:
        steady = f"""    {name}_losses(state->z, deviation, first);
    {name}_force(state->z, {now}, first, slope);
    for (m = 0; m < {n}; ++m) {{
        b[m] = state->z[m] + {name}_to_half_decay[m] * state->z[m] + {name}_to_half[m] * slope[m];
    }}
    {name}_losses(b, deviation, slope);
    for (m = 0; m < {n}; ++m) {{
        slope[m] -= first[m];
    }}
"""
        declared, last = f"{real} first[{n}], slope[{n}], b[{n}];", "first, slope"
    else:
        steady = f"""    for (m = 0; m < {n}; ++m) {{
        first[m] = {name}_surroundings[m] * deviation{_reservoir_term(sizes, name)};
    }}
"""
        declared, last = f"{real} first[{n}];", "first"
    calls = "".join(
        f"    {name}_part(state, {part}, {command}, {last});\n"
        for part, command in enumerate(delayed)
    )
    counters = "int i, m;" if queue else "int m;"
    return f"""void {name}_init({name}_state *state, const {real} nodes[{sizes.nodes}],
{" " * len(f"void {name}_init(")}const {real} duty[{cells}])
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

void {name}_step({name}_state *state, const {real} duty[{cells}], {real} ambient)
{{
    const {real} deviation = ambient + {celsius} - {name}_T0;
    {declared}
    {counters}
{steady}{calls}{shift}}}

void {name}_output(const {name}_state *state, {real} ambient,
{" " * len(f"void {name}_output(")}{real} temperatures[{sizes.channels}])
{{
    const {real} deviation = ambient + {celsius} - {name}_T0;
    int i, m;
    for (i = 0; i < {sizes.channels}; ++i) {{
        {real} sum = {name}_by_ambient[i] * deviation;
        for (m = 0; m < {n}; ++m) {{
            sum += {name}_by_modes[i][m] * state->z[m];
        }}
        temperatures[i] = sum + ({name}_T0 - {celsius});
    }}
}}

void {name}_nodes(const {name}_state *state, {real} nodes[{sizes.nodes}])
{{
    int i, m;
    for (i = 0; i < {sizes.nodes}; ++i) {{
        {real} sum = {zero};
        for (m = 0; m < {n}; ++m) {{
            sum += {name}_shape[i][m] * state->z[m];
        }}
        nodes[i] = sum + ({name}_T0 - {celsius});
    }}
}}
"""


def _declared_slopes(name: str, real: str) -> str:
    upper = name.upper()
    return f"""/* How fast the temperatures of the nodes change, K/s; the duty is what reaches
   the cells, the ambient in degC. */
void {name}_slopes(const {real} nodes[{upper}_NODES], const {real} duty[{upper}_CELLS],
                   {real} ambient, {real} slopes[{upper}_NODES]);

"""


def _slopes(sizes: _Sizes, name: str, real: str) -> str:
    n, zero, celsius = sizes.modes, number(0.0, real), number(ZERO_CELSIUS, real)
    steady = f"    {name}_losses(state.z, deviation, first);\n"
    if not sizes.has_loss:
        steady = f"""    for (m = 0; m < {n}; ++m) {{
        first[m] = {name}_surroundings[m] * deviation{_reservoir_term(sizes, name)};
    }}
"""
    return f"""
void {name}_slopes(const {real} nodes[{sizes.nodes}], const {real} duty[{sizes.cells}],
                   {real} ambient, {real} slopes[{sizes.nodes}])
{{
    const {real} deviation = ambient + {celsius} - {name}_T0;
    {real} first[{n}], force[{n}];
    {name}_state state;
    int i, m;
    {name}_init(&state, nodes, duty);
{steady}    {name}_force(state.z, duty, first, force);
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
