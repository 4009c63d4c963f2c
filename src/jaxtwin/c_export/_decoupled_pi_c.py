r"""The law of a `DecoupledPI` as C: each pair of gains, for the mean and for the differences, is a
matrix $K_{mean} \frac{1}{n} + K_{diff} (I - \frac{1}{n})$ of the errors."""

import numpy as np
from jaxtyping import Float

from .._jax_settings import own_settings
from ..control import DecoupledPI
from ..control._controller import Numbers
from ..control._decoupled_pi import check_decoupling
from ..control._pid import tracking_share
from ._law import Law, of_cells, parameter_text


def decoupled_pi_law(controller: DecoupledPI, name: str, precision: str) -> Law:
    """Returns the law.

    **Raises:** `ControlError` if a gain is neither a single number nor one for each cell, or the
    decoupling of a controller that was changed in JAX is not invertible.
    """
    h, cells = controller.sample_time_s, len(controller.measured)
    with own_settings():
        of_mean = tracking_share(controller.Kp_mean, controller.Ki_mean, None, h)
        of_difference = tracking_share(controller.Kp_difference, controller.Ki_difference, None, h)
        back = _matrix("share", np.asarray(of_mean), np.asarray(of_difference), cells)
    D = np.asarray(controller.decoupling, float)
    check_decoupling("export_c", D, cells)
    undo = np.linalg.inv(D)
    b = of_cells("setpoint_weight", controller.setpoint_weight, cells)
    Kp = _matrix("Kp", controller.Kp_mean, controller.Kp_difference, cells)
    Ki = _matrix("Ki", controller.Ki_mean, controller.Ki_difference, cells)
    tables = {
        f"{name}_Kp": (Kp, "duty before the decoupling by the errors, 1/K"),
        f"{name}_b": (b, "set-point weight"),
        f"{name}_Ki_h": (Ki * h, "what a sample adds to the integral, 1/K"),
        f"{name}_D": (D, "decoupling"),
        f"{name}_undo": (undo, "its inverse"),
        f"{name}_back": (
            back @ undo,
            "what the limits cut off, out of the integral",
        ),
    }
    zero = "0.0f" if precision == "float" else "0.0"
    init = f"""    for (i = 0; i < {cells}; ++i) {{
        {precision} integral = {zero};
        int j;
        for (j = 0; j < {cells}; ++j) {{
            const {precision} y = measurement[j];
            integral += {name}_undo[i][j] * duty[j] - {name}_Kp[i][j] * ({name}_b[j] * y - y);
        }}
        state->integral[i] = integral;
    }}
"""
    step = f"""    {precision} asked[{cells}], cut[{cells}];
    int i, j;
    for (i = 0; i < {cells}; ++i) {{
        asked[i] = state->integral[i];
        for (j = 0; j < {cells}; ++j) {{
            asked[i] += {name}_Kp[i][j] * ({name}_b[j] * reference[j] - state->seen[j]);
        }}
    }}
    for (i = 0; i < {cells}; ++i) {{
        {precision} wanted = {zero};
        for (j = 0; j < {cells}; ++j) {{
            wanted += {name}_D[i][j] * asked[j];
        }}
        duty[i] = {name}_limited(wanted);
        cut[i] = duty[i] - wanted;
    }}
    for (i = 0; i < {cells}; ++i) {{
        {precision} change = {zero};
        for (j = 0; j < {cells}; ++j) {{
            change += {name}_Ki_h[i][j] * (reference[j] - state->seen[j]);
            change += {name}_back[i][j] * cut[j];
        }}
        {name}_integrate(state, i, change);
    }}
"""
    return Law(
        "a PI on the mean and the differences of the outputs",
        [
            parameter_text("Kp of the mean", controller.Kp_mean, "1/K"),
            parameter_text("Ki of the mean", controller.Ki_mean, "1/(K s)"),
            parameter_text("Kp of the differences", controller.Kp_difference, "1/K"),
            parameter_text("Ki of the differences", controller.Ki_difference, "1/(K s)"),
            parameter_text("set-point weight", controller.setpoint_weight, ""),
            parameter_text("decoupling", D, ""),
        ],
        cells,
        {},
        tables,
        init,
        step,
    )


def _matrix(
    name: str, mean: Numbers, difference: Numbers, cells: int
) -> Float[np.ndarray, "cells cells"]:
    """The matrix of the two gains, from the errors to the cells."""
    of_mean = np.full((cells, cells), 1 / cells)
    return of_cells(f"{name}_mean", mean, cells)[:, None] * of_mean + of_cells(
        f"{name}_difference", difference, cells
    )[:, None] * (np.eye(cells) - of_mean)
