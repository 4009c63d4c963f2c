"""How evenly and how fast do controllers take the plate of `dual-cell` from 16 to 40 degC?

    JAXTWIN_RECORDINGS=folder python -m benchmarks.control --draws 1000

The rig is matched to the authors' recordings. The reference is 40 degC for the mean of all
channels. Controllers with two outputs get the readings of both halves of the plate at the most even
steady state with this mean. Each controller runs on the matched twin, on draws of what the match
leaves open, and on draws of another day, on which the cells' contacts and the place of the camera
differ as the rig file says (`between_groups`). It stays as it was designed for the matched twin,
but a second decoupled PI is tuned over other draws of the match.
"""

import os
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxtwin as jt
from jaxtwin.control import (
    MEASURES,
    MPC,
    PID,
    ClosedLoop,
    DecoupledPI,
    OperatingPoint,
    decoupling_of,
    design_lqi,
    design_mpc,
    design_uniformity_mpc,
    most_even_point,
)
from jaxtwin.errors import ControlError
from jaxtwin.matching import posterior_draws

from ._machine import machine
from ._results import parser_of, write_results
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

FULL = 0.999
"""A duty above this one is at its limit."""

QUANTILES = (0.05, 0.5, 0.95)
FEWER = 5
"""Times fewer draws for the optimum, which is searched for draw by draw."""


def measure(count: int, fit_file: Path | None) -> dict[str, Any]:
    """**Returns:** the design, and for each kind of draws the optimum, and controller -> measure ->
    nominal value and 5, 50 and 95 %."""
    twin = jt.Twin("dual-cell")
    if fit_file is None:
        fit = jt.match(twin, [jt.read_recording(path) for path in jt.find_recordings()])
    else:
        fit = jt.Fit.load(fit_file)
    plant = fit.mean_twin.with_values({"T_amb": START, "T_start": START})
    rest = most_even_point(plant, REFERENCE, limits=ROOM)
    best = most_even_point(plant, REFERENCE, limits=LIMITS)
    equal = jt.linearize(plant, temperatures=REFERENCE).operating_point
    answer: dict[str, Any] = {
        "fit_percent": fit.mean_fit_percent,
        "draws": count,
        "optimum": {"duty": np.asarray(best.duty).tolist(), "range_K": best.range},
        "equal": {"duty": float(equal.duty[0]), "range_K": equal.range},
        "reference": {"duty": np.asarray(rest.duty).tolist(), "range_K": rest.range},
    }
    designed = controllers(plant, rest, posterior_draws(fit, TUNED, seed=1))
    matched = posterior_draws(fit, count)
    for kind, draws in (("match", matched), ("another day", another_day(twin.rig, matched))):
        answer[kind] = compared(plant, designed, draws, count)
    return answer


def another_day(rig: jt.Rig, draws: dict[str, Any]) -> dict[str, Any]:
    """The values that are expected on a day that was not matched, for each draw of the matched one:
    those of a new group in a normal hierarchical model (docs/matching.md)."""
    random, answer = np.random.default_rng(2), dict(draws)
    for name, values in draws.items():
        row = rig.parameters[name]
        if row.scope != "group" or row.group_spread is None:
            continue
        assert row.prior_value is not None
        assert row.prior_spread is not None
        mean, shared = row.to_entry(row.prior_value), row.prior_spread**2
        between = row.group_spread**2
        weight = shared / (shared + between)
        matched = np.log(values) if row.is_logarithmic else values
        entries = mean + weight * (matched - mean)
        entries += np.sqrt((1 + weight) * between) * random.standard_normal(len(values))
        drawn = np.exp(entries) if row.is_logarithmic else entries
        answer[name] = np.clip(drawn, row.lower, row.upper)
    return answer


