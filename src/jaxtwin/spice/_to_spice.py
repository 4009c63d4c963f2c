"""A twin in an experiment as SPICE text, so that another simulator can check it.

Heat is represented as current: volts stand for kelvins, amperes for watts, ohms for K/W and farads
for J/K.
"""

import math
import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..errors import SimulationError
from ..io import Experiment, check_duty_of_rig
from ..physics import (
    LAW_FOLDER,
    OWN_VOLTAGE,
    STEFAN_BOLTZMANN,
    Netlist,
    ThermoelectricElement,
    Twin,
)
from ..rig import AMBIENT, Rig, Value
from ..simulation import FittedTwins, twin_of_experiment

# The duration of a step of the drive, s, because sources of SPICE are piecewise linear.
_RAMP = 1e-6

# The longest step of the solver, s; the tolerance requires shorter ones after changes.
_MAX_STEP = 1.0


def to_spice(
    twin: Twin | FittedTwins, experiment: Experiment, *, output: str = "temperatures.txt"
) -> str:
    """Returns the text of a netlist that `ngspice -b` runs.

    A node's voltage is its temperature above that of the surroundings at the start, because
    SPICE's tolerances are relative. Capacities are capacitors, links are resistors that are named
    by role and ends, duty cycles are voltage sources, and each cell is a pair of behavioural
    current sources, eqs. (7)-(9), with the averaging of the rig's driver. The run starts at the
    temperatures that the rig gives.

    ngspice writes a table: a line of names, then a row for each of its steps with the time since
    the first sample (s) and the temperatures of all nodes (degC, in the order of
    `twin.netlist.nodes`). A step ends at every sample of the experiment, so that nothing has to be
    interpolated.

    **Arguments:**

    - `twin`: a twin with one value for each parameter; or a fit, of which the twin of the
      experiment is used, see `Fit.twin_for`.
    - `experiment`: the experiment whose duty cycles drive the twin. A recorded ambient temperature
      replaces that of the rig. Other inputs of the rig have the values of the rig file throughout.
    - `output`: the path of the file that ngspice will write, without blanks.

    **Returns:** the text, to be saved as a file for ngspice.

    **Raises:** `SimulationError` if the experiment drives another number of cells and heaters, a
    heater is to cool, or it states an input that the rig does not have; `ParameterError` if a
    parameter holds more than one value.
    """
    twin = twin_of_experiment(twin, experiment)
    label = experiment.name or "the experiment"
    check_duty_of_rig(experiment, twin.rig, label, SimulationError)
    values = twin.numbers_si
    time = experiment.elapsed
    ambient = experiment.ambient
    if ambient is None:
        drift = 0.0 if twin.rig.ambient_drift is None else twin.rig.ambient_drift.evaluate(values)
        ambient = twin.rig.ambient_temperature.evaluate(values) - ZERO_CELSIUS + drift * time
    ambient = np.broadcast_to(np.asarray(ambient, float) + ZERO_CELSIUS, experiment.time.shape)
    names = _node_names(twin.netlist)
    return "\n".join(
        [
            *_head(twin, experiment, values),
            *_constants(twin.rig, ambient[0], values),
            *_laws(),
            *_network(twin.netlist, names, ambient[0], values),
            *_losses(twin, names, values),
            f"Vambient ambient 0 {_held(time, ambient - ambient[0])}",
            *_cells(twin, names, time, experiment.duty, values),
            *_run(twin.netlist, names, time, ambient[0], output),
            "",
        ]
    )


def _head(twin: Twin, experiment: Experiment, values: Mapping[str, float]) -> list[str]:
    table = twin.rig.parameters
    return [
        _comment(f"jaxtwin: {twin.rig.name}, {experiment.name or 'an experiment'}"),
        "* 1 V = 1 K above T_ref (below), 1 A = 1 W, 1 ohm = 1 K/W, 1 F = 1 J/K",
        "*",
        "* Parameters in SI units:",
        *(
            _comment(f"{name} = {values[name]!r} ({row.description})".removesuffix(" ()"))
            for name, row in table.items()
        ),
    ]


def _constants(rig: Rig, reference: float, values: Mapping[str, float]) -> list[str]:
    driver, limit = rig.driver, rig.driver.current_limit
    return [
        "*",
        "* Surroundings at the start, K; supply, V; its resistance and that of the bridge, ohm",
        f".param T_ref={float(reference)!r}",
        f".param V_s={_number(driver.supply_voltage, values)}",
        f".param R_s={_number(driver.supply_resistance, values)}",
        f".param R_on={_number(driver.on_resistance, values)}",
        *([] if limit is None else [f".param I_max={_number(limit, values)}"]),
    ]


