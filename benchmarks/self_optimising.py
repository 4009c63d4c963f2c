"""Does a loop that retunes itself become as good as one that was designed on the true rig?

A twin of `single-cell` that was matched to four healthy sessions, with the controller that is
designed on it, or a cautious one that was never tuned. Then the rig changes, a session of a quarter
of an hour is recorded, the twin is refitted, and if it passed the gate the controller is retuned,
as `serve --self-optimise apply` does. Seeds that are judged were not looked at before; all settings
were chosen on others.

- changes: a contact of three times the resistance; a cell whose resistance is 1/0.7 times what it
  was, so that it draws 30 % less; a fouled sink of three times the resistance to air; a supply of
  10.2 V in place of 12 V, which the twin does not know as a parameter.
- contact of two: a contact of `dual-cell`, all three resistances of which are three times what they
  were. The gate asks for few changes, finds that one of them has changed five times, and rejects
  the refit; here somebody who knows of the contacts matches their six resistances instead.
- poisoned: a channel that is frozen, another rig, an open lid (`heated-box`), as in
  `benchmarks.refit`; and objectives and references that ask for the impossible.
- delayed: the accepted controller on a rig that reads later than its twin by 1.5 to 3 times the
  delay that its loop tolerates, which nothing says; and the same rigs without that delay.
- side by side: Nelder-Mead on the running loop (scipy), 900 s of the rig for each evaluation, until
  the cost is within 10 % of the optimum.

    python -m benchmarks.self_optimising [--seeds 100] [--first 0] [--kinds contact heater ...]
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

import jaxtwin as jt
from benchmarks._machine import processor
from benchmarks.refit import another_rig, drifted, frozen, last_fit, lid, recorded, schedule
from jaxtwin.control import PID, AbstractController, Decision, loop_margins
from jaxtwin.errors import JaxtwinError
from jaxtwin.retuning import LoopWatch, Retuned

LENGTH = 900.0
"""The time of the steps for which the controller is designed, s."""


class Bench(NamedTuple):
    """A rig, the steps for which its controller is designed, degC, and the controller from which
    the search begins on the healthy rig."""

    rig: str
    references: str
    first: AbstractController

    def retuned(self, fit: jt.Fit, present: AbstractController) -> Retuned:
        return jt.retune(fit, present, self.references, duration=LENGTH)


ONE_CELL = Bench("single-cell", "0:30,300:45,600:30", PID(Kp=0.05, Ki=0.0005, limits=(-1, 1)))
HALVES = [["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]]
TWO_CELLS = Bench(
    "dual-cell",
    "0:30,300:40,600:30",
    PID(Kp=0.02, Ki=0.0002, limits=(-1, 1), measured=HALVES),
)

WITHIN = 1.1
"""A cost is as good as the optimum up to this multiple of it."""

EVALUATIONS = 60
"""The number of experiments of a search on the rig, at most."""


class Loop(NamedTuple):
    """A loop on a rig: cost, K s; energy, J; overshoot, K; hottest reading, degC."""

    cost: float
    energy: float
    overshoot: float
    hottest: float


CONTACTS = [[f"R_pc{cell}_{part}" for part in ("row1", "row2", "end")] for cell in (1, 2)]


def bench_of(kind: str) -> Bench:
    return TWO_CELLS if kind == "contact of two" else ONE_CELL


@cache
def healthy_controller(rig: str) -> AbstractController:
    """The controller before the change, designed on the healthy twin."""
    bench = ONE_CELL if rig == ONE_CELL.rig else TWO_CELLS
    retuned = bench.retuned(last_fit(bench.rig), bench.first)
    assert retuned.decision == "accepted", retuned.summary()
    return retuned.controller


@cache
def weak_rig() -> jt.Rig:
    """The rig with a supply of 85 % of its voltage."""
    text = jt.load_rig(ONE_CELL.rig).text
    assert text is not None
    file = Path(tempfile.mkdtemp()) / "single-cell.toml"
    file.write_text(text.replace('supply_voltage = "12 V"', 'supply_voltage = "10.2 V"'))
    return jt.load_rig(file)


def changed_rig(kind: str, seed: int) -> tuple[jt.Twin, jt.Experiment]:
    """A rig that has changed, and a session of it."""
    random = np.random.default_rng([31, seed, sum(map(ord, kind))])
    twin = drifted(jt.Twin(bench_of(kind).rig), random)
    factors = {
        "contact of two": dict.fromkeys(CONTACTS[seed % 2], 3.0),
        "contact": {("R_pc", "R_ph")[seed % 2]: 3.0},
        "heater": {"R_E": 1 / 0.7},
        "sink": {"R_sink": 3.0},
        "supply": {},
    }[kind]
    twin = twin.with_values(
        {name: part * float(twin.values[name]) for name, part in factors.items()}
    )
    if kind == "supply":
        twin = jt.Twin(weak_rig(), {name: float(value) for name, value in twin.values.items()})
    return twin, recorded(twin, schedule(twin, random, {}), random, kind)


def on_rig(bench: Bench, twin: jt.Twin, controller: AbstractController, seed: int) -> Loop:
    run = jt.simulate_closed_loop(twin, controller, bench.references, duration=LENGTH, seed=seed)
    table = run.measures()["value"]
    return Loop(
        float(table["integral_absolute_error"]),
        float(table["energy"]),
        float(table["overshoot"]),
        float(np.max(run.run.temperatures)),
    )


def limit_of(twin: jt.Twin) -> float:
    assert twin.rig.limits is not None
    return twin.rig.limits.temperature - 273.15


def optimum(bench: Bench, twin: jt.Twin) -> AbstractController:
    """The controller that is designed on the true rig."""
    present = healthy_controller(bench.rig)
    return jt.tune(twin, present, bench.references, duration=LENGTH).controller


class NewTwin(NamedTuple):
    """The fit to a session of a changed rig, and whether it was promoted."""

    decision: str
    twin: jt.Fit


class Outcome(NamedTuple):
    """A changed rig: what the refit and the retuning decided, the time of the latter, s, and the
    costs of the optimum, the controller before, and the one in use afterwards."""

    refit: str
    retune: str
    seconds: float
    best: float
    before: float
    after: float
    is_hot: bool


@cache
def refitted(kind: str, seed: int) -> tuple[jt.Twin, NewTwin, float]:
    """A changed rig, the refit to a session of it, and the cost of the optimum on it."""
    bench = bench_of(kind)
    twin, recording = changed_rig(kind, seed)
    best = on_rig(bench, twin, optimum(bench, twin), seed).cost
    last = last_fit(bench.rig)
    if bench is TWO_CELLS:
        contacts = [name for contact in CONTACTS for name in contact]
        session = ("t_delay", "T_amb", "T_start")
        fit = jt.match(last, recording, free=contacts, per_recording=session)
        return twin, NewTwin("promoted", fit), best
    refit = jt.refit(last, recording)
    return twin, NewTwin(refit.decision, refit.twin), best


def controller_before(bench: Bench, which: str) -> AbstractController:
    return healthy_controller(bench.rig) if which == "designed" else bench.first


@cache
def outcome(kind: str, seed: int, which: str) -> Outcome:
    """As the loop of `serve` does: a retuning follows a refit that passed its gate."""
    bench = bench_of(kind)
    twin, refit, best = refitted(kind, seed)
    present = controller_before(bench, which)
    word, seconds, after = "none", np.nan, present
    if refit.decision == "promoted":
        retuned = bench.retuned(refit.twin, present)
        word, seconds, after = retuned.decision, retuned.wall_time, retuned.controller
    old, new = on_rig(bench, twin, present, seed), on_rig(bench, twin, after, seed)
    is_hot = new.hottest > limit_of(twin)
    return Outcome(refit.decision, word, seconds, best, old.cost, new.cost, is_hot)


def changes(kind: str, which: str, seeds: range) -> str:
    outcomes = []
    for seed in seeds:
        outcomes.append(outcome(kind, seed, which))
        print(f"{kind}, {which} {seed}: {tuple(outcomes[-1])}", flush=True)
    ratios = np.array([case.after / case.best for case in outcomes])
    old = np.array([case.before / case.best for case in outcomes])
    is_tuned = np.array([case.refit == "promoted" for case in outcomes])
    near = np.sum(ratios[is_tuned] <= WITHIN), np.sum(ratios <= WITHIN)
    refits = ", ".join(f"{a} {b}" for a, b in Counter(case.refit for case in outcomes).items())
    words = ", ".join(f"{a} {b}" for a, b in Counter(case.retune for case in outcomes).items())
    hot = sum(case.is_hot for case in outcomes)
    seconds = [case.seconds for case in outcomes if np.isfinite(case.seconds)]
    times = f"{np.median(seconds):.1f}, {max(seconds):.1f}" if seconds else ""
    return (
        f"| {kind} | {which} | {refits} | {words} | {np.median(old):.2f}, {old.max():.2f} | "
        f"{np.median(ratios):.2f}, {ratios.max():.2f} | {near[0]} of {is_tuned.sum()} | "
        f"{near[1]} of {len(seeds)} | {hot} | {times} |"
    )


def impossible(seed: int) -> str:
    """A retuning that asks for the impossible, and what became of it."""
    random = np.random.default_rng([32, seed])
    asked: dict[str, object] = {"references": ONE_CELL.references}
    match seed % 4:
        case 0:  # nothing but little energy: a controller that does nothing
            asked["objective"] = {"energy": float(random.uniform(0.1, 10))}
        case 1:
            asked["objective"] = {"integral_absolute_error": -float(random.uniform(0.1, 10))}
        case 2:
            asked["references"] = f"0:30,300:{random.uniform(150, 300):.0f}"
        case _:
            asked["objective"] = {"total_variation": float(random.uniform(0.1, 10))}
    try:
        retuned = jt.retune(last_fit(ONE_CELL.rig), ONE_CELL.first, duration=LENGTH, **asked)  # pyright: ignore
    except JaxtwinError:
        return "refused"
    return retuned.decision


def poisoned(kind: str, seeds: range) -> str:
    makes: Mapping[str, Callable[[int], tuple[jt.Fit, jt.Experiment]]] = {
        "frozen": frozen,
        "another rig": another_rig,
        "lid": lid,
    }
    words = Counter[str]()
    for seed in seeds:
        if kind == "impossible":
            word = impossible(seed)
        else:
            refit = jt.refit(*makes[kind](seed))
            word = f"refit {refit.decision}"
            if refit.decision == "promoted":
                retuned = ONE_CELL.retuned(refit.twin, ONE_CELL.first)
                word = retuned.decision
        words[word] += 1
        print(f"{kind} {seed}: {word}", flush=True)
    decisions = ", ".join(f"{a} {b}" for a, b in words.items())
    return f"| {kind} | {len(seeds) - words['accepted']} of {len(seeds)} | {decisions} |"


def watched(
    twin: jt.Twin, controller: AbstractController, retuned: Retuned, seed: int, delay: float
) -> float:
    """The time after which the loop is worse than its trial, s; infinite if it never is."""
    run = jt.simulate_closed_loop(
        twin, controller, ONE_CELL.references, duration=LENGTH, seed=seed, sensor_delay=delay
    )
    assert retuned.band is not None
    watch = LoopWatch(retuned.band)
    rows = zip(run.time, run.reference, run.measurement, run.duty, strict=True)
    return next((float(row[0]) for row in rows if watch.update(Decision(*row))), np.inf)


def delayed(seeds: range) -> str:
    """Rigs with a hidden delay, and the same ones without."""
    retuned = ONE_CELL.retuned(last_fit(ONE_CELL.rig), ONE_CELL.first)
    late, false = [], 0
    for seed in seeds:
        random = np.random.default_rng([33, seed])
        twin = drifted(jt.Twin(ONE_CELL.rig), random)
        channel = loop_margins(twin, retuned.controller, 40.0).channel
        assert channel is not None
        tolerated = np.deg2rad(channel.pm) / channel.wcp
        delay = float(np.ceil(random.uniform(1.5, 3.0) * tolerated))
        late.append(watched(twin, retuned.controller, retuned, seed, delay))
        healthy = watched(twin, retuned.controller, retuned, seed, 0.0)
        false += healthy < np.inf
        print(
            f"delayed {seed}: {delay:g} s after {late[-1]:g} s, healthy {healthy:g} s", flush=True
        )
    seen = int(np.isfinite(late).sum())
    times = np.array(late)[np.isfinite(late)]
    return (
        f"| {seen} of {len(seeds)} | {np.median(times):.0f}, {times.max():.0f} | "
        f"{false} of {len(seeds)} |"
    )


def beside(kind: str, seeds: range) -> list[str]:
    """Nelder-Mead on the running loop, and ours."""
    rows = []
    for seed in seeds:
        twin, _ = changed_rig(kind, seed)
        case = outcome(kind, seed, "cautious")
        tried: list[Loop] = []

        def cost(point: np.ndarray, twin=twin, tried=tried, best=case.best) -> float:
            if tried and min(loop.cost for loop in tried) <= WITHIN * best:
                return min(loop.cost for loop in tried)  # it may stop: it is as good
            gains = np.exp(np.clip(point, -12, 3))
            loop = on_rig(ONE_CELL, twin, PID(Kp=gains[0], Ki=gains[1], limits=(-1, 1)), len(tried))
            tried.append(loop)
            return loop.cost

        first = ONE_CELL.first
        assert isinstance(first, PID)
        start = np.log([float(np.ravel(gain)[0]) for gain in (first.Kp, first.Ki)])
        minimize(cost, start, method="Nelder-Mead", options={"maxfev": EVALUATIONS})
        best = min(loop.cost for loop in tried)
        rows.append(
            (
                len(tried) * LENGTH,
                sum(loop.energy for loop in tried),
                max(loop.overshoot for loop in tried),
                best / case.best,
                case.after / case.best,
            )
        )
        print(f"beside {kind} {seed}: {rows[-1]}", flush=True)
    table = np.array(rows)
    median, largest = np.median(table, axis=0), table.max(axis=0)
    search = (
        f"| Nelder-Mead on the rig | {median[0]:.0f}, {largest[0]:.0f} | "
        f"{median[1] / 1e3:.0f}, {largest[1] / 1e3:.0f} | {median[2]:.1f}, {largest[2]:.1f} | "
        f"{median[3]:.2f}, {largest[3]:.2f} |"
    )
    return [
        search,
        f"| `retune` | 0, 0 | 0, 0 | 0, 0 | {median[4]:.2f}, {largest[4]:.2f} |",
    ]


CHANGES = ("contact", "heater", "sink", "supply", "contact of two")
POISONED = ("frozen", "another rig", "lid", "impossible")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=[*CHANGES, *POISONED, "delayed", "beside"])
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    print(f"{processor()}, seeds {seeds.start} to {seeds.stop - 1}")
    began = time.perf_counter()
    ONE_CELL.retuned(last_fit(ONE_CELL.rig), ONE_CELL.first)
    print(f"fit and first retuning: {time.perf_counter() - began:.1f} s")
    rows = []
    for kind in chosen.kinds:
        if kind in CHANGES:
            rows += [changes(kind, which, seeds) for which in ("designed", "cautious")]
        elif kind in POISONED:
            rows.append(poisoned(kind, seeds))
        elif kind == "delayed":
            rows.append(delayed(seeds))
        else:
            rows += beside("contact", seeds)
    print("\n".join(rows))


if __name__ == "__main__":
    main()
