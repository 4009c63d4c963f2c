"""The law of an `MPC` in C: its numbers, and the memory of its programs."""

from typing import TYPE_CHECKING

import numpy as np

from ._condensed_program import rest_cost
from ._kalman import kalman_tables
from ._law import Law, bundled_law, check_designed_cells
from ._mpc_programs import ROOM_ON_THE_WAY, squares_at_rest
from ._program_numbers import RestCost, parameter_lines, program_numbers, work_of

if TYPE_CHECKING:
    from ._mpc import MPC


def mpc_law(mpc: "MPC", cells: int) -> Law:
    """Returns the law for a rig with so many cells.

    **Raises:** `ControlError` if the controller is one of another number of cells.
    """
    check_designed_cells(len(mpc.duty), cells)
    states = len(mpc.kalman.L)
    outputs, soft = len(mpc.outputs), mpc.soft_temperatures
    accepted = np.asarray(mpc.deviations.output, float)
    gain, inverse = np.asarray(mpc.gain, float), np.asarray(mpc.inverse, float)
    scaled, by_duty = rest_cost(gain, inverse, accepted, mpc.points is None)
    by_squares = squares_at_rest(soft)
    if by_squares is not None:
        by_duty = np.asarray(by_duty) + by_squares
    rest = RestCost(
        by_duty,
        -np.asarray(scaled).T / accepted,
        gain,
        mpc.disturbed,
        mpc.of_channels,
        mpc.adaptation,
        ROOM_ON_THE_WAY,
    )
    numbers = program_numbers(mpc.condensed, rest, soft, mpc.watched)
    moves, points = mpc.control_horizon * cells, len(mpc.point_names)
    of_plan = moves * (1 if mpc.rate_limit is None else 2) + numbers.constants["SOFT_ROWS"]
    of_rest = cells + 1 + soft.limited + 2 * points
    centres = int(numbers.constants.get("CENTRES", 0))
    constants = {
        "STATES": states,
        "READ": len(mpc.kalman.C),
        "MOVES": moves,
        **numbers.constants,
    }
    if mpc.reach is not None:
        constants["REACH"] = mpc.reach
    tables = {**kalman_tables(mpc.kalman, mpc.duty, mpc.outputs), **numbers.tables}
    lines = parameter_lines(mpc.deviations, mpc.rate_limit, mpc.temperature_limits, soft)
    if mpc.preview:
        lines.append("designed for the references of the whole horizon: see ..._step_ahead")
    memory = {"x": states, "moved": cells, "targets": mpc.horizon * cells}
    if mpc.read_channels:
        memory["error"] = len(mpc.read_channels)
    if soft.has_bands:
        memory |= {"deviation": mpc.horizon, "centre": mpc.horizon, "allowance": 1}
    return Law(
        bundled_law("mpc.c"),
        f"model predictive control of {outputs} outputs over {mpc.horizon} samples",
        {name: (np.ravel(values), text) for name, (values, text) in tables.items()},
        {
            **memory,
            **work_of(max(moves, cells + 1), max(int(of_plan), of_rest), centres),
        },
        lines,
        constants,
        horizon=mpc.horizon,
    )
