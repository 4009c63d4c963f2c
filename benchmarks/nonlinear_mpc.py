"""NonlinearMPC: does it find IPOPT's optimum, how long does a step take, and what is it good for?

    python -m benchmarks.nonlinear_mpc

On `dual-cell` with two outputs, over 30 samples of 10 s. do-mpc solves the same problem by
collocation and IPOPT, without the driver's delay, which is left out where optima are compared.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxtwin as jt
from jaxtwin.control import MPC, NonlinearMPC
from jaxtwin.control.controllers._multiple_shooting import after_interval, as_state

from ._do_mpc import DoMPC
from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

OUTPUTS = ["TAM", "TCM"]
NO_DELAY = {"t_delay": 1e-6}
REFERENCES = np.array([[40.0, 45.0], [60.0, 58.0]])
"""Of the problems whose optima are compared, from a plate at the temperature of the room."""

SAMPLES = 30
"""Of the loops in which steps are timed."""

TIMED = np.array([40.0, 45.0])


class Loop(NamedTuple):
    """A loop with noise, and what is asked of its controller."""

    references: str
    duration: float
    limits: tuple[float, float]
    temperature_limits: dict[str, tuple[float, float]] | None
    designed: tuple[float, ...]
    """The temperatures at which linear models are designed, degC."""


LOOPS = {
    "room to 40 degC": Loop("0:40", 900.0, (0.0, 1.0), None, (40.0, 60.0)),
    "room to 60 degC": Loop("0:60", 900.0, (0.0, 1.0), None, (40.0, 60.0)),
    "40 degC to 10 degC, cooling": Loop("0:40,600:10", 1500.0, (-1.0, 1.0), None, (40.0, 10.0)),
    "the same, TAM and TCM limited to 9.7 degC and more": Loop(
        "0:40,600:10", 1500.0, (-1.0, 1.0), dict.fromkeys(OUTPUTS, (9.7, 80.0)), (40.0, 10.0)
    ),
}


def step_of(controller: NonlinearMPC | MPC) -> Callable[..., Any]:
    """A compiled step: state, reference, measurement -> duty, state."""
    held = jax.tree.map(jnp.asarray, controller)
    compiled = jax.jit(lambda held, *arguments: held.step(*arguments))
    return lambda *arguments: jax.block_until_ready(compiled(held, *arguments))


@jax.jit
def follow(controller: NonlinearMPC, state: Array, duty: Array) -> Array:
    """The state of the twin a sample later."""
    none = jnp.zeros(len(controller.nodes))
    return after_interval(controller.stepper, controller.steps, state, duty, none)


@jax.jit
def reading(controller: NonlinearMPC, state: Array) -> tuple[Array, Array, Array]:
    """The outputs in a state, the temperatures of the nodes, degC, and the duty in the cells."""
    seen = as_state(controller.stepper, state)
    nodes = controller.stepper.field.modes.shapes @ seen.amplitudes + controller.stepper.ambient
    rises = nodes - jnp.asarray(controller.nodes)
    return jnp.asarray(controller.at) + controller.readings @ rises, nodes, seen.duty


def outputs_of(
    controller: NonlinearMPC, start: Array, plan: Float[np.ndarray, "samples cells"]
) -> Float[np.ndarray, "samples outputs"]:
    """The outputs of the twin under a plan, degC, step by step."""
    rows, state = [], start
    for duty in plan:
        state = follow(controller, state, duty)
        rows.append(reading(controller, state)[0])
    return np.array(rows)


def cost_of(
    controller: NonlinearMPC,
    start: Array,
    plan: Float[np.ndarray, "samples cells"],
    references: Float[np.ndarray, " outputs"],
) -> float:
    """The cost of a plan from rest with idle cells, by the twin."""
    errors = outputs_of(controller, start, plan) - references
    changes = np.diff(plan, axis=0, prepend=0)
    by_changes = changes / controller.duty_change_deviation
    return float(np.sum((errors / controller.output_deviation) ** 2) + np.sum(by_changes**2))


def optima() -> list[dict[str, Any]]:
    """The plans of both from the temperature of the room."""
    twin = jt.Twin("dual-cell").with_values(NO_DELAY)
    room = np.full(2, float(twin.values["T_amb"]))
    answer = []
    for references in REFERENCES:
        given: dict[str, Any] = {"measured": OUTPUTS, "limits": (0, 1)}
        ours = {n: NonlinearMPC(twin, iterations=n, **given) for n in (1, 3, 12)}
        state = ours[12].init(np.zeros(2), room)
        found = {n: step_of(one)(state, references, room) for n, one in ours.items()}
        plans = {n: np.vstack([duty, later.path.duty[:-1]]) for n, (duty, later) in found.items()}
        for degree in (2, 4):
            peer = DoMPC(twin, ours[1], OUTPUTS, references, degree)
            at = peer.state(np.full(peer.network.nodes, room[0]), np.zeros(2))
            peer.start(at, np.zeros(2))
            peer.step(at)
            plans[f"IPOPT, degree {degree}"] = np.clip(peer.plan(), 0, 1)
        best = plans["IPOPT, degree 4"]
        costs = {
            n: cost_of(ours[12], state.estimate, plan, references) for n, plan in plans.items()
        }
        for name, plan in plans.items():
            answer.append(
                {
                    "references": "/".join(f"{value:g}" for value in references),
                    "way": f"NonlinearMPC, iterations: {name}" if isinstance(name, int) else name,
                    "first": np.asarray(plan[0]).tolist(),
                    "first_off": float(np.abs(plan[0] - best[0]).max()),
                    "plan_off": float(np.abs(plan - best).max()),
                    "cost": costs[name],
                    "cost_above": costs[name] / costs["IPOPT, degree 4"] - 1,
                }
            )
    return answer


def times() -> dict[str, dict[str, float]]:
    """Seconds and CPU seconds of a step, in loops that start at the temperature of the room; the
    steps of all ways in turn. do-mpc is spared the driver's delay."""
    twin = jt.Twin("dual-cell")
    room = np.full(2, float(twin.values["T_amb"]))
    began = time.perf_counter()
    controller = NonlinearMPC(twin, measured=OUTPUTS, limits=(0, 1))
    design = time.perf_counter() - began
    model = jt.linearize(twin, temperatures=dict.fromkeys(OUTPUTS, 40.0)).reduce(6).discretise(10.0)
    given: dict[str, Any] = {"measured": OUTPUTS, "limits": (0, 1)}
    ways = {
        "NonlinearMPC": controller,
        "NonlinearMPC, 3 iterations": NonlinearMPC(twin, iterations=3, **given),
        "MPC of 6 states": MPC(model, horizon=30, **given),
    }
    states = {name: way.init(np.zeros(2), room) for name, way in ways.items()}
    steps, first = {}, {}
    for name, way in ways.items():
        steps[name] = step_of(way)
        began = time.perf_counter()
        steps[name](states[name], TIMED, room)
        first[name] = time.perf_counter() - began
    began = time.perf_counter()
    peer = DoMPC(twin, controller, OUTPUTS, TIMED)
    first["do-mpc"] = time.perf_counter() - began
    plant = states["NonlinearMPC"].estimate
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in [*ways, "do-mpc"]}

    def timed(name: str, call: Callable[[], Any]) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        result = call()
        taken[name].append((time.perf_counter() - wall, time.process_time() - cpu))
        return result

    for sample in range(SAMPLES):
        measured, nodes, reached = map(np.asarray, reading(controller, plant))
        at = peer.state(nodes, reached)
        if sample == 0:
            peer.start(at, np.zeros(2))
        timed("do-mpc", lambda at=at: peer.step(at))
        duty = np.zeros(2)
        for name in reversed(ways):
            duty, states[name] = timed(
                name, lambda n=name, y=measured: steps[n](states[n], TIMED, y)
            )
        plant = follow(controller, plant, duty)
    answer = {}
    for name, rows in taken.items():
        wall, cpu = np.array(rows).T
        answer[name] = {
            "first_s": first[name],
            "wall_ms": 1e3 * float(np.median(wall)),
            "least_ms": 1e3 * float(wall.min()),
            "cpu_ms": 1e3 * float(np.median(cpu)),
        }
    answer["NonlinearMPC"]["design_s"] = design
    return answer