def _laws() -> list[str]:
    """The laws of heat as functions, which `physics/_make_laws.py` writes from those in Python."""
    return ["*", *(LAW_FOLDER / "laws.cir").read_text(encoding="ascii").splitlines()]


def _network(
    netlist: Netlist, names: Mapping[str, str], reference: float, values: Mapping[str, float]
) -> list[str]:
    lines = ["*", "* Nodes"]
    for node in netlist.nodes:
        name = names[node.name]
        start = float(node.initial_temperature.evaluate(values) - reference)
        capacitance = _number(node.capacitance, values)
        lines.append(f"C_{name} {name} 0 {capacitance} ; {node.kind}: {node.capacitance}")
        lines.append(f".ic v({name})={start!r}")
    for held in netlist.reservoirs:
        name = names[held.name]
        above = float(held.temperature.evaluate(values) - reference)
        lines.append(f"Vheld_{name} {name} 0 {above!r} ; {held.temperature}")
    lines += ["*", "* Links"]
    used: set[str] = set()
    for link in netlist.links:
        if math.isinf(link.resistance(values)):  # a path that is closed, or a contact elsewhere
            continue
        a, b = names[link.a], names[link.b]
        resistor = _unique(f"R{link.role}_{a}_{b}", used)
        resistance = float(link.resistance(values))
        formula = " + ".join(str(value) for value in link.resistances)
        if link.conductances:
            formula = f"1 / ({' + '.join(str(value) for value in link.conductances)})"
        lines.append(f"{resistor} {a} {b} {resistance!r} ; {formula}")
    return lines


def _losses(twin: Twin, names: Mapping[str, str], values: Mapping[str, float]) -> list[str]:
    """The losses beyond the resistors of the links; see `NonlinearLoss`."""
    with own_settings():
        system = twin.system()
    loss, paths = system.loss, system.wiring.loss_paths
    if loss is None or paths is None:
        return []
    ends = [part.name for part in (*twin.netlist.nodes, *twin.netlist.reservoirs)]
    # Numbers below 0 count the surroundings, then the reservoirs.
    beyond = [AMBIENT, *(reservoir.name for reservoir in twin.netlist.reservoirs)]
    lines = ["*", "* Losses beyond the links: convection with an exponent, radiation"]
    rows = zip(
        paths.near.tolist(), paths.far.tolist(), paths.linear.tolist(),
        *(np.asarray(part).tolist() for part in (loss.film, loss.exponent, loss.radiating)),
        strict=True,
    )  # fmt: skip
    used: set[str] = set()
    for near, far, linear, film, exponent, radiating in rows:
        name, end = names[ends[near]], names[ends[far] if far >= 0 else beyond[-1 - far]]
        constants = (film, exponent / 2, STEFAN_BOLTZMANN * radiating, linear)
        law = f"lost_heat(V({name},{end}),V({end})+T_ref,{','.join(map(repr, constants))})"
        lines.append(f"{_unique(f'Bloss_{name}', used)} {name} {end} I={law}")
    return lines


def _cells(
    twin: Twin,
    names: Mapping[str, str],
    time: Float[np.ndarray, " times"],
    duty: Float[np.ndarray, "times cells"],
    values: Mapping[str, float],
) -> list[str]:
    lines = []
    for number, cell in enumerate(twin.netlist.cells, start=1):
        lines += ["*", _comment(f"Cell {cell.name}: duty; EMF, V; currents, A (as voltages)")]
        lines += [
            f".param alpha_{number}={_number(cell.seebeck_coefficient, values)}",
            f".param R_E_{number}={_number(cell.electrical_resistance, values)}",
            *_duty(twin.rig, number, time, duty[:, number - 1], values),
            *_heat(twin.rig, cell, number, names, values),
        ]
    return lines


def _duty(
    rig: Rig,
    number: int,
    time: Float[np.ndarray, " times"],
    duty: Float[np.ndarray, " times"],
    values: Mapping[str, float],
) -> list[str]:
    """A source for the duty cycle, behind a resistor and a capacitor if the driver has a lag."""
    driver = rig.driver
    if driver.lag is None:
        return [f"Vduty_{number} duty_{number} 0 {_held(time, duty)}"]
    delay = 0.0 if driver.delay is None else float(driver.delay.evaluate(values))
    begun, commands = [0.0], [0.0]
    begun += (time + max(delay, _RAMP)).tolist()
    commands += duty.tolist()
    return [
        f"Vcommand_{number} command_{number} 0 {_held(np.array(begun), np.array(commands))}",
        f"Rlag_{number} command_{number} duty_{number} 1",
        f"Clag_{number} duty_{number} 0 {_number(driver.lag, values)}",
        f".ic v(duty_{number})=0",
    ]


