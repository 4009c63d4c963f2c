"""How many states does a linear model of `dual-cell` need, and how far is it from the twin?

    python -m benchmarks.reduced_orders

Two drives, from rest, a sample each second: the steps of the paper's recordings (both cells at a
duty of 0.50, from 500 s on at 0.78), and steps of 0.05 up and down about the operating point, which
is the mean duty of the recordings. Largest differences in any channel at any sample, K.
"""

from typing import Any

import numpy as np

import jaxtwin as jt

from ._measure import run_alone

LOW, HIGH, HALF, DURATION = 0.50, 0.78, 500, 1000
SMALL = 0.05
ORDERS = (2, 3, 4, 5, 6, 7, 8, 10)


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
    return answer


if __name__ == "__main__":
    run_alone(measure, __doc__)
