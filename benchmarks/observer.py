"""Do the forecasts of an observer hold on recordings that neither match nor noise have seen?

- `single-cell`, matched and with its noise estimated on the sessions 1 to 4: the other sessions.
- `dual-cell`, both on the first halves of the three steps: the second halves.
- The same on another day, at full power, from 300 s on.

A row has the root mean square error of what was expected, the same without the error that all
channels share, the part of the readings inside the 95 % bands, and the width of these; then times.

    python -m benchmarks.observer FOLDER_WITH_RECORDINGS
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import jax
import numpy as np

import jaxtwin as jt
from benchmarks._fitted import MATCHED, STEPS, fitted, single_cell_sessions
from benchmarks._machine import processor
from jaxtwin._jax_settings import own_settings
from jaxtwin.observers import ExtendedKalmanFilter, KalmanState

LEADS = (60.0, 300.0)

IN_TURN: dict[str, str | bool] = {
    "xla_cpu_enable_concurrency_optimized_scheduler": False,
    "xla_cpu_use_fusion_emitters": False,
}
"""Small operations are not handed to other threads, as in the programs of jaxtwin itself."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fits", type=Path, help="a folder that keeps fits and noise")
    given = parser.parse_args()
    folder = given.folder
    print(f"{processor()}\n")
    heads = "recordings", "ahead s", "RMSE K", "without common K", "inside %", "band K"
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    sessions = single_cell_sessions(folder)
    single, noise = fitted("single-cell", [sessions[n] for n in MATCHED], ("R_E",), given.fits)
    unseen = {n: one for n, one in sessions.items() if n not in MATCHED}
    for number, one in sorted(unseen.items()):
        judge(f"single-cell, session {number}", [jt.observe(single, one, noise)])
    steps = [jt.read_recording(folder / name) for name in STEPS]
    halves = [one.between(0, one.duration / 2) for one in steps]
    dual, of_halves = fitted("dual-cell", halves, (), given.fits)
    observed = [jt.observe(dual, one, of_halves) for one in steps]
    judge("dual-cell, second halves", observed, after=steps[0].duration / 2)
    day = jt.read_recording(folder / "other-day" / "peltierMIMOSecA1.mat")
    judge("dual-cell, another day", [jt.observe(dual, day, of_halves)], after=day.time[0] + 300)
    speed(jt.observe(dual, steps[0], of_halves))


def judge(name: str, several: Sequence[jt.observers.Observed], after: float = 0.0) -> None:
    """Prints the errors of the forecasts."""
    for lead in LEADS:
        forecasts = [one.ahead(lead).after(after) for one in several]
        errors = [one.residuals for one in forecasts]
        own = [one - np.nanmean(one, axis=1, keepdims=True) for one in errors]
        counts = [np.isfinite(one).sum() for one in errors]
        inside = np.average([one.coverage for one in forecasts], weights=counts)
        numbers = rms(errors), rms(own) if errors[0].shape[1] > 1 else np.nan, 100 * inside
        width = np.average([one.band_width for one in forecasts], weights=counts)
        cells = (f"{number:.3g}" for number in (lead, *numbers, width))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def rms(several: Sequence[np.ndarray]) -> float:
    """The root mean square over all of several arrays."""
    return float(np.sqrt(np.nanmean(np.concatenate([one.ravel() for one in several]) ** 2)))


def speed(observed: jt.observers.Observed) -> None:
    """Prints how long a step, a batch of steps, and a recording take."""
    observer = observed.observer
    with own_settings():
        given = observed.state, observed.samples.readings[-1], observed.samples.duty[-1]
        state, readings, duty = jax.device_put(given)
        one = jax.jit(partial(_step, observer), compiler_options=IN_TURN)
        steps = [seconds(lambda: one(state, duty, readings)) for _ in range(1000)]
        # Whose states fit into a processor's cache.
        many = jax.jit(
            lambda states: jax.lax.map(
                lambda state: _step(observer, state, duty, readings), states, batch_size=32
            )
        )
        batch = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (1000, *leaf.shape)), state)
        batched = min(seconds(lambda: many(batch)) for _ in range(4))
    size = len(state.mean)
    print(
        f"\nA step with {len(readings)} channels and {size} states: median "
        f"{1e3 * np.median(steps[10:]):.3f} ms, 99 % {1e3 * np.quantile(steps[10:], 0.99):.3f} ms"
    )
    print(f"A step of 1000 observers in a batch: {1e3 * batched:.1f} ms")
    again = partial(jt.observe, observed.observer.model.twin, observed.experiment)
    again(), observed.smooth()
    print(f"A recording of {len(observed.time)} samples: {seconds(again):.2f} s")
    print(
        f"60 s ahead of all of them: {seconds(lambda: observed.ahead(60.0)):.2f} s; "
        f"smoothed {seconds(observed.smooth):.2f} s"
    )


def _step(
    observer: ExtendedKalmanFilter,
    state: KalmanState,
    duty: jax.Array | np.ndarray,
    readings: jax.Array | np.ndarray,
) -> KalmanState:
    after = observer.step(state, duty, 1.0)
    return observer.correct(after, readings, jax.numpy.isfinite(readings), np.nan)


def seconds(work: Callable[[], object]) -> float:
    """The wall time of something, s."""
    start = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
