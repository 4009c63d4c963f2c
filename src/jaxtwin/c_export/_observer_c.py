"""An observer as C: the extended Kalman filter of a twin, with the sample time of its steps.

`observer.c` has the same equations as `observers/`: the step and its linearisation in the modes of
the network, the commands on their way, the noise, the start from a first reading. Readings are
taken in one after the other; Python takes all of them at once, with the same result.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._celsius import ZERO_CELSIUS
from .._jax_settings import own_settings
from ..control import LawTable
from ..errors import ControlError
from ..observers import (
    CERTAIN_CORRECTION_SIGMAS,
    CORRECTION_SIGMAS,
    FOLLOW_COUNT,
    GATE_SIGMAS,
    GRID,
    INTERVAL_SPREAD,
    MAX_REJECTED,
    MIN_GATE_KELVIN,
    READ_SPREAD,
    REST_SCALE,
    ExtendedKalmanFilter,
)
from ..simulation import Stepper, step_factors
from ._sources import Code, Parts, code_of, comment_block, defines, type_of_numbers, whole_numbers
from ._stepper_c import COMMENTS, StepperSizes, stepper_constants, stepper_tables


def observer_c(kalman: ExtendedKalmanFilter, name: str, precision: str, origin: str) -> Code:
    """Returns header, source and numbers.

    **Raises:** `ControlError` if values of the twin are among the states, if the rig has other
    inputs, or if a number is not finite in this precision.
    """
    model = kalman.model
    if model.directions is not None:
        raise ControlError(
            "export_c: model: expected an observer whose twin has exact values, got one with "
            "uncertain ones; make it by live_observer, from a noise without names"
        )
    if model.stepper.system.wiring.inputs:
        raise ControlError(
            f"export_c: model: expected an observer of a rig without other inputs, got one of "
            f"{model.twin.rig.name}"
        )
    wiring = model.stepper.system.wiring
    if wiring.drive_exponents is not None or wiring.convection is not None:
        raise ControlError(
            "export_c: model: expected an observer of a rig whose links are resistances and whose "
            f"heaters are proportional, got one of {model.twin.rig.name}; export a reduced linear "
            "model, or run the observer in Python"
        )
    with own_settings():
        stepper = _single_step(model.stepper, kalman.longest_seconds)
        sizes = StepperSizes(stepper)
        tables = _tables(kalman, stepper, sizes)
        numbers = defines(name, _constants(kalman, stepper, sizes), precision, COMMENTS)
        numbers += "\n/* Nodes of the cold sides of the cells, and of the hot ones. */\n"
        numbers += whole_numbers(name, "side", sizes.sides)
        parts = Parts(
            _about(kalman, name, precision, origin),
            type_of_numbers(name, precision) + defines(name, _sizes(kalman, sizes), precision),
            numbers,
            tables,
            _memory(kalman, sizes),
        )
        return code_of("observer", name, precision, parts)


def _single_step(stepper: Stepper, step: float) -> Stepper:
    """The stepper with the numbers of a single step of this length."""
    length = jnp.asarray([step])
    factors = step_factors(stepper.field.modes.rates, length)
    return eqx.tree_at(
        lambda s: (s.sizes, s.factors, s.half_decay, s.half),
        stepper,
        (length, factors, factors.half_decay[0], factors.half[0]),
        is_leaf=lambda leaf: leaf is None,
    )


def _tables(
    kalman: ExtendedKalmanFilter, stepper: Stepper, sizes: StepperSizes
) -> dict[str, LawTable]:
    """The arrays: those of the step, and those of the filter."""
    model, modes, system = kalman.model, stepper.field.modes, stepper.system
    dt = jnp.asarray(kalman.longest_seconds)
    tables = stepper_tables(stepper, sizes)
    for key in ("lag", "capacitance"):
        tables.pop(key, None)
    columns = np.asarray(model.columns)
    for key in ("by_modes", "by_ambient"):
        values, comment = tables[key]
        tables[key] = values[columns], comment
    rates = np.asarray(modes.rates, float)
    fading = -np.expm1(-rates * float(dt)) / (rates * float(dt))
    seen = np.asarray(system.channel_weights, float)[columns].mean(axis=0)
    everywhere = modes.amplitudes(jnp.ones_like(system.capacitance))
    kept = np.asarray(model.decay(dt), float)
    heaters = np.array([cell.is_heater for cell in system.wiring.netlist.cells], float)
    if heaters.any():
        tables["is_heater"] = heaters, "1 for a heater, whose duty is 0 to 1"
    return tables | {
        "rate": (rates, "by which the modes decay, 1/s"),
        "faded": (np.asarray(modes.sides, float) * fading, "the sides, of heat held for a step"),
        "kept": (kept, "what is left of the states that only decay"),
        "walk": (np.asarray(model.walks(dt), float), "variances that a step adds to them"),
        "start": (np.asarray(model.start_spreads(), float) ** 2, "variances at the start"),
        "mean_reading": (
            seen @ np.asarray(modes.shapes, float),
            "the mean of the channels by the modes, K",
        ),
        "everywhere": (np.asarray(everywhere, float), "the modes of a rig that is 1 K warmer"),
    }


def _constants(
    kalman: ExtendedKalmanFilter, stepper: Stepper, sizes: StepperSizes
) -> dict[str, int | float]:
    """The macros of the numbers."""
    model, system = kalman.model, stepper.system
    noise, dt = model.noise, kalman.longest_seconds
    result = stepper_constants(stepper, sizes)
    if sizes.has_lag:
        result["LAG"] = float(np.asarray(system.lag))
    if any(cell.is_heater for cell in system.wiring.netlist.cells):
        result["HAS_HEATERS"] = 1
    if sizes.has_delay:
        result["DELAY"] = float(np.asarray(system.delay))
    return result | {
        "SPACING": float(np.asarray(kalman.spacing)),
        "COMMAND_TIME": float(np.asarray(noise.command_time)),
        "RANDOM_HEAT": float(np.asarray(noise.heat)) * dt**0.5,
        "READING_VARIANCE": float(np.asarray(noise.reading)) ** 2,
        "READING_TIME": float(np.asarray(noise.reading_time)),
        "AMBIENT_VARIANCE": float(np.asarray(noise.ambient)) ** 2,
        "JUMP_VARIANCE": float(np.asarray(noise.jump)) ** 2,
        "JUMP_MEAN": float(np.asarray(noise.jump_mean)),
        "INTERVAL_SPREAD": INTERVAL_SPREAD,
        "OPENED_AT": CORRECTION_SIGMAS,
        "CERTAIN_AT": CERTAIN_CORRECTION_SIGMAS,
        "GATE": GATE_SIGMAS,
        "MIN_GATE": MIN_GATE_KELVIN,
        "MAX_REJECTED": MAX_REJECTED,
        "FOLLOWED": FOLLOW_COUNT,
        "ROOM_SPREAD": float(np.asarray(model.room_spread)),
        "REST_SCALE": REST_SCALE,
        "READ_VARIANCE": READ_SPREAD**2,
        "GRID": len(GRID),
    }


def _sizes(kalman: ExtendedKalmanFilter, sizes: StepperSizes) -> dict[str, int | float]:
    """The macros of the header."""
    layout = kalman.model.layout
    common = layout.of("common")
    result: dict[str, int | float] = {
        "SAMPLE_TIME_S": kalman.longest_seconds,
        "AMBIENT": float(kalman.model.stepper.reference) - ZERO_CELSIUS,
        "CELLS": sizes.cells,
        "CHANNELS": len(kalman.model.columns),
        "NODES": sizes.nodes,
        "MODES": sizes.modes,
        "INPUTS": 0,
        "COMMANDS": kalman.held,
        "STATES": layout.size,
        "ROWS": layout.of("room").start,
        "DRIVEN": layout.driven,
        "DUTY": layout.duty,
        "ROOM": layout.of("room").start,
        "HEATS": layout.of("heats").start,
        "COMMON": common.start,
        "COMMONS": common.stop - common.start,
    }
    if layout.channels:
        result["OWN"] = layout.of("channels").start
    if kalman.model.interval is not None:
        result["INTERVAL"] = kalman.model.interval
    return result


def _memory(kalman: ExtendedKalmanFilter, sizes: StepperSizes) -> int:
    """The number of values in the state."""
    layout = kalman.model.layout
    states, rows = layout.size, layout.of("room").start
    of_state = states * (1 + states) + sizes.cells * (1 + kalman.held) + kalman.held
    of_step = sizes.modes**2 + rows * (layout.driven + states)
    clock = kalman.model.interval is not None
    return of_state + len(kalman.model.columns) + clock + of_step


def _about(kalman: ExtendedKalmanFilter, name: str, precision: str, origin: str) -> str:
    """The comment at the beginning of the header."""
    model = kalman.model
    wiring = model.stepper.system.wiring
    channels = [wiring.channels[column] for column in np.asarray(model.columns)]
    return comment_block(
        [
            f"{name}: an observer of a thermoelectric rig, written by jaxtwin.",
            f"Parameters: {origin}" if origin else "Parameters: those of a jaxtwin.Twin",
            "",
            f"Sample time: {kalman.longest_seconds!r} s. Numbers: {precision}.",
            f"An extended Kalman filter with {model.layout.size} states.",
            "Duty cycles from -1 to 1, positive heats, of the cells:",
            *(
                f"  {n}: {cell.name}{', a heater: 0 to 1' if cell.is_heater else ''}"
                for n, cell in enumerate(wiring.netlist.cells)
            ),
            "Readings, degC, of the channels:",
            *(f"  {n}: {channel}" for n, channel in enumerate(channels)),
            "Nodes, degC:",
            *(f"  {n}: {node.name}" for n, node in enumerate(wiring.netlist.nodes)),
        ]
    )
