"""The law of an `LQI` as C, with its Kalman filter. The change of the estimated states in a sample,
$(A - I) x$, is computed and added, because slow poles lie near 1."""

import numpy as np

from .._errors import ControlError
from ..control import LQI
from ._law import Law, of_cells, parameter_text
from ._text import number


def lqi_law(controller: LQI, cells: int, name: str, precision: str) -> Law:
    """Returns the law.

    **Raises:** `ControlError` if it was designed for another number of cells.
    """
    kalman, h = controller.kalman, controller.sample_time_s
    A, B, C, L = (np.asarray(m, float) for m in (kalman.A, kalman.B, kalman.C, kalman.L))
    Kx, Ki, Kt, N = (
        np.asarray(m, float) for m in (controller.Kx, controller.Ki, controller.Kt, controller.N)
    )
    if len(Ki) != cells:
        raise ControlError(
            f"export_c: model: expected a controller of the rig's {cells} cells, got one of "
            f"{len(Ki)}"
        )
    (states, outputs), fed_back = L.shape, Kx.shape[1]
    b = of_cells("setpoint_weight", controller.setpoint_weight, cells)
    tables = {
        f"{name}_A": (A - np.eye(states), "of the filter: what a sample adds by the states"),
        f"{name}_B": (B, "and by the duty"),
        f"{name}_C": (C, "its outputs, K"),
        f"{name}_L": (L, "of its correction by a reading"),
        f"{name}_Kx": (Kx, "duty by the states"),
        f"{name}_Ki": (Ki, "duty by the integrals, 1/(K s)"),
        f"{name}_Kt": (Kt, "what the limits cut off, out of the integrals, K s"),
        f"{name}_bN": (b[:, None] * N, "duty by the references at once, 1/K"),
        f"{name}_by_duty": (np.asarray(kalman.by_duty, float), "states at rest by the duty"),
        f"{name}_by_rest": (np.asarray(kalman.by_disturbance, float), "and by a disturbance, 1/K"),
        f"{name}_duty": (np.asarray(controller.duty, float), "operating point, -1 to 1"),
        f"{name}_at": (np.asarray(controller.outputs, float), "operating point, degC"),
    }
    zero = "0.0f" if precision == "float" else "0.0"

    def rows(count: int, target: str, start: str, *terms: tuple[str, str, int, str]) -> str:
        """A loop over `i` that sets a target to the sum of a start and of terms, each of which is a
        sign, a table, a length and a vector with the index `j`."""
        sums = "".join(
            f"        for (j = 0; j < {length}; ++j) {{\n"
            f"            {target.split()[-1]} {sign}= {name}_{table}[i][j] * {vector};\n"
            "        }\n"
            for sign, table, length, vector in terms
        )
        return f"    for (i = 0; i < {count}; ++i) {{\n        {target} = {start};\n{sums}    }}\n"

    x, q = "state->x", "state->integral"
    away = f"(duty[j] - {name}_duty[j])"
    init = "".join(
        [
            rows(states, f"{x}[i]", zero, ("+", "by_duty", cells, away)),
            rows(outputs, "y[i]", f"measurement[i] - {name}_at[i]", ("-", "C", states, f"{x}[j]")),
            rows(states, f"{x}[i]", f"{x}[i]", ("+", "by_rest", outputs, "y[j]")),
            rows(
                cells,
                "state->duty_offset[i]",
                f"duty[i] - {name}_duty[i]",
                ("-", "bN", outputs, f"(measurement[j] - {name}_at[j])"),
                ("+", "Kx", fed_back, f"{x}[j]"),
            ),
            rows(outputs, f"{q}[i]", zero, ("+", "Kt", cells, "state->duty_offset[j]")),
            rows(
                cells,
                "state->duty_offset[i]",
                "state->duty_offset[i]",
                ("-", "Ki", outputs, f"{q}[j]"),
            ),
        ]
    )
    init = f"    {{\n    {precision} y[{outputs}];\n    int j;\n{init}    }}\n"
    h_e = f"{number(h, precision)} * (reference[i] - state->seen[i])"
    more = rows(outputs, "change[i]", h_e, ("+", "Kt", cells, "(duty[j] - asked[j])"))
    step = "".join(
        [
            f"    {precision} y[{outputs}], asked[{cells}], change[{states}];\n    int i, j;\n",
            rows(outputs, "y[i]", f"state->seen[i] - {name}_at[i]", ("-", "C", states, f"{x}[j]")),
            rows(states, f"{x}[i]", f"{x}[i]", ("+", "L", outputs, "y[j]")),
            rows(
                cells,
                "asked[i]",
                f"{name}_duty[i] + state->duty_offset[i]",
                ("+", "bN", outputs, f"(reference[j] - {name}_at[j])"),
                ("-", "Kx", fed_back, f"{x}[j]"),
                ("+", "Ki", outputs, f"{q}[j]"),
            ),
            rows(cells, "duty[i]", f"{name}_limited(asked[i])"),
            more,
            f"    for (i = 0; i < {outputs}; ++i) {{\n",
            f"        {name}_integrate(state, i, change[i]);\n    }}\n",
            rows(states, "change[i]", zero, ("+", "A", states, f"{x}[j]"), ("+", "B", cells, away)),
            rows(states, f"{x}[i]", f"{x}[i] + change[i]"),
        ]
    )
    return Law(
        f"state feedback with {outputs} integrals and a Kalman filter",
        [
            parameter_text("Kx", Kx, "1/K and 1"),
            parameter_text("Ki", Ki, "1/(K s)"),
            parameter_text("set-point weight", controller.setpoint_weight, ""),
        ],
        outputs,
        {"x": states, "duty_offset": cells},
        tables,
        init,
        step,
    )
