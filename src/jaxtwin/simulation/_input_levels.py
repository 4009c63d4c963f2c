"""The inputs of a rig besides the duty, as numbers at the samples of an experiment, and how fast
the rig answers to each."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from .._name_suggestions import unknown_name
from ..errors import JaxtwinError, SimulationError
from ..io import Experiment
from ..physics import Twin, Wiring
from ..rig import AMBIENT, Input, Rig

# The largest number of regimes. An eigenproblem is solved for each.
MAX_REGIMES = 8


def input_levels(
    experiment: Experiment, inputs: tuple[Input, ...]
) -> Float[np.ndarray, "times inputs"] | None:
    """The inputs of a rig from each sample on: numbers of states, or values in SI units.

    An input that a schedule does not state has the value of the rig file.

    **Returns:** a column for each input; None for a rig without any.

    **Raises:** `SimulationError` if a recording lacks an input, or names a state that it does not
    have.
    """
    if not inputs:
        return None
    return np.stack([_levels(experiment, rig_input) for rig_input in inputs], axis=1)


def _levels(experiment: Experiment, source: Input) -> Float[np.ndarray, " times"]:
    label = experiment.name or "the experiment"
    given = experiment.inputs.get(source.name)
    if given is None:
        if experiment.temperatures is not None:
            raise SimulationError(
                f"{label}: expected a column for the input {source.name!r} of the rig, "
                f"input_{source.name}, got none; experiment.with_inputs({source.name}="
                f"{_example(source)}) states it for the whole recording"
            )
        return np.full(len(experiment.time), source.level)
    return _numbers(given, source, label, SimulationError)


def _numbers(
    given: Shaped[np.ndarray, "*times"], source: Input, label: str, error: type[JaxtwinError]
) -> Float[np.ndarray, "*times"]:
    """The levels of an input whose values or states are given."""
    where = f"{label}: input {source.name}"
    if given.dtype.kind == "U":
        if not source.states:
            unit = source.unit and f" in {source.unit}"
            raise error(f"{where}: expected a number{unit}, got {str(given.flat[0])!r}")
        for state in dict.fromkeys(given.ravel().tolist()):
            if state not in source.states:
                raise error(f"{where}: {unknown_name('state', state, source.states)}")
        result = [source.states.index(state) for state in given.ravel().tolist()]
        return np.array(result, float).reshape(given.shape)
    if source.states:
        last = len(source.states) - 1
        outside = (given < 0) | (given > last)
        if outside.any():
            raise error(
                f"{where}: expected {', '.join(source.states)}, or 0 to {last}, got "
                f"{given[outside][0]:g}"
            )
    return np.asarray(source.scale * given + source.offset)


def stated_levels(
    where: str, inputs: tuple[Input, ...], stated: Mapping[str, Any], error: type[JaxtwinError]
) -> Float[Array, " inputs"]:
    """The levels of all inputs for a moment, of which some are stated: numbers (which JAX may
    trace) or names of states. The others have the value of the rig file.

    **Raises:** `error`, with `where` before it, for an unknown input or state.
    """
    known = [rig_input.name for rig_input in inputs]
    for name in stated:
        if name not in known:
            raise error(f"{where}: inputs: {unknown_name('input', name, known)}")
    levels = [
        _level(where, stated.get(rig_input.name, rig_input.value), rig_input, error)
        for rig_input in inputs
    ]
    return jnp.stack([jnp.asarray(level) for level in levels])


def _level(where: str, stated: Any, source: Input, error: type[JaxtwinError]) -> Any:
    if isinstance(stated, jax.Array):
        return source.scale * stated + source.offset
    given = np.asarray(stated if isinstance(stated, str) else float(stated))
    return _numbers(given, source, where, error)


def _example(source: Input) -> str:
    return repr(source.states[0]) if source.states else f"{source.value:g}"


def regimes(
    levels: Float[np.ndarray, "times inputs"], changes_network: Bool[np.ndarray, " inputs"]
) -> Float[np.ndarray, "regimes inputs"]:
    """The inputs for which the modes of the network are found: all that occur, if these are few,
    otherwise some that are far from each other. Their number is a power of 2.

    Inputs that change no resistance have their mean.

    **Arguments:**

    - `levels`: the inputs from each sample on.
    - `changes_network`: whether each of them changes a resistance.
    """
    distinct = np.unique(np.where(changes_network, levels, levels.mean(axis=0)), axis=0)
    scale = np.where(np.ptp(distinct, axis=0) > 0, np.ptp(distinct, axis=0), 1.0)
    chosen = [0]
    distance = np.full(len(distinct), np.inf)
    while len(chosen) < min(MAX_REGIMES, len(distinct)):
        beside = np.abs((distinct - distinct[chosen[-1]]) / scale).max(axis=1)
        distance = np.minimum(distance, beside)
        chosen.append(int(np.argmax(distance)))
    count = 1 << (len(chosen) - 1).bit_length()
    return distinct[chosen + chosen[-1:] * (count - len(chosen))]


def input_changes(
    experiment: Experiment, levels: Float[np.ndarray, "times inputs"] | None
) -> Int[np.ndarray, " changes"]:
    """The indices of samples at which an input differs from the previous sample: the duty, the
    ambient temperature, or another input."""
    changed = np.any(experiment.duty[1:] != experiment.duty[:-1], axis=1)
    if isinstance(experiment.ambient, np.ndarray):
        changed |= experiment.ambient[1:] != experiment.ambient[:-1]
    if levels is not None:
        changed |= np.any(levels[1:] != levels[:-1], axis=1)
    return 1 + np.flatnonzero(changed)


# How fast a rig answers to a change of each of its inputs, from the values in its file.
#
# The solvers' steps after a change are as short as the transient that it starts needs. Its size is
# the largest rate at which a channel's temperature moves in the time $\tau$ after a change that
# brings the heat $b$ into the nodes, for times from a second to minutes: $w^T (C + \tau G)^{-1} b$,
# one implicit step of Euler. The rates are the largest of the rig's parameter sets and do not
# depend on the values of a twin: other values need no other steps and no new compilation.

# The times after a change, s.
TIMES = (1.0, 4.0, 16.0, 64.0)

# The rate of full duty, K/s. Those of the bundled rigs are 0.3 to 3; at parameters that a match
# finds, or a batch draws, they are others.
OF_DUTY = 2.0

# The temperature of a cell's sides, and the difference along a link that an input changes, K.
TYPICAL_TEMPERATURE, TYPICAL_DIFFERENCE = 300.0, 20.0

# The number of nodes up to which a full matrix is solved.
MAX_DENSE = 600

# The change of an input for its derivative, as a part of its value.
DIFFERENCE = 1e-3


@lru_cache(maxsize=64)
def input_rates(rig: Rig) -> tuple[float, ...]:
    """The rates for a unit of each input, K/s: of the duty of each cell, of the ambient temperature
    in K, and of each other input in SI units; infinite for an input with states."""
    twins = [Twin(rig), *(Twin(rig, values) for values in rig.parameter_sets.values())]
    rates = np.max([_slow_rates(twin.wiring, twin.numbers_si) for twin in twins], axis=0)
    return (OF_DUTY,) * len(twins[0].wiring.cold) + tuple(rates.tolist())


def _slow_rates(wiring: Wiring, values: dict[str, float]) -> Float[np.ndarray, " inputs"]:
    """The rates of all inputs but the duty."""
    heat = np.column_stack(_heat(wiring, values))
    entries, capacitance = _conductance_entries(wiring, values), wiring.capacitances.numbers(values)
    answers = [wiring.channel_weights @ _solved(capacitance, entries, t, heat) for t in TIMES]
    rates = np.abs(answers).max(axis=(0, 1))
    voltage = wiring.bridge_constants.numbers(values)[0]
    for number, source in enumerate(wiring.inputs, 1):
        if source.states:
            rates[number] = np.inf
        elif wiring.input_wiring and source.name in wiring.input_wiring.supply_voltage.names:
            rates[number] += 2 * OF_DUTY / max(float(voltage), 1.0)
    return np.where(np.isfinite(rates), rates, np.inf)


def _solved(
    capacitance: Float[np.ndarray, " nodes"],
    entries: tuple[np.ndarray, np.ndarray, np.ndarray],
    time: float,
    heat: Float[np.ndarray, "nodes inputs"],
) -> Float[np.ndarray, "nodes inputs"]:
    conductance, rows, columns = entries
    if len(capacitance) > MAX_DENSE:
        from scipy import sparse  # takes a quarter of a second to import
        from scipy.sparse.linalg import splu

        whole = sparse.coo_array((time * conductance, (rows, columns)))
        return splu((whole + sparse.diags_array(capacitance)).tocsc()).solve(heat)
    matrix = np.diag(capacitance)
    np.add.at(matrix, (rows, columns), time * conductance)
    return np.linalg.solve(matrix, heat)


def _conductance_entries(
    wiring: Wiring, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The conductances of the network, with those of the Seebeck voltage of the cells, as entries
    of its matrix, W/K, which add up, with their rows and columns."""
    index, links = wiring.netlist.index, wiring.netlist.links
    seebeck, resistance, _ = wiring.module_constants.numbers(values).reshape(3, -1)
    pairs = [(index[link.a], index.get(link.b, -1)) for link in links]
    pairs += list(zip(wiring.cold.tolist(), wiring.hot.tolist(), strict=True))
    own = wiring.conductance_numbers(values), seebeck**2 * TYPICAL_TEMPERATURE / resistance
    (a, b), conductance = np.array(pairs, int).T, np.concatenate(own)
    inner = b >= 0
    x, y, between = a[inner], b[inner], conductance[inner]
    rows, columns = np.concatenate([a, y, x, y]), np.concatenate([a, y, y, x])
    return np.concatenate([conductance, between, -between, -between]), rows, columns


