"""The numbers of an `MPC` in C: those of its quadratic programs, and its parameters in words.

The programs are scaled to a Hessian of about 1, as `_quadratic_program` does, but in C the scaled
numbers are constants.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ._condensed_program import Condensed, Deviations, SoftLimits
from ._law import Table, parameter_text
from ._quadratic_program import CENTERING, STEPS, TO_BOUNDARY


class ProgramNumbers(NamedTuple):
    """The tables and the constants of both programs, see `Law`."""

    tables: dict[str, Table]
    constants: dict[str, int | float]


def program_numbers(
    cost: Condensed,
    rest_hessian: Float[np.ndarray, "cells cells"],
    by_missing: Float[np.ndarray, "cells outputs"],
    soft: SoftLimits | None,
    inverse: Float[Array | np.ndarray, "cells outputs"],
) -> ProgramNumbers:
    """Computes the numbers of the plan and of the target at rest.

    **Arguments:**

    - `cost`, `soft`: the plan and its soft limits of temperatures.
    - `rest_hessian`, `by_missing`: the Hessian of the cost of a duty at rest, and the derivatives
      of its gradient with respect to the distance from the reference.
    - `inverse`: the smallest duty that changes the outputs at rest by 1 K.
    """
    hessian = np.asarray(cost.hessian, float)
    plan, rest = _scale(hessian), _scale(rest_hessian)
    cells = len(rest_hessian)
    # The last duty enters only the gradient of the first sample.
    by_last = np.asarray(cost.by_last_duty, float)[:cells]
    tables: dict[str, Table] = {
        "hessian": (hessian / plan, "of the plan's cost by the moves"),
        "by_states": (np.asarray(cost.by_states, float) / plan, "its slope by the states"),
        "by_last": (by_last / plan, "by the last duty, of the first sample"),
        "by_target": (np.asarray(cost.by_target, float) / plan, "and by the duty at rest"),
        "rest_hessian": (rest_hessian / rest, "of the cost of a duty at rest"),
        "by_missing": (by_missing / rest, "its slope by what is missing, 1/K"),
    }
    constants = {"STEPS": STEPS, "CENTERING": CENTERING, "TO_BOUNDARY": TO_BOUNDARY}
    if soft is not None:
        gain = np.asarray(soft.rest_gain)
        watched, excess = len(gain), float(soft.excess)
        tables |= {
            "soft_by_states": (np.asarray(soft.by_states), "limited temperatures, K"),
            "soft_by_moves": (np.asarray(soft.by_moves), "and by the moves, K"),
            "lowest": (np.asarray(soft.lowest)[:watched], "their limits, K"),
            "highest": (np.asarray(soft.highest)[:watched], "their limits, K"),
            "soft_at_rest": (gain, "limited temperatures at rest, K"),
            "soft_by_rest": (gain @ np.asarray(inverse), "and by a disturbance"),
            "watched_C": (np.asarray(soft.C), "limited temperatures by the states, K"),
            "watched_L": (np.asarray(soft.L), "of the correction of their errors by a reading"),
            "watched_at": (np.asarray(soft.outputs), "operating point, degC"),
        }
        constants |= {
            "WATCHED": watched,
            "PLAN_SOFTNESS": excess**2 * plan,
            "REST_SOFTNESS": excess**2 * rest,
        }
    return ProgramNumbers(tables, constants)


def work_of(unknowns: int, limits: int) -> dict[str, int]:
    """Returns the memory of the largest program, field of the state -> length.

    **Arguments:**

    - `unknowns`: the number of its unknowns.
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


def parameter_lines(
    deviations: Deviations,
    rate_limit: float | None,
    temperature_limits: Sequence[tuple[str, float, float]],
    soft: SoftLimits | None,
) -> list[str]:
    """The parameters of an `MPC` with their units, a line for each."""
    y, u, change = deviations
    lines = [
        parameter_text("accepted deviations of the outputs", y, "K"),
        parameter_text("accepted deviations of the duty", u, ""),
        parameter_text("accepted changes of the duty", change, ""),
        f"limit of the rate of the duty: {'none' if rate_limit is None else f'{rate_limit!r} 1/s'}",
    ]
    for channel, lowest, highest in temperature_limits:
        lines.append(f"soft limits of {channel}: {lowest!r} to {highest!r} degC")
    if soft is not None:
        lines.append(parameter_text("accepted excess", soft.excess, "K"))
    return lines


def _scale(hessian: np.ndarray) -> float:
    """The number by which a quadratic program is divided."""
    return float(np.max(np.abs(np.diag(hessian))))
