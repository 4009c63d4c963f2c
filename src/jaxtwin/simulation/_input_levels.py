"""The inputs of a rig besides the duty, as numbers at the samples of an experiment."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from .._name_suggestions import unknown_name
from ..errors import JaxtwinError, SimulationError
from ..io import Experiment
from ..rig import Input

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
