"""Models and controllers as C99 sources for a microcontroller."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, final

from .._arguments import of_kind, path_of
from .._whole_file import write_whole_file
from ..control import AbstractController, StateSpace, checked_discrete_model
from ..errors import ControlError
from ..observers import ExtendedKalmanFilter
from ..rig import Rig
from ..simulation import Stepper
from ._controller_c import controller_c
from ._discrete_model_c import discrete_model_c
from ._observer_c import observer_c
from ._stepper_c import stepper_c

PRECISIONS = ("double", "float")


@final
@dataclass(frozen=True)
class CSources:
    """The files that `export_c` wrote, and their sizes.

    - `header`: the file for those who call. `source`: the file to compile. `numbers`: the
      coefficients, which the source includes.
    - `coefficient_bytes`: the size of the constants. `state_bytes`: the size of the state's struct.
    """

    header: Path
    source: Path
    numbers: Path
    coefficient_bytes: int
    state_bytes: int


def export_c(
    model: StateSpace | Stepper | ExtendedKalmanFilter | AbstractController,
    folder: str | os.PathLike[str],
    *,
    rig: Rig | None = None,
    name: str = "model",
    precision: Literal["double", "float"] = "double",
    origin: str = "",
) -> CSources:
    """Writes a model, a twin, an observer or a controller as `name.h`, `name.c` and
    `name_numbers.h`, which `name.c` includes. The code is C99, allocates no memory, and needs no
    library but `math.h`, which a linear model does not need.

    The whole state is in a struct, so that several models can run beside each other:

    ```c
    static model_state state;
    model_init(&state);                        /* at the operating point */
    for (;;) {                                 /* every MODEL_SAMPLE_TIME_S */
        model_output(&state, duty, temperatures);
        model_step(&state, duty);
    }
    ```

    Duty cycles are -1 to 1, temperatures are in degC; the operating point is part of the code. A
    step computes the change of the state and adds it, because the slow poles of a plate lie so near
    to 1 that `float` would round their time constants.

    A twin is written with the nonlinear steps of `Stepper`; `model_nodes` returns the temperatures
    of all nodes, also of those without a sensor:

    ```python
    jt.export_c(jt.Stepper(twin, 1.0), "firmware", name="plate")
    ```

    An observer reads the channels, each of which may be missing (NaN), and estimates the nodes with
    their standard deviations:

    ```c
    rig_init(&state, reading, duty);           /* the mean of the first readings */
    for (;;) {                                 /* every RIG_SAMPLE_TIME_S */
        rig_correct(&state, readings, ambient);
        rig_nodes(&state, nodes);
        rig_predict(&state, duty);
    }
    ```

    A controller has two functions, as in Python. For a missing measurement (NaN) it uses the last
    one. After 3 s without a measurement its duty is 0 until it is initialised again, as in
    `simulate_closed_loop`:

    ```c
    pid_init(&state, duty, measurement);       /* without a bump */
    for (;;) {                                 /* every PID_SAMPLE_TIME_S */
        pid_step(&state, reference, measurement, duty);
    }
    ```

    An `MPC` also has `mpc_step_ahead`, which takes the references of the whole horizon. Its
    quadratic programs are solved by the algorithm that Python uses; their memory is part of the
    state.

    **Arguments:**

    - `model`: a model at sample times, from `StateSpace.discretise` (reduce it first if memory is
      short), a `Stepper` of a twin, an observer from `live_observer`, whose sample time is that of
      the code, or a controller whose class has a `law`.
    - `rig`: the rig of a controller, which determines its cells and channels. None for a model or a
      twin, which contain them.
    - `folder`: the folder of the files, which is made if it does not exist. Existing files of these
      names are replaced.
    - `name`: the name of the files, and the beginning of all names in them.
    - `precision`: the type of all numbers.
    - `origin`: the origin of the coefficients, such as the file of the fit, as a line for the
      header.

    **Returns:** the files and their sizes.

    **Raises:** `ControlError` if `model` is something else or is not finite, if a controller does
    not fit the rig, if C does not have the name or the precision, or if the files cannot be
    written.
    """
    if re.fullmatch(r"[A-Za-z]\w*", str(name), flags=re.ASCII) is None:
        raise ControlError(
            f"export_c: name: expected letters, digits and _, beginning with a letter, got {name!r}"
        )
    if precision not in PRECISIONS:
        raise ControlError(f"export_c: precision: expected 'double' or 'float', got {precision!r}")
    target = path_of("export_c: folder", folder, ControlError)
    if isinstance(model, AbstractController):
        of_rig = of_kind("export_c: rig", rig, Rig, "the controller's, as twin.rig", ControlError)
        code = controller_c(model, of_rig, name, precision, origin)
    else:
        if rig is not None:
            raise ControlError(f"export_c: rig: expected none beside a model, got {rig.name}")
        if isinstance(model, Stepper):
            code = stepper_c(model, name, precision, origin)
        elif isinstance(model, ExtendedKalmanFilter):
            code = observer_c(model, name, precision, origin)
        else:
            expected = (
                "a Stepper of a twin, jt.Stepper(twin, 1.0), a discrete model, as "
                "StateSpace.discretise makes it, an observer, or a controller such as a PID"
            )
            discrete = checked_discrete_model("export_c: model", model, expected)
            code = discrete_model_c(discrete, name, precision, origin)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise ControlError(
            f"export_c: folder: {target}: cannot be made: {problem.strerror or problem}"
        ) from None
    header, source = target / f"{name}.h", target / f"{name}.c"
    numbers = target / f"{name}_numbers.h"
    for file, text in ((numbers, code.numbers), (header, code.header), (source, code.source)):
        write_whole_file(file, text.encode("ascii"), ControlError)
    size = 8 if precision == "double" else 4
    return CSources(header, source, numbers, code.coefficients * size, code.states * size)
