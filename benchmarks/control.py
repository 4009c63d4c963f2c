"""How evenly and how fast do controllers take the plate of `dual-cell` from 16 to 40 degC?

    JAXTWIN_RECORDINGS=folder python -m benchmarks.control --draws 1000

The rig is matched to the authors' recordings. The reference is 40 degC for the mean of all
channels. Controllers with two outputs get the readings of both halves of the plate at the most even
steady state with this mean. Each controller runs on the matched twin and on draws of what the match
leaves open. Its gains are those for the matched twin, but those of a second decoupled PI are tuned
over other draws of the match.
"""

import argparse
import os
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxtwin as jt
from jaxtwin import ControlError
from jaxtwin.control import (
    LQI,
    MEASURES,
    MPC,
    PID,
    ClosedLoop,
    DecoupledPI,
    OperatingPoint,
    decoupling_of,
    most_even_point,
)
from jaxtwin.matching import posterior_draws

from ._machine import machine
from ._results import write_results
from ._tables import table

START, REFERENCE, DURATION = 16.0, 40.0, 1500.0
LEFT = ["T11", "T12", "T13", "T21", "T22", "T23", "TAM"]
RIGHT = ["T14", "T15", "T16", "T24", "T25", "T26", "TCM"]
SETTLED = 0.5
LIMITS = (0.0, 1.0)
ROOM = (0.0, 0.95)
"""Of the duty at the references, so that a controller can still move."""

TUNED, TAIL_WEIGHT = 64, 0.5
"""Number of draws over which a controller is tuned, and the weight of the worst 5 % of them."""

QUANTILES = (0.05, 0.5, 0.95)
FEWER = 5
"""Times fewer draws for the optimum, which is searched for draw by draw."""