def _heat(
    rig: Rig,
    cell: ThermoelectricElement,
    number: int,
    names: Mapping[str, str],
    values: Mapping[str, float],
) -> list[str]:
    """Eqs. (7)-(9), averaged as in `Bridge`."""
    cold, hot = names[cell.cold], names[cell.hot]
    duty, emf = f"V(duty_{number})", f"V(emf_{number})"
    if cell.has_own_supply:
        square = OWN_VOLTAGE.factor**2
        share = f"abs({duty})"
        if cell.drive_exponent is not None:
            share = f"share_of_duty({duty},{_number(cell.drive_exponent, values)})"
        return [f"Bhot_{number} 0 {hot} I={share}*{square!r}/R_E_{number}"]
    lines = [f"Bemf_{number} emf_{number} 0 V=alpha_{number}*(V({hot})-V({cold}))"]
    if rig.driver.averaging == "voltage":
        drive = f"-{duty}*V_s"
        loop = f"R_E_{number}+R_on+abs({duty})*R_s"
        phases = {"on": ""}
    else:
        drive = f"-sgn({duty})*V_s"
        loop = f"R_E_{number}+R_on+R_s"
        phases = {"on": f"abs({duty})*", "off": f"(1-abs({duty}))*"}
    current = f"({drive}-{emf})/({loop})"
    if rig.driver.current_limit is not None:
        current = f"max(min({current},I_max),-I_max)"
    lines.append(f"Bon_{number} on_{number} 0 V={current}")
    if "off" in phases:
        off = f"-{emf}/(R_E_{number}+R_on)" if rig.driver.off_phase == "brake" else "0"
        lines.append(f"Boff_{number} off_{number} 0 V={off}")

    def flow(side: str, sign: str) -> str:
        # A product, not a power: `^` of a negative base is not the same in all versions of ngspice.
        return "+".join(
            f"{share}V({phase}_{number})*(alpha_{number}*(V({side})+T_ref)"
            f"{sign}R_E_{number}/2*V({phase}_{number}))"
            for phase, share in phases.items()
        )

    lines.append(f"Bcold_{number} {cold} 0 I={flow(cold, '-')}")
    lines.append(f"Bhot_{number} 0 {hot} I={flow(hot, '+')}")
    return lines


def _run(
    netlist: Netlist,
    names: Mapping[str, str],
    time: Float[np.ndarray, " times"],
    reference: float,
    output: str,
) -> list[str]:
    step = min(_MAX_STEP, float(np.median(np.diff(time))))
    nodes = [names[node.name] for node in netlist.nodes]
    offset = float(reference - ZERO_CELSIUS)
    return [
        "*",
        ".options reltol=1e-8",
        f".tran {step!r} {float(time[-1])!r} 0 {step!r}",
        ".control",
        "set wr_singlescale",
        "set wr_vecnames",
        "set numdgt=12",
        "run",
        *(f"let {name}_degC = v({name}) + {offset!r}" for name in nodes),
        f"wrdata {output} {' '.join(f'{name}_degC' for name in nodes)}",
        "quit",
        ".endc",
        ".end",
    ]


def _held(time: Float[np.ndarray, " times"], values: Float[np.ndarray, " times"]) -> str:
    """A source that holds each sample's value until the next; each sample is a corner, at which
    the solver ends a step."""
    points = [(time[0], values[0])]
    for now, before, after in zip(time[1:], values[:-1], values[1:], strict=True):
        points.append((now, before))
        if after != before and now < time[-1]:
            points.append((now + _RAMP, after))
    lines = [
        "+ "
        + " ".join(f"{float(at)!r} {float(value)!r}" for at, value in points[start : start + 4])
        for start in range(0, len(points), 4)
    ]
    return "\n".join(["PWL(", *lines, "+ )"])


def _node_names(netlist: Netlist) -> dict[str, str]:
    used = {"ambient"}
    names = {part.name: _unique(part.name, used) for part in (*netlist.nodes, *netlist.reservoirs)}
    return names | {AMBIENT: "ambient"}


def _unique(text: str, used: set[str]) -> str:
    """A name that is valid in SPICE, which ignores case, and differs from those already `used`."""
    name = plain = re.sub(r"\W", "_", text, flags=re.ASCII)
    number = 1
    while name.lower() in used:
        number += 1
        name = f"{plain}_{number}"
    used.add(name.lower())
    return name


def _number(value: Value, values: Mapping[str, float]) -> str:
    return repr(float(value.evaluate(values)))


def _comment(text: str) -> str:
    return "* " + " ".join(text.split())
