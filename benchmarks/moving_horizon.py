"""MovingHorizonEstimator: how long does a step take, and what do bounds tell it?

    python -m benchmarks.moving_horizon

On `dual-cell` with all 15 channels and the noise of its camera: a sample in 10 s, 30 samples in the
window, and heats into the plate at the cells that nothing announces, but that are known not to be
negative. do-mpc estimates the same with collocation and IPOPT, without the driver's delay.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxtwin as jt
from jaxtwin.observers import (
    ExtendedKalmanFilter,
    MovingHorizonEstimator,
    ProcessNoise,
    StateBounds,
    live_observer,
)
from jaxtwin.simulation import Stepper

from ._do_mpc_estimator import DoMPCEstimator
from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

NO_DELAY = {"t_delay": 1e-6}
SAMPLE_TIME = 10.0
HORIZON = 30
SAMPLES = 120
HEAT = 5.0
"""Into the node that the first cell heats in the second half, W; none in the first half."""

FAINT = 1e-6
NOISE = ProcessNoise(
    reading=0.3, disturbance=3.0, disturbance_time=600.0, room=FAINT, heat=FAINT,
    command_time=FAINT, reading_time=FAINT, common=FAINT, jump=FAINT, channel=FAINT,
)  # fmt: skip
"""White noise of readings, and heats. What is faint is no part of do-mpc's problem."""

POSITIVE = StateBounds(heat=(0.0, None))


class Recorded(NamedTuple):
    """A run: what an observer gets, and what it is to find."""

    duty: Float[np.ndarray, "samples cells"]
    readings: Float[np.ndarray, "samples channels"]
    nodes: Float[np.ndarray, "samples nodes"]
    heats: Float[np.ndarray, "samples cells"]


