"""The law of an `MPC` in C: its numbers, and the memory of its programs."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..._quadratic_program import CENTERING, STEPS, TO_BOUNDARY
from ._controller import (
    Law,
    LawTable,
    bundled_law,
    check_designed_cells,
    parameter_text,
)
from ._kalman import kalman_tables
from ._mpc_programs import (
    EVENNESS_WEIGHT,
    MAX_BAND,
    MIN_BAND,
    ROOM_ON_THE_WAY,
    Condensed,
    SoftTemperatures,
    WatchedChannels,
    rest_cost,
    squares_at_rest,
)

if TYPE_CHECKING:
    from ._mpc import MPC


# The numbers of an `MPC` in C: those of its quadratic programs, and its parameters in words.
#
# The programs are scaled to a Hessian of about 1, as `_quadratic_program` does, but in C the
# scaled numbers are constants.


class RestCost(NamedTuple):
    """The cost of a duty at rest, and what it depends on.

    - `by_duty`, `by_missing`: its Hessian, and the derivatives of its gradient with respect to the
      distance from the references.
    - `gain`: the steady gain of the outputs, K per unit of duty. `to_duty`: that of a
      disturbance, as in `KalmanFilter`, 1/K.
    - `of_channels`: the outputs as means of the watched channels.
    - `adaptation`: how fast the deviations of points on the way follow those at rest, by sample;
      `room_on_the_way`: how large they may be relative to those.
    """

    by_duty: Float[Array | np.ndarray, "cells cells"]
    by_missing: Float[Array | np.ndarray, "cells outputs"]
    gain: Float[Array | np.ndarray, "outputs cells"]
    to_duty: Float[Array | np.ndarray, "cells disturbances"]
    of_channels: Float[Array | np.ndarray, "outputs watched"]
    adaptation: Float[Array | np.ndarray, ""]
    room_on_the_way: float


class ProgramNumbers(NamedTuple):
    """The tables and the constants of both programs, see `Law`."""

    tables: dict[str, LawTable]
    constants: dict[str, int | float]


def program_numbers(
    cost: Condensed,
    rest: RestCost,
    soft: SoftTemperatures,
    watched: WatchedChannels,
) -> ProgramNumbers:
    """Computes the numbers of the plan and of the target at rest."""
    hessian = np.asarray(cost.hessian, float)
    by_duty, by_missing = (np.asarray(part, float) for part in rest[:2])
    plan, scale = _scale(hessian), _scale(by_duty)
    cells, to_duty = len(by_duty), np.asarray(rest.to_duty, float)
    # The last duty enters only the gradient of the first sample.
    by_last = np.asarray(cost.by_last_duty, float)[:cells]
    at_rest = np.zeros((cells + soft.has_bands, cells + soft.has_bands))
    at_rest[:cells, :cells] = by_duty / scale
    tables: dict[str, LawTable] = {
        "hessian": (hessian / plan, "of the plan's cost by the moves"),
        "by_states": (np.asarray(cost.by_states, float) / plan, "its slope by the states"),
        "by_last": (by_last / plan, "by the last duty, of the first sample"),
        "by_target": (np.asarray(cost.by_target, float) / plan, "and by the duty at rest"),
        "rest_hessian": (at_rest, "of the cost of a duty at rest"),
        "by_missing": (by_missing / scale, "its slope by what is missing, 1/K"),
    }
    constants: dict[str, int | float] = {
        "STEPS": STEPS,
        "CENTERING": CENTERING,
        "TO_BOUNDARY": TO_BOUNDARY,
        "DISTURBANCES": to_duty.shape[1],
    }
    if len(watched.at):
        constants["ERRORS"] = len(watched.at)
        tables |= {
            "watched_L": (np.asarray(watched.L), "of the correction of the model's errors"),
            "watched_at": (np.asarray(watched.at), "channels at the operating point, degC"),
        }
    plan_sums, rest_sums, samples = [], [], cost.by_target.shape[1] // cells
    if soft.limits is not None:
        limits, constants["LIMITED"] = soft.limits, soft.limited
        gain = np.asarray(limits.rest_gain)
        plan_sums.append(np.asarray(limits.by_moves))
        rest_sums.append(np.pad(gain, ((0, 0), (0, int(soft.has_bands)))))
        tables |= {
            "soft_by_states": (np.asarray(limits.by_states), "limited temperatures, K"),
            "lowest": (np.asarray(limits.lowest)[: soft.limited], "their limits, K"),
            "highest": (np.asarray(limits.highest)[: soft.limited], "their limits, K"),
            "soft_by_rest": (gain @ to_duty, "and at rest by a disturbance"),
        }
    if soft.points is None and soft.limits is not None:
        tables["watched_C"] = np.asarray(watched.C), "watched temperatures by the states, K"
    if soft.points is not None and soft.cost is not None:
        points, price = soft.points, EVENNESS_WEIGHT / scale
        gain = np.asarray(points.rest_gain)
        constants |= {
            "POINTS": len(gain),
            "DUTY_PRICE": price * soft.cost.energy_price,
        }
        tables |= {
            "points_at": (np.asarray(points.beyond), "points from the mean of the outputs on, K"),
            "points_by_errors": (np.asarray(points.by_errors), "by the errors of the channels"),
            "points_by_rest": (gain @ to_duty, "at rest by a disturbance"),
            "output_by_rest": (np.asarray(rest.gain) @ to_duty, "outputs at rest alike"),
            "output_by_errors": (np.asarray(rest.of_channels), "and by the errors"),
            "unexplained": (np.asarray(watched.unexplained), "of what is missed of the channels"),
        }
        if soft.cost.is_quadratic:
            tables["by_point"] = gain * price / len(gain), "slope of the cost by the points, 1/K"
        else:
            constants |= {
                "BANDS": 1,
                "DEVIATION_PRICE": 2 * price,
                "WIDEST": MAX_BAND,
                "NARROWEST": MIN_BAND,
                "ADAPTATION": float(rest.adaptation),
                "ROOM_ON_THE_WAY": rest.room_on_the_way,
                "CENTRES_AT_REST": int(soft.cost.has_free_centre),
            }
            by_states = np.asarray(points.by_states)
            tables["points_by_states"] = by_states, "in the samples of the horizon, K"
            plan_sums.append(np.asarray(points.by_moves))
            ones = np.ones((len(gain), 1))
            rest_sums += [np.hstack([gain, -ones]), np.hstack([gain, ones])]
        if soft.cost.has_free_centre:
            constants["CENTRES"] = samples
    if plan_sums:
        accepted = np.asarray(soft.excess, float)
        tables |= {
            "plan_sums": (np.vstack(plan_sums), "limited temperatures and points by the moves, K"),
            "rest_sums": (np.vstack(rest_sums), "the same at rest"),
            "plan_softness": (accepted**2 * plan, "of each limited temperature, and of points"),
            "rest_softness": (accepted**2 * scale, "the same at rest"),
        }
    constants["SOFT_ROWS"] = sum(map(len, plan_sums))
    return ProgramNumbers(tables, constants)


def work_of(unknowns: int, limits: int, centres: int) -> dict[str, int]:
    """Returns the memory of the largest program, field of the state -> length.

    **Arguments:**

    - `unknowns`: the number of its unknowns.
    - `limits`: the number of its limits; a limit on both sides counts once.
    - `centres`: the number of the centres of its bands.
    """
    of_centres = {"pull": unknowns * centres, "total": centres} if centres else {}
    return {
        **of_centres,
        "slope": unknowns,
        "z": unknowns + centres,
        "dz": unknowns + centres,
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


def parameter_lines(mpc: "MPC", soft: SoftTemperatures) -> list[str]:
    """The parameters of an `MPC` with their units, a line for each."""
    rate = "none" if mpc.rate_limit is None else f"{mpc.rate_limit!r} 1/s"
    lines = [
        parameter_text("accepted deviations of the outputs", mpc.output_deviation, "K"),
        parameter_text("accepted deviations of the duty", mpc.duty_deviation, ""),
        parameter_text("accepted changes of the duty", mpc.duty_change_deviation, ""),
        f"limit of the rate of the duty: {rate}",
    ]
    for channel, (lowest, highest, excess) in mpc.temperature_limits:
        limits = f"{lowest!r} to {highest!r} degC, accepted excess {excess!r} K"
        lines.append(f"soft limits of {channel}: {limits}")
    if soft.cost is not None and soft.points is not None:
        price = (
            f", {soft.cost.energy_price!r} K for a unit of duty" if soft.cost.energy_price else ""
        )
        lines.append(f"even: {len(soft.points.at)} points, by their {soft.cost.name}{price}")
    if soft.has_bands:
        of_points = np.asarray(soft.excess)[-1]
        lines.append(parameter_text("accepted excess of points", of_points, "K"))
    return lines


def _scale(hessian: np.ndarray) -> float:
    """The number by which a quadratic program is divided."""
    return float(np.max(np.abs(np.diag(hessian))))


def mpc_law(mpc: "MPC", cells: int) -> Law:
    """Returns the law for a rig with `cells` cells.

    **Raises:** `ControlError` if the controller is one of another number of cells.
    """
    check_designed_cells(len(mpc.duty), cells)
    states = len(mpc.kalman.L)
    outputs, soft = len(mpc.outputs), mpc.soft_temperatures
    accepted = np.asarray(mpc.output_deviation, float)
    gain, inverse = np.asarray(mpc.gain, float), np.asarray(mpc.inverse, float)
    scaled, by_duty = rest_cost(gain, inverse, accepted, mpc.points is None)
    by_squares = squares_at_rest(soft)
    if by_squares is not None:
        by_duty = np.asarray(by_duty) + by_squares
    rest = RestCost(
        by_duty,
        -np.asarray(scaled).T / accepted,
        gain,
        mpc.kalman.disturbance_to_duty,
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
    tables = {**kalman_tables(mpc.kalman, mpc.model.operating_point), **numbers.tables}
    lines = parameter_lines(mpc, soft)
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
