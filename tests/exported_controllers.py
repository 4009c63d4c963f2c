"""Controllers of each kind, for their C."""

from functools import cache
from pathlib import Path
from typing import Any, Literal

from jaxtwin import Twin, linearize
from jaxtwin.c_export import CSources, export_c
from jaxtwin.control import (
    LQI,
    MPC,
    PID,
    AbstractController,
    DecoupledPI,
    RangeCost,
    SquaresCost,
    WorstPointCost,
    decoupling_of,
    design_lqi,
    design_mpc,
    design_uniformity_mpc,
)

LEFT, RIGHT = ["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]

CONTROLLERS = {
    "of the mean": PID(0.1, 0.001),
    "of each output": PID(
        [0.1, 0.08],
        [0.001, 0.002],
        [1.0, 0.5],
        [10.0, 0.0],
        setpoint_weight=[0.5, 1.0],
        derivative_weight=[0.0, 0.2],
        tracking_time_s=20.0,
        limits=(0, 0.9),
        measured=[LEFT, RIGHT],
    ),
    "clamped": PID(
        0.2, 0.004, 1.0, 5.0, measured=[LEFT, RIGHT], limits=(0, 0.6), anti_windup="clamping"
    ),
    "proportional": PID(0.05, Kd=1.0, measured=[LEFT], limits=(-0.5, 0.5)),
    "decoupled": DecoupledPI(
        0.1,
        0.001,
        0.2,
        0.002,
        measured=[LEFT, RIGHT],
        decoupling=decoupling_of([[60.0, 30.0], [20.0, 50.0]]),
        setpoint_weight=0.7,
        limits=(0, 1),
    ),
}

COSTS = {
    "plan of the range": RangeCost(),
    "plan of the worst point": WorstPointCost(energy_price=2.0),
    "plan of the squares": SquaresCost(energy_price=1.0),
}

KEYS = (
    *CONTROLLERS,
    *("state feedback", "state feedback of the mean", "plan", "plan of the mean"),
    *COSTS,
)


@cache
def controller_of(key: str) -> PID | DecoupledPI | LQI | MPC:
    if key in CONTROLLERS:
        return CONTROLLERS[key]
    linear = linearize(Twin("dual-cell"), duty=[0.4, 0.3])
    if key in COSTS:
        more: Any = {"temperature_limits": {"T11": (0, 40)}} if key == "plan of the range" else {}
        return design_uniformity_mpc(
            linear,
            evenness=COSTS[key],
            sample_time_s=1.0,
            horizon=8,
            control_horizon=3,
            limits=(0, 1),
            **more,
        )
    model = linear.reduce(4).discretise(1.0)
    measured = None if key.endswith("of the mean") else [LEFT, RIGHT]
    if key == "plan":
        limits = {"T11": (0, 40), "T16": (-20, 90)}
        return design_mpc(
            model,
            measured=measured,
            horizon=8,
            limits=(0, 1),
            rate_limit=0.05,
            temperature_limits=limits,
        )
    if key == "plan of the mean":
        return design_mpc(model, horizon=5, limits=(0, 0.6))
    return design_lqi(model, measured=measured, setpoint_weight=0.3, limits=(0, 1))


def c_of(
    controller: AbstractController,
    folder: Path,
    precision: Literal["double", "float"] = "double",
) -> CSources:
    return export_c(controller, folder, rig=Twin("dual-cell").rig, precision=precision)
