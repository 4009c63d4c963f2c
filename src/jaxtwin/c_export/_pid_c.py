"""The law of a `PID` as C, with the factors of a sample multiplied beforehand."""

import numpy as np

from .._jax_settings import own_settings
from ..control import PID
from ..control._pid import tracking_share
from ._law import Law, of_cells, parameter_text


def pid_law(controller: PID, cells: int, outputs: int, name: str, precision: str) -> Law:
    """Returns the law, without the derivative if Kd is 0.

    **Raises:** `ControlError` if a gain is neither a single number nor one for each cell.
    """
    Kp, Ki, Kd, Tf = (
        of_cells(key, getattr(controller, key), cells) for key in ("Kp", "Ki", "Kd", "Tf")
    )
    b = of_cells("setpoint_weight", controller.setpoint_weight, cells)
    c = of_cells("derivative_weight", controller.derivative_weight, cells)
    tracking = controller.tracking_time_s
    if tracking is not None:
        tracking = of_cells("tracking_time_s", tracking, cells)
    h = controller.sample_time_s
    with own_settings():
        back = np.asarray(tracking_share(Kp, Ki, tracking, h), float)
    tables = {
        f"{name}_Kp": (Kp, "1/K"),
        f"{name}_b": (b, "set-point weight"),
        f"{name}_Ki_h": (Ki * h, "Ki times the sample time, 1/K"),
        f"{name}_back": (np.broadcast_to(back, (cells,)), "sample time / tracking time"),
    }
    fields = {}
    init = f"""        const {precision} y = measurement[{_output(outputs)}];
        state->integral[i] = duty[i] - {name}_Kp[i] * ({name}_b[i] * y - y);
"""
    derivative = part = ""
    if Kd.any():
        fields = {"derivative": cells, "last": cells}
        tables |= {
            f"{name}_c": (c, "set-point weight of the derivative"),
            f"{name}_decay": (Tf / (Tf + h), "of the derivative's filter"),
            f"{name}_Kd_h": (Kd / (Tf + h), "Kd / (Tf + sample time), 1/K"),
        }
        init += f"""        state->last[i] = {name}_c[i] * y - y;
        state->derivative[i] = {"0.0f" if precision == "float" else "0.0"};
"""
        derivative = f"""        const {precision} d = {name}_c[i] * r - y;
        const {precision} change = {name}_Kd_h[i] * (d - state->last[i]);
        const {precision} derivative = {name}_decay[i] * state->derivative[i] + change;
"""
        part = " + derivative"
    step = f"""    int i;
    for (i = 0; i < {cells}; ++i) {{
        const {precision} r = reference[{_output(outputs)}], y = state->seen[{_output(outputs)}];
{derivative}        const {precision} proportional = {name}_Kp[i] * ({name}_b[i] * r - y);
        const {precision} asked = proportional + state->integral[i]{part};
        duty[i] = {name}_limited(asked);
        {name}_integrate(state, i, {name}_Ki_h[i] * (r - y) + {name}_back[i] * (duty[i] - asked));
"""
    if Kd.any():
        step += """        state->derivative[i] = derivative;
        state->last[i] = d;
"""
    return Law(
        "a PID for each cell",
        [
            parameter_text("Kp", controller.Kp, "1/K"),
            parameter_text("Ki", controller.Ki, "1/(K s)"),
            parameter_text("Kd", controller.Kd, "s/K"),
            parameter_text("Tf", controller.Tf, "s"),
            parameter_text("set-point weight", controller.setpoint_weight, ""),
            parameter_text("set-point weight of the derivative", controller.derivative_weight, ""),
            "tracking time: Kp / Ki"
            if controller.tracking_time_s is None
            else parameter_text("tracking time", controller.tracking_time_s, "s"),
        ],
        cells,
        fields,
        tables,
        f"    for (i = 0; i < {cells}; ++i) {{\n{init}    }}\n",
        step + "    }\n",
    )


def _output(outputs: int) -> str:
    """The index of the output that cell i follows, as C."""
    return "i" if outputs > 1 else "0"
