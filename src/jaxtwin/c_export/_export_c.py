"""Models and controllers as C99 sources for a microcontroller."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, final

from .._arguments import of_kind, path_of
from .._errors import ControlError
from .._whole_file import write_whole_file
from ..control import LQI, MPC, PID, DecoupledPI, DiscreteModel
from ..control._discrete_model import check_at_rest
from ..rig import Rig
from ..simulation import Stepper
from ._controller_c import controller_c
from ._discrete_model_c import discrete_model_c
from ._stepper_c import stepper_c

PRECISIONS = ("double", "float")


@final
@dataclass(frozen=True)
class CSources:
    """The files that `export_c` wrote, and their sizes.

    - `header`, `source`: the two files.
    - `coefficient_bytes`: the size of the constants. `state_bytes`: the size of the state's struct.
    """

    header: Path
    source: Path
    coefficient_bytes: int
    state_bytes: int


def export_c(
    model: DiscreteModel | Stepper | PID | DecoupledPI | LQI | MPC,
    folder: str | os.PathLike[str],
    *,
    rig: Rig | None = None,
    name: str = "model",
    precision: Literal["double", "float"] = "double",
    origin: str = "",
) -> CSources:
    """Writes a model, a twin or a controller as `name.h` and `name.c`: C99, no memory from the
    heap, no library but `math.h`, which a linear model does not need.

    All that changes is in a struct, so that several models run beside each other:

    ```c
    static model_state state;
    model_init(&state);                        /* at the operating point */
    for (;;) {                                 /* every MODEL_SAMPLE_TIME_S */
        model_output(&state, duty, temperatures);
        model_step(&state, duty);
    }
    ```

    Duty cycles go in as -1 to 1, temperatures come out in degC; the operating point is inside.
    With `float`, what a step adds to the state is computed instead of the new state, since the
    slow poles of a plate lie so near to 1 that `float` would round their time constants.

    A twin is written as its steps, nonlinear as they are; `model_nodes` gives the temperatures
    where no sensor is:

    ```python
    jt.export_c(jt.Stepper(twin, 1.0), "firmware", name="plate")
    ```

    A controller has two functions, as in Python. Without a measurement (NaN) it goes on with the
    last one, and after 3 s its duty is 0 until it is started anew, as in `simulate_closed_loop`:

    ```c
    pid_init(&state, duty, measurement);       /* without a bump */
    for (;;) {                                 /* every PID_SAMPLE_TIME_S */
        pid_step(&state, reference, measurement, duty);
    }
    ```

    An `MPC` also has `mpc_step_ahead`, which takes the references of the whole horizon. Its
    quadratic programs are solved by the steps of Python; their memory is part of the state.

    **Arguments:**

    - `model`: a model at sample times, from `LinearModel.discretise` (reduce it first where memory
      is short), a `Stepper` of a twin, or a controller.
    - `rig`: of a controller: its cells and channels. None: of a model or a twin, which know them.
    - `folder`: where to write; made where it does not exist. Files of these names are replaced.
    - `name`: of the files, and the beginning of all names in them.
    - `precision`: of all numbers.
    - `origin`: where the coefficients come from, a line for the header, such as the fit's file.

    **Returns:** the files and their sizes.

    **Raises:** `ControlError` for a model that is none or not finite, a controller that is not for
    the rig, a name or a precision that C does not have, or where the files cannot be written.
    """
    if re.fullmatch(r"[A-Za-z]\w*", str(name), flags=re.ASCII) is None:
        raise ControlError(
            f"export_c: name: expected letters, digits and _, beginning with a letter, got {name!r}"
        )
    if precision not in PRECISIONS:
        raise ControlError(f"export_c: precision: expected 'double' or 'float', got {precision!r}")
    target = path_of("export_c: folder", folder, ControlError)
    if isinstance(model, PID | DecoupledPI | LQI | MPC):
        of_rig = of_kind("export_c: rig", rig, Rig, "the controller's, as twin.rig", ControlError)
        code = controller_c(model, of_rig, name, precision, origin)
    else:
        if rig is not None:
            raise ControlError(f"export_c: rig: expected none beside a model, got {rig.name}")
        if isinstance(model, Stepper):
            code = stepper_c(model, name, precision, origin)
        else:
            expected = (
                "a DiscreteModel, as LinearModel.discretise makes it, a Stepper, a PID, a "
                "DecoupledPI, an LQI or an MPC"
            )
            of_kind("export_c: model", model, DiscreteModel, expected, ControlError)
            check_at_rest("export_c: model", model.offset)
            code = discrete_model_c(model, name, precision, origin)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise ControlError(
            f"export_c: folder: {target}: cannot be made: {problem.strerror or problem}"
        ) from None
    header, source = target / f"{name}.h", target / f"{name}.c"
    for file, text in ((header, code.header), (source, code.source)):
        write_whole_file(file, text.encode("ascii"), ControlError)
    size = 8 if precision == "double" else 4
    return CSources(header, source, code.coefficients * size, code.states * size)