def measure(count: int, fit_file: Path | None) -> dict[str, Any]:
    """**Returns:** the optimum, and controller -> measure -> nominal value and 5, 50 and 95 %."""
    twin = jt.Twin("dual-cell")
    if fit_file is None:
        fit = jt.match(twin, [jt.read_recording(path) for path in jt.find_recordings()])
    else:
        fit = jt.Fit.load(fit_file)
    plant = fit.mean_twin.with_values({"T_amb": START, "T_start": START})
    draws = posterior_draws(fit, count)
    rest = most_even_point(plant, REFERENCE, limits=ROOM)
    answer: dict[str, Any] = {"fit_percent": fit.mean_fit_percent, "draws": count}
    answer["optimum"] = optimum(plant, rest, draws, max(count // FEWER, 1))
    others = posterior_draws(fit, TUNED, seed=1)
    designed = controllers(plant, rest, others)
    # The first draw is the match itself.
    rows = {
        name: np.concatenate([[float(plant.values[name])], values])
        for name, values in draws.items()
    }
    answer["controllers"] = {}
    for name, (controller, reference) in designed.items():
        began = time.process_time()
        loops = jt.simulate_closed_loops(
            plant,
            controller,
            reference,
            duration=DURATION,
            initial=START,
            draws=rows,
            measures=MEASURED,
            precision="float64" if isinstance(controller, MPC) else "float32",
        )
        row: dict[str, Any] = {
            "failed": int(loops.failed.sum()),
            "cpu_s": round(time.process_time() - began, 1),
            "load": round(os.getloadavg()[0], 1),
        }
        for key in MEASURED:
            values = loops[key][1:][~loops.failed[1:]]
            quantiles = np.quantile(values, QUANTILES, method="nearest").tolist()
            row[key] = [float(loops[key][0]), *quantiles]
        answer["controllers"][name] = row
        print(name, row, flush=True)
    return answer


def controllers(
    plant: jt.Twin, rest: OperatingPoint, others: dict[str, Any]
) -> dict[str, tuple[Any, Any]]:
    """Name -> controller and its references.

    **Arguments:**

    - `others`: draws of the match over which a controller is tuned.
    """
    channels = list(plant.channels)
    weights = np.array([[c in group for c in channels] for group in (LEFT, RIGHT)]) / len(LEFT)
    pair = weights @ np.asarray(rest.outputs)
    model = jt.linearize(plant, duty=rest.duty)
    small = model.reduce(4)
    common: dict[str, Any] = {"measured": [LEFT, RIGHT], "limits": LIMITS}
    settings: dict[str, Any] = {
        "duration": 900,
        "sensitivity_limit": 1.6,
        "starts": 1,
        "rounds": 15,
        "initial": START,
        "noise": False,
    }
    equal = jt.tune(PID(0.05, 0.0005, limits=LIMITS), plant, REFERENCE, **settings)
    gain = weights @ np.asarray(model.dcgain)
    start = DecoupledPI(0.05, 0.0005, 0.05, 0.0005, decoupling=decoupling_of(gain), **common)
    decoupled = jt.tune(start, plant, pair, **settings)
    over_draws = jt.tune(start, plant, pair, draws=others, tail_weight=TAIL_WEIGHT, **settings)
    print(over_draws, flush=True)
    lqi = LQI(
        small.discretise(1.0),
        integral_deviation=30.0,
        duty_deviation=0.5,
        **common,
    )
    mpc = MPC(small.discretise(5.0), horizon=12, **common)
    return {
        # It has an output for each channel, and follows no reference.
        "constant duty": (_constant(rest.duty), START),
        "equal-duty PI": (equal.controller, REFERENCE),
        "decoupled PI": (decoupled.controller, pair),
        "decoupled PI, tuned over draws": (over_draws.controller, pair),
        "LQI": (lqi, pair),
        "MPC": (mpc, pair),
    }


def optimum(
    plant: jt.Twin, rest: OperatingPoint, draws: dict[str, Any], count: int
) -> dict[str, Any]:
    """The least range over the plate that the cells can hold, and that of equal duty cycles."""
    elements = plant.wiring.elements

    def plate_range(point: OperatingPoint) -> float:
        return float(np.ptp(np.asarray(point.nodes)[:elements]))

    best = most_even_point(plant, REFERENCE, limits=LIMITS)
    equal = jt.linearize(plant, temperatures=REFERENCE).operating_point
    found, missed = [], 0
    for number in range(count):
        drawn = plant.with_values({name: v[number] for name, v in draws.items()})
        try:
            found.append(plate_range(most_even_point(drawn, REFERENCE, limits=LIMITS)))
        except ControlError:
            missed += 1
    return {
        "duty": np.asarray(best.duty).tolist(),
        "range_K": [plate_range(best), *np.quantile(found, QUANTILES).tolist()],
        "draws": count,
        "out_of_reach": missed,
        "equal_duty": float(equal.duty[0]),
        "equal_range_K": plate_range(equal),
        "reference_duty": np.asarray(rest.duty).tolist(),
        "reference_range_K": plate_range(rest),
    }


def _constant(duty: Any) -> Any:
    def constant(time: Any, reference: Any, measurement: Any) -> Any:
        return jnp.asarray(duty)

    return constant


def _mean(loop: ClosedLoop) -> jax.Array:
    return jnp.asarray(loop.temperatures).mean(axis=1)


def settling_time(loop: ClosedLoop) -> jax.Array:
    """Of the mean of all channels, s."""
    time, mean = jnp.asarray(loop.time), _mean(loop)
    is_out = jnp.abs(mean - REFERENCE) > SETTLED
    last = jnp.max(jnp.where(is_out, jnp.arange(time.size), -1))
    return jnp.where(last == time.size - 1, jnp.inf, time[jnp.minimum(last + 1, time.size - 1)])


MEASURED: dict[str, Any] = {
    "settling_time": settling_time,
    "overshoot": lambda loop: jnp.maximum(_mean(loop).max() - REFERENCE, 0.0),
    "plate_range_at_rest": MEASURES["plate_range_at_rest"][0],
    "largest_plate_range": MEASURES["largest_plate_range"][0],
    "energy": MEASURES["energy"][0],
    "hottest_cell_side": MEASURES["hottest_cell_side"][0],
}
"""Of the mean of all channels, whatever a controller measures: name -> function."""

COLUMNS = {
    "settling_time": ("settling time, s", 1.0, 0),
    "overshoot": ("overshoot, K", 1.0, 2),
    "plate_range_at_rest": ("range at rest, K", 1.0, 1),
    "largest_plate_range": ("largest range, K", 1.0, 1),
    "energy": ("energy, kJ", 1e-3, 1),
    "hottest_cell_side": ("hottest cell side, degC", 1.0, 0),
}


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where, best = answer["machine"], answer["optimum"]

    def cell(values: list[float], scale: float, digits: int) -> str:
        # Infinite: never within the limit.
        nominal, low, middle, high = (
            "never" if np.isinf(v) else f"{scale * v:.{digits}f}" for v in values
        )
        return f"{nominal} ({low} / {middle} / {high})"

    rows = [
        (name, *(cell(row[key], *column[1:]) for key, column in COLUMNS.items()))
        for name, row in answer["controllers"].items()
    ]
    work = [
        (name, f"{row['cpu_s']:.1f}", f"{row['load']:.1f}", str(row["failed"]))
        for name, row in answer["controllers"].items()
    ]
    low, middle, high = (f"{value:.1f}" for value in best["range_K"][1:])
    duty, held = (
        " and ".join(f"{part:.2f}" for part in best[key]) for key in ("duty", "reference_duty")
    )
    text = (
        f"# From 16 to 40 degC, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.control`. `dual-cell`, matched to "
        f"the authors' three step recordings (fit {answer['fit_percent']:.1f} %), in a room of "
        f"16 degC, for {DURATION:.0f} s. In brackets: 5, 50 and 95 % of {answer['draws']} draws of "
        "what the match leaves open.\n\n"
    )
    text += table(("controller", *(column[0] for column in COLUMNS.values())), rows)
    text += (
        f"\nThe range is the difference between the hottest and the coldest element of the plate. "
        f"The least that two cells can hold at a mean of 40 degC is **{best['range_K'][0]:.1f} K** "
        f"({low} / {middle} / {high} over {best['draws']} draws, of which {best['out_of_reach']} "
        f"cannot hold this mean), with duty cycles of {duty}. Equal duty cycles of "
        f"{best['equal_duty']:.2f} hold {best['equal_range_K']:.1f} K. The references of the "
        f"controllers with two outputs are those of the most even state with duty cycles of at "
        f"most {ROOM[1]}: {held}, {best['reference_range_K']:.1f} K.\n\n"
        "Settling time and overshoot are those of the mean of all channels (within "
        f"{SETTLED} K); 'never' is a loop whose mean is not within it at the end. All controllers "
        "but one are designed for the matched twin alone, at the references. The gains of the PIs "
        "are tuned for the integral of the absolute error, with a sensitivity peak of at most 1.6; "
        f"those of the decoupled PI that is tuned over draws for its mean over {TUNED} other draws "
        f"and for that over the worst 5 % of them (weights {1 - TAIL_WEIGHT} and {TAIL_WEIGHT}), "
        "with the limit of the peak in each draw. LQI "
        "has accepted deviations of 30 K s and of 0.5 in duty, MPC the default ones, a sample time "
        "of 5 s and a horizon of 12; both have models of 4 states beside those of delay and "
        "lag.\n\n"
    )
    text += table(("controller", "CPU time of all loops, s", "load", "failed"), work)
    return text


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=1000, help="of what the match leaves open")
    parser.add_argument("--fit", type=Path, help="a saved fit, in place of a match")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.draws, options.fit)
    write_results(options.out / "control.json", answer, page(answer))


if __name__ == "__main__":
    main()