def compared(
    plant: jt.Twin, designed: dict[str, tuple[Any, Any]], draws: dict[str, Any], count: int
) -> dict[str, Any]:
    """The optimum over some of the draws, and the measures of all controllers over all of them."""
    answer: dict[str, Any] = {"optimum": optimum(plant, draws, max(count // FEWER, 1))}
    least = np.array(answer["optimum"].pop("ranges_K"))
    print(answer, flush=True)
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
        some = slice(1, 1 + len(least))
        reached = np.isfinite(least) & np.isfinite(loops["settling_time"][some])
        for key, name_of in (("largest_plate_range", "way"), ("plate_range_at_rest", "rest")):
            above = (loops[key][some] - least)[reached] if reached.any() else [np.nan]
            row[f"above_least_{name_of}"] = np.quantile(above, QUANTILES).tolist()
        row["never"] = float(np.mean(np.isinf(loops["settling_time"][1:])))
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
    equal = jt.tune(plant, PID(0.05, 0.0005, limits=LIMITS), REFERENCE, **settings)
    gain = weights @ np.asarray(model.dcgain)
    start = DecoupledPI(0.05, 0.0005, 0.05, 0.0005, decoupling=decoupling_of(gain), **common)
    decoupled = jt.tune(plant, start, pair, **settings)
    over_draws = jt.tune(plant, start, pair, draws=others, tail_weight=TAIL_WEIGHT, **settings)
    print(over_draws, flush=True)
    lqi = design_lqi(
        small.discretise(1.0),
        integral_deviation=30.0,
        duty_deviation=0.5,
        **common,
    )
    mpc = design_mpc(small.discretise(5.0), horizon=12, **common)
    even = design_uniformity_mpc(jt.linearize(plant, temperatures=REFERENCE), limits=LIMITS)
    return {
        # It has an output for each channel, and follows no reference.
        "constant duty": (_constant(rest.duty), START),
        "equal-duty PI": (equal.controller, REFERENCE),
        "decoupled PI": (decoupled.controller, pair),
        "decoupled PI, tuned over draws": (over_draws.controller, pair),
        "LQI": (lqi, pair),
        "MPC": (mpc, pair),
        "uniformity MPC": (even, REFERENCE),
    }


def optimum(plant: jt.Twin, draws: dict[str, Any], count: int) -> dict[str, Any]:
    """The least range over the plate that the cells can hold in each of some draws; NaN where they
    cannot hold the mean."""
    found, duty = [], []
    for number in range(count):
        drawn = plant.with_values({name: v[number] for name, v in draws.items()})
        try:
            point = most_even_point(drawn, REFERENCE, limits=LIMITS)
        except ControlError:
            found.append(np.nan)
        else:
            found.append(point.range)
            duty.append(np.asarray(point.duty))
    is_full = np.array(duty) > FULL
    return {
        "ranges_K": found,
        "range_K": np.nanquantile(found, QUANTILES).tolist(),
        "draws": count,
        "out_of_reach": int(np.isnan(found).sum()),
        "cells_at_full_duty": is_full.sum(axis=0).tolist(),
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
    where, held = answer["machine"], answer["reference"]
    duty, held_duty = (
        " and ".join(f"{part:.2f}" for part in answer[key]["duty"])
        for key in ("optimum", "reference")
    )
    text = (
        f"# From 16 to 40 degC, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.control`. `dual-cell`, matched to "
        f"the authors' three step recordings (fit {answer['fit_percent']:.1f} %), in a room of "
        f"16 degC, for {DURATION:.0f} s. The range is the difference between the hottest and the "
        "coldest element of the plate. The least that the two cells of the matched twin can hold "
        f"at a mean of 40 degC is **{answer['optimum']['range_K']:.1f} K**, with duty cycles of "
        f"{duty}. Equal duty cycles of {answer['equal']['duty']:.2f} hold "
        f"{answer['equal']['range_K']:.1f} K. The references of the controllers with two outputs "
        f"are those of the most even state with duty cycles of at most {ROOM[1]}: {held_duty}, "
        f"{held['range_K']:.1f} K.\n"
    )
    for kind, title in (
        ("match", "What the match leaves open"),
        ("another day", "Another day, with other contacts and another place of the camera"),
    ):
        text += f"\n## {title}\n\n" + _table_of(answer[kind], answer["draws"])
    text += (
        "\n## Controllers\n\nSettling time and overshoot are those of the mean of all channels "
        f"(within {SETTLED} K); 'never' is a loop whose mean is not within it at the end. All "
        "controllers but one are designed for the matched twin alone, at the references, and stay "
        "as they are. The gains of the PIs are tuned for the integral of the absolute error, with "
        "a sensitivity peak of at most 1.6; those of the decoupled PI that is tuned over draws for "
        f"its mean over {TUNED} other draws of the match and for that over the worst 5 % of them "
        f"(weights {1 - TAIL_WEIGHT} and {TAIL_WEIGHT}), with the limit of the peak in each draw. "
        "LQI has accepted deviations of 30 K s and of 0.5 in duty, MPC the default ones, a sample "
        "time of 5 s and a horizon of 12; both have models of 4 states beside those of delay and "
        "lag. The uniformity MPC has its defaults, on the linear model at a mean of 40 degC.\n\n"
    )
    work = [
        (f"{name}, {kind}", f"{row['cpu_s']:.1f}", f"{row['load']:.1f}", str(row["failed"]))
        for kind in ("match", "another day")
        for name, row in answer[kind]["controllers"].items()
    ]
    return text + table(("controller, draws", "CPU time of all loops, s", "load", "failed"), work)


def _table_of(found: dict[str, Any], draws: int) -> str:
    def cell(values: list[float], scale: float, digits: int) -> str:
        # Infinite: never within the limit.
        nominal, *low_middle_high = (
            "never" if np.isinf(v) else f"{scale * v:.{digits}f}" for v in values
        )
        return f"{nominal} ({' / '.join(low_middle_high)})"

    def above(values: list[float]) -> str:
        return " / ".join(f"{value:.1f}" for value in values)

    rows = [
        (
            name,
            *(cell(row[key], *column[1:]) for key, column in COLUMNS.items()),
            f"{100 * row['never']:.0f}",
            above(row["above_least_way"]),
            above(row["above_least_rest"]),
        )
        for name, row in found["controllers"].items()
    ]
    head = ("controller", *(column[0] for column in COLUMNS.values()), "never settled, %")
    head += ("largest range above the least possible, K", "range at rest above it, K")
    best = found["optimum"]
    low, middle, high = (f"{value:.1f}" for value in best["range_K"])
    first, second = best["cells_at_full_duty"]
    return (
        f"The matched twin, and in brackets 5, 50 and 95 % of {draws} draws. The least range that "
        f"the two cells can hold is {low} / {middle} / {high} K over {best['draws']} of the draws, "
        f"of which {best['out_of_reach']} cannot hold the mean. At this optimum cell 1 is at full "
        f"duty in {first} of them, cell 2 in {second}: where it is, the second cell is the limit. "
        "The last two columns are 5, 50 and 95 % of the draws that reach the mean.\n\n"
        + table(head, rows)
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=1000, help="of what the match leaves open")
    parser.add_argument("--fit", type=Path, help="a saved fit, in place of a match")
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.draws, options.fit)
    write_results(options.out / "control.json", answer, page(answer))


if __name__ == "__main__":
    main()