def _heat(wiring: Wiring, values: dict[str, float]) -> list[Float[np.ndarray, " nodes"]]:
    """The heat of a kelvin of the ambient, and of a unit of each other input but that of the
    supply's voltage, W."""
    index, links = wiring.netlist.index, wiring.netlist.links
    conductances = wiring.conductance_numbers(values)

    def held(name: str) -> Float[np.ndarray, " nodes"]:
        """The conductances of the nodes to the surroundings, or to a body."""
        heat = np.zeros(len(index))
        for link, conductance in zip(links, conductances, strict=True):
            if link.b == name:
                heat[index[link.a]] += conductance
        return heat

    effects = wiring.input_wiring
    of_ambient = held(AMBIENT)
    if effects is None:
        return [of_ambient]
    bodies = [held(reservoir.name) for reservoir in wiring.netlist.reservoirs]

    def of_input(source: Input) -> Float[np.ndarray, " nodes"]:
        change = DIFFERENCE * max(abs(source.level), 1.0)
        link, body = (
            table.numbers(values | source.shares(source.level + change))
            - table.numbers(values | source.nominal)
            for table in (effects.conductances, effects.reservoirs)
        )
        heat = TYPICAL_DIFFERENCE * link @ effects.differences
        return sum((moved * of for moved, of in zip(body, bodies, strict=True)), heat) / change

    return [of_ambient, *(of_input(source) for source in wiring.inputs)]
