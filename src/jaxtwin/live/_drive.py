"""Drives a rig by a plan."""

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from ..errors import JaxtwinError
from ..io import Experiment, check_duty_of_rig
from ._operate import DutySource, Moment, operate
from ._service import RecordConsumer
from ._switch_off import Ending
from .protocol._rig_connection import RigConnection
from .safety._guard import Guard
from .safety._interlock import Finding


def drive(
    connection: RigConnection,
    guard: Guard,
    plan: Experiment,
    *,
    accept: bool = False,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    consumers: Sequence[RecordConsumer] = (),
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
    on_end: Callable[[Ending], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Applies a plan's duty to a live rig. It ends as `operate` does: with the cells off.

    **Arguments:**

    - `connection`: the links of the rig, started.
    - `guard`: the guard of this run, such as `Guard.of(twin)`; its twin may have the
      parameters of a fit.
    - `plan`: the experiment whose duty is applied, in the time of the rig: a recording, or a
      schedule (`Experiment.schedule`).
    - `accept`: whether the plan is driven although the twin says that the rig would exceed its
      limit, until an interlock stops it.
    - `reset`, `about`, `stop`, `consumers`, `on_progress`, `on_alarm`, `on_end`: as in `operate`.

    **Returns:** `"completed"`, or `"stopped"` if `stop` ended it.

    **Raises:** `SafetyStop` if an interlock trips, or the rig does not become ready;
    `JaxtwinError` if the plan is for another number of cells and heaters, a heater is to cool, it
    states an input that the rig does not have, or the rig would exceed its limit.
    """
    label = f"{connection.rig.name}: the plan {plan.name}".rstrip()
    check_duty_of_rig(plan, connection.rig, label, JaxtwinError)
    if not accept:
        guard.check_plan(plan)
    return operate(
        connection,
        guard,
        follow(plan),
        reset=reset,
        about=about,
        stop=stop,
        consumers=consumers,
        on_progress=on_progress,
        on_alarm=on_alarm,
        on_end=on_end,
    )


def follow(plan: Experiment) -> DutySource:
    """Makes a source of the duty of a plan at each time, until its end."""

    def duty(moment: Moment) -> np.ndarray | None:
        if moment.time >= plan.duration:
            return None
        held = np.searchsorted(plan.time, plan.time[0] + moment.time, side="right") - 1
        return plan.duty[held]

    return duty
