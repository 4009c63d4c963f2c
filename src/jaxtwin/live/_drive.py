"""Drives a rig by a plan."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np

from .._errors import JaxtwinError
from ..io import Experiment
from ..physics import Twin
from ..rig import Rig
from ._bench import Bench
from ._operate import DutySource, Moment, operate
from ._trip import Trip


def drive(
    bench: Bench,
    rig: Rig | Twin,
    plan: Experiment,
    *,
    silence: float | int = 3.0,
    ambient: float | int | None = None,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Trip], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Applies a plan's duty to a live rig. The cells are off when it returns, also after an error.

    **Arguments:**

    - `bench`: the links of the rig, started.
    - `rig`: the rig, whose file must state `limits.temperature`; or its twin, for example with the
      parameters of a fit, for the interlocks that use the twin.
    - `plan`: the experiment whose duty is applied, in the time of the rig: a recording, or a
      schedule (`Experiment.schedule`).
    - `silence`, `ambient`, `reset`, `about`, `stop`, `on_progress`, `on_alarm`: as in `operate`.

    **Returns:** `"completed"`, or `"stopped"` if `stop` ended it.

    **Raises:** `SafetyStop` if an interlock trips, or the rig does not become ready;
    `JaxtwinError` if the rig file states no limit or the plan is for another number of cells.
    """
    twin = rig if isinstance(rig, Twin) else Twin(rig)
    cells = len(twin.rig.cells)
    if plan.n_cells != cells:
        raise JaxtwinError(
            f"{twin.rig.name}: expected a plan for {cells} cells, got one for {plan.n_cells}"
        )
    return operate(
        bench,
        twin,
        follow(plan),
        silence=silence,
        ambient=ambient,
        reset=reset,
        about=about,
        stop=stop,
        on_progress=on_progress,
        on_alarm=on_alarm,
    )


def follow(plan: Experiment) -> DutySource:
    """Makes a source of the duty of a plan at each time, until its end."""

    def duty(moment: Moment) -> np.ndarray | None:
        if moment.time >= plan.duration:
            return None
        held = np.searchsorted(plan.time, plan.time[0] + moment.time, side="right") - 1
        return plan.duty[held]

    return duty