def loops() -> list[dict[str, Any]]:
    """Large steps, with the noise of the camera, by the nonlinear and by linear controllers with
    the same weights."""
    twin = jt.Twin("dual-cell")
    answer = []
    for name, loop in LOOPS.items():
        given: dict[str, Any] = {
            "measured": OUTPUTS,
            "limits": loop.limits,
            "temperature_limits": loop.temperature_limits,
            "horizon": 30,
        }
        ways: dict[str, Any] = {"NonlinearMPC": NonlinearMPC(twin, **given)}
        for at in loop.designed:
            model = jt.linearize(twin, temperatures=dict.fromkeys(OUTPUTS, at)).reduce(6)
            ways[f"MPC of {at:g} degC"] = MPC(model.discretise(10.0), duty_deviation=1e3, **given)
        for way, controller in ways.items():
            run = jt.simulate_closed_loop(
                twin, controller, loop.references, duration=loop.duration, initial=16.0
            )
            measured = run.measures()["value"]
            row = {"loop": name, "controller": way, "lowest": float(run.output.min())}
            for key in ("settling_time", "overshoot", "integral_absolute_error", "total_variation"):
                row[key] = float(measured[key])
            after = run.time > run.time[-1] - 800
            row["lowest"] = float(run.output[after].min())
            answer.append(row)
    return answer


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where, found = answer["machine"], answer["times"]
    versions = where["versions"]
    text = (
        f"# NonlinearMPC, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; do-mpc {versions['do-mpc']}, casadi {versions['casadi']} "
        "(IPOPT with MUMPS); `python -m benchmarks.nonlinear_mpc`. `dual-cell`, outputs TAM and "
        "TCM, 30 samples of 10 s, the duty free in each of them: 60 unknowns.\n\n"
        "## The optimum\n\n"
        "From the room, without the driver's delay, against IPOPT on a collocation of degree 4. "
        "do-mpc's default degree is 2. All start without a plan, from idle cells: one iteration is "
        "what the first sample of a loop gets. Costs are those of the plans on the twin, step by "
        "step.\n\n"
    )
    text += table(
        ("references, degC", "way", "first move", "off", "whole plan off", "cost", "above IPOPT's"),
        [
            (
                row["references"],
                row["way"],
                "/".join(f"{duty:.5f}" for duty in row["first"]),
                f"{row['first_off']:.1e}",
                f"{row['plan_off']:.1e}",
                f"{row['cost']:.4f}",
                f"{row['cost_above']:.1e}",
            )
            for row in answer["optima"]
        ],
    )
    peer, ours = found["do-mpc"], found["NonlinearMPC"]
    text += (
        f"\n## The time of a step\n\nMedians of {SAMPLES} samples of a loop, all ways in turn in "
        "the same process; each starts from its own last plan, and do-mpc is spared the driver's "
        "delay. First: the first call of a step, "
        "compilation included (do-mpc: its setup). The design of the NonlinearMPC took "
        f"{ours['design_s']:.1f} s before. do-mpc takes **{peer['cpu_ms'] / ours['cpu_ms']:.0f} "
        f"times** as long by CPU time, {peer['wall_ms'] / ours['wall_ms']:.0f} times by the "
        "clock.\n\n"
    )
    text += table(
        ("way", "CPU time, ms", "by the clock, ms", "least by the clock, ms", "first, s"),
        [
            (
                name,
                f"{row['cpu_ms']:.2f}",
                f"{row['wall_ms']:.2f}",
                f"{row['least_ms']:.2f}",
                f"{row['first_s']:.1f}",
            )
            for name, row in found.items()
        ],
    )
    text += (
        "\n## Large steps\n\nWith the camera's noise and the driver's delay. The linear "
        "controllers have the same outputs, horizon, sample time and weights, and a linear model "
        "of 6 states at the temperature of their name. Lowest: of both outputs, in the last 800 "
        "s.\n\n"
    )
    head = (
        "loop", "controller", "settled, s", "overshoot, K", "integral of the error, K s",
        "variation of the duty", "lowest, degC",
    )  # fmt: skip
    rows = [
        (
            row["loop"],
            row["controller"],
            f"{row['settling_time']:.0f}",
            f"{row['overshoot']:.2f}",
            f"{row['integral_absolute_error']:.0f}",
            f"{row['total_variation']:.2f}",
            f"{row['lowest']:.2f}",
        )
        for row in answer["loops"]
    ]
    return text + table(head, rows)


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    options = parser.parse_args()
    answer: dict[str, Any] = {"machine": machine()}
    with jax.enable_x64(True):
        answer["times"], answer["optima"] = times(), optima()
    answer["loops"] = loops()
    write_results(options.out / "nonlinear_mpc.json", answer, page(answer))


if __name__ == "__main__":
    main()