def recorded(twin: jt.Twin) -> Recorded:
    """A run of twenty minutes with random levels of the duty."""
    stepper = Stepper(twin, 1.0)
    random = np.random.default_rng(0)
    duty = random.uniform(0.2, 0.8, (SAMPLES // 10, 2)).repeat(10, axis=0)
    heats = np.zeros((SAMPLES, 2))
    heats[SAMPLES // 2 :, 0] = HEAT
    state, readings, nodes = stepper.start(), [], []
    for command, heat in zip(duty, heats, strict=True):
        into = np.zeros(len(np.asarray(stepper.system.capacitance)))
        into[np.asarray(stepper.system.wiring.cold)] = heat
        state = stepper.step(state, command, steps=int(SAMPLE_TIME), heat=into)
        readings.append(np.asarray(stepper.channels(state)))
        nodes.append(np.asarray(state.nodes))
    seen = np.array(readings)
    seen = seen + random.normal(0.0, float(np.asarray(NOISE.reading)), seen.shape)
    return Recorded(duty, seen, np.array(nodes), heats)


def observers(twin: jt.Twin) -> dict[str, ExtendedKalmanFilter | MovingHorizonEstimator]:
    """The observers, all with the same twin and noise, and a room that is known."""
    kalman = live_observer(twin, NOISE, SAMPLE_TIME)
    kalman = eqx.tree_at(lambda k: k.model.room_spread, kalman, np.asarray(FAINT))
    return {
        "extended Kalman filter": kalman,
        "MovingHorizonEstimator, no bounds": MovingHorizonEstimator(kalman, HORIZON),
        "MovingHorizonEstimator": MovingHorizonEstimator(kalman, HORIZON, POSITIVE),
        "MovingHorizonEstimator, 3 iterations": MovingHorizonEstimator(
            kalman, HORIZON, POSITIVE, iterations=3
        ),
    }


@jax.jit
def sample(observer: Any, state: Any, duty: Array, readings: Array) -> Any:
    """A sample of an observer: state, nodes and heats."""
    state = observer.predict(state, duty, jnp.nan, SAMPLE_TIME)
    state = observer.update(state, readings, jnp.ones(len(readings), bool), jnp.nan)
    latest = state.latest if isinstance(observer, MovingHorizonEstimator) else state
    return state, observer.nodes(state), latest.mean[observer.model.layout.of("heats")]


def measured() -> list[dict[str, Any]]:
    """Errors and times of all ways, sample by sample in turn."""
    twin = jt.Twin("dual-cell").with_values(NO_DELAY)
    run = recorded(twin)
    start = np.full(run.nodes.shape[1], float(twin.values["T_amb"]))
    ways: dict[str, Callable[[int], tuple[np.ndarray, np.ndarray]]] = {}
    first: dict[str, float] = {}
    for name, observer in observers(twin).items():
        held = jax.tree.map(jnp.asarray, observer)
        states = {"now": held.init(start, np.zeros(2))}

        def step(k: int, held: Any = held, states: dict[str, Any] = states) -> Any:
            states["now"], *found = jax.block_until_ready(
                sample(held, states["now"], run.duty[k], run.readings[k])
            )
            return tuple(np.asarray(part) for part in found)

        began = time.perf_counter()
        jax.block_until_ready(sample(held, states["now"], run.duty[0], run.readings[0]))
        first[name] = time.perf_counter() - began
        ways[name] = step
    began = time.perf_counter()
    peer = DoMPCEstimator(twin, NOISE, SAMPLE_TIME, HORIZON, 0.0)
    peer.start(start)
    first["do-mpc"] = time.perf_counter() - began
    ways["do-mpc"] = lambda k: peer.step(run.readings[k], run.duty[k])
    nodes: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    heats: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for k in range(SAMPLES):
        for name, way in ways.items():
            wall, cpu = time.perf_counter(), time.process_time()
            one, other = way(k)
            taken[name].append((time.perf_counter() - wall, time.process_time() - cpu))
            nodes[name].append(one)
            heats[name].append(other)
    answer = []
    for name in ways:
        wall, cpu = 1e3 * np.median(np.array(taken[name])[HORIZON:], axis=0)
        off = np.array(heats[name]) - run.heats
        answer.append(
            {
                "way": name,
                "cpu_ms": float(cpu),
                "wall_ms": float(wall),
                "first_s": first[name],
                "heat_before": root_mean_square(off[HORIZON : SAMPLES // 2]),
                "heat_after": root_mean_square(off[SAMPLES // 2 + HORIZON :]),
                "nodes": root_mean_square((np.array(nodes[name]) - run.nodes)[HORIZON:]),
                "lowest": float(np.array(heats[name]).min()),
            }
        )
    return answer


def root_mean_square(off: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean(off**2)))


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where, rows = answer["machine"], answer["measured"]
    versions = where["versions"]
    cpu = {row["way"]: row["cpu_ms"] for row in rows}
    text = (
        f"# MovingHorizonEstimator, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; do-mpc {versions['do-mpc']}, casadi {versions['casadi']} "
        "(IPOPT with MUMPS); `python -m benchmarks.moving_horizon`. `dual-cell`, 15 channels with "
        f"noise of 0.3 K, {SAMPLES} samples of 10 s, {HORIZON} of them in the window. A heat of "
        f"{HEAT:g} W comes into the plate at cell 1 in the second half; that heats are not "
        "negative all are told but the first two. Heats off: root mean square over both cells "
        "from the 30th sample on, in the first half, and in the second without its first 30. "
        "Nodes: all temperatures from the 30th sample on. do-mpc has no driver's delay and the "
        "arrival cost of the start throughout; its first call is its setup, those of the others "
        f"are compilation. do-mpc takes **{cpu['do-mpc'] / cpu['MovingHorizonEstimator']:.0f} "
        "times** as long by CPU time.\n\n"
    )
    head = (
        "way", "CPU time, ms", "by the clock, ms", "first, s", "heats off, first half, W",
        "second half, W", "nodes off, K", "lowest heat, W",
    )  # fmt: skip
    return text + table(
        head,
        [
            (
                row["way"],
                f"{row['cpu_ms']:.1f}",
                f"{row['wall_ms']:.1f}",
                f"{row['first_s']:.1f}",
                f"{row['heat_before']:.2f}",
                f"{row['heat_after']:.2f}",
                f"{row['nodes']:.3f}",
                f"{row['lowest']:.2f}",
            )
            for row in rows
        ],
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    options = parser.parse_args()
    answer: dict[str, Any] = {"machine": machine()}
    with jax.enable_x64(True):
        answer["measured"] = measured()
    write_results(options.out / "moving_horizon.json", answer, page(answer))


if __name__ == "__main__":
    main()
