"""How many states does a model of `dual-cell` need, linear or not, and how far is it from the twin?

    python -m benchmarks.reduced_orders

Two drives, from rest, a sample each second: the steps of the paper's recordings (both cells at a
duty of 0.50, from 500 s on at 0.78), and steps of 0.05 up and down about the operating point, which
is the mean duty of the recordings. Largest differences in any channel at any sample, K.

The nonlinear twin is reduced in four ways: its slowest modes, without the others; its slowest
modes, with the others always at rest; and by `reduce_stepper`, with the drive of the recordings or
with random levels of each cell as the example. Their largest differences from the twin in all modes
are for the drive of the recordings, and for levels of each cell that no example has.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxtwin as jt
from jaxtwin.simulation import reduce_stepper
from jaxtwin.simulation._reduced_stepper import in_modes, projected
from jaxtwin.simulation._stepper import ModalState, advance, to_modal

from ._measure import run_alone

LOW, HIGH, HALF, DURATION = 0.50, 0.78, 500, 1000
SMALL = 0.05
ORDERS = (2, 3, 4, 5, 6, 7, 8, 10)
NONLINEAR = (5, 6, 8, 10, 11, 12, 14, 20)
AT_REST = 200.0
"""So many times as fast a mode follows that is meant to be always at rest."""


def measure(quick: bool = False) -> dict[str, Any]:
    """Differences of the reduced models from the whole one, and of this one from the twin, K."""
    twin = jt.Twin("dual-cell")
    time = np.arange(DURATION + 1.0)
    steps = np.tile(np.where(time < HALF, LOW, HIGH)[:, None], (1, 2))
    mean = (LOW + HIGH) / 2
    model = jt.linearize(twin, duty=mean)
    whole = model.discretise(1.0)
    linear = whole.simulate(steps, whole.start(0.0))
    answer: dict[str, Any] = {"states": len(model.A)}
    for order in ORDERS[2:4] if quick else ORDERS:
        reduced = model.reduce(order).discretise(1.0)
        found = reduced.simulate(steps, reduced.start(0.0))
        answer[f"{order} states, from the whole model"] = float(np.abs(found - linear).max())
    run = twin.simulate(jt.Experiment(time, steps))
    # From the temperatures of the run; lag and delay hold a duty of 0.
    start = np.full(len(whole.A), -mean)
    start[: len(model.A)] = run.states[0] - np.asarray(model.operating_point.nodes)
    from_twin = np.abs(whole.simulate(steps, start) - run.temperatures)
    answer["whole model from the twin, warm-up"] = float(from_twin[:HALF].max())
    answer["whole model from the twin, at the end"] = float(from_twin[-1].max())
    up_and_down = mean + SMALL * np.where((time // 250) % 2 == 0, 1.0, -1.0)
    small = np.tile(np.where(time < 1, mean, up_and_down)[:, None], (1, 2))
    moved = jt.simulate(twin, jt.Experiment(time, small), initial="steady").temperatures
    answer["small steps, channels move by"] = float(np.ptp(moved, axis=0).max())
    answer["small steps, whole model from the twin"] = float(
        np.abs(whole.simulate(small) - moved).max()
    )
    return answer | {"nonlinear": nonlinear(twin, steps[:-1], quick)}


def nonlinear(twin: jt.Twin, recorded: np.ndarray, quick: bool) -> list[dict[str, Any]]:
    """A row for each way and number of modes: the largest differences from all modes, K."""
    whole = jt.Stepper(twin, 1.0)
    unseen, example = (
        np.random.default_rng(seed).uniform(-0.3, 1.0, (60, 2)).repeat(60, axis=0)
        for seed in (1, 0)
    )
    drives = {"recordings": recorded, "unseen": unseen}
    expected = {name: channels(whole, duty) for name, duty in drives.items()}
    ways = {
        "slowest modes": lambda count: slowest(whole, count),
        "slowest modes, the others at rest": lambda count: others_at_rest(whole, count),
        "space of the recordings' drive": lambda count: reduce_stepper(whole, count, recorded),
        "space of random levels": lambda count: reduce_stepper(whole, count, example),
    }
    rows = []
    for way, made in ways.items():
        for count in NONLINEAR[:1] if quick else NONLINEAR:
            stepper = made(count)
            off = {
                name: float(np.abs(channels(stepper, duty) - expected[name]).max())
                for name, duty in drives.items()
            }
            rows.append({"way": way, "modes": count, **off})
    return rows


def slowest(stepper: jt.Stepper, count: int) -> jt.Stepper:
    """The twin in its slowest modes."""
    with jax.enable_x64(True):
        modes = stepper.field.modes
        basis = np.eye(modes.rates.size)[:, :count]
        return in_modes("slowest", stepper, projected(modes, stepper.plate, basis))


def others_at_rest(stepper: jt.Stepper, count: int) -> jt.Stepper:
    """The twin with all but the slowest modes at rest, nearly: they follow at once."""
    with jax.enable_x64(True):
        modes = stepper.field.modes
        faster = jnp.where(jnp.arange(modes.rates.size) < count, 1.0, AT_REST)
        plate = None if stepper.plate is None else stepper.plate * jnp.sqrt(faster)
        changed = eqx.tree_at(
            lambda m: (m.rates, m.shapes, m.sides, m.plate),
            modes,
            (
                modes.rates * faster,
                modes.shapes * jnp.sqrt(faster),
                modes.sides * jnp.sqrt(faster),
                plate,
            ),
            is_leaf=lambda leaf: leaf is None,
        )
        return in_modes("others_at_rest", stepper, changed)


def channels(stepper: jt.Stepper, duty: np.ndarray) -> np.ndarray:
    """The channels after each step from rest, degC."""
    with jax.enable_x64(True):
        return np.asarray(_channels(stepper, jnp.asarray(duty)))


@jax.jit
def _channels(stepper: jt.Stepper, duty: jax.Array) -> jax.Array:
    ambient = stepper.ambient

    def step(state: ModalState, command: jax.Array) -> tuple[ModalState, jax.Array]:
        later = advance(stepper, state, command, ambient)
        return later, later.amplitudes

    _, amplitudes = jax.lax.scan(step, to_modal(stepper, stepper.start()), duty)
    deviation = amplitudes @ stepper.field.modes.shapes.T
    return stepper.system.channel_temperatures(deviation, jnp.zeros_like(duty[:, :1])) + ambient


if __name__ == "__main__":
    run_alone(measure, __doc__)
