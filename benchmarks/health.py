"""How early is it known when a parameter passes its limit?

Rigs `tclab` whose second heater loses power along a straight line, with a difference of each
session beyond it. After each session from the third on, `health` says when the trend passes 85 % of
the power at the start. The measures are those of Saxena and others (Int. J. Prognostics and Health
Management 1 (2010)), which ProgPy has:

- prognostic horizon: the time before the end of life from which on, for the first time, the
  predicted end of life is within `ALPHA` of the true one with a probability of `BETA` at least.
- alpha-lambda: whether the remaining life is predicted within `ALPHA` with that probability when a
  part lambda of the life after the first prediction is over.
- cumulative relative accuracy: the mean over predictions of 1 - |predicted - true| / true remaining
  life, with the median as prediction.

With a folder of recordings the sessions 1 to 6 and 15 of the single cell are looked at as well:
`R_E`, `R_ph` and the Seebeck coefficient of each by itself, with the other values of a match to the
first four.

    python -m benchmarks.health [FOLDER_WITH_RECORDINGS] [--rigs 20]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.prognostics import Health, Trend

SESSIONS, EVERY = 12, 5.0
"""The number of sessions, and the days between them."""

LOSS = 0.003
"""The loss of power in a day, of its logarithm."""

BETWEEN = 0.01
"""The standard deviation of the logarithm of the power between sessions."""

LEFT = 0.85
"""The limit, as a part of the power at the start."""

END = -np.log(LEFT) / LOSS
"""The day on which it is passed."""

COUNTS = range(3, SESSIONS + 1)
"""The numbers of sessions after which there is a prediction."""

TIMES = tuple(EVERY * (count - 1) for count in COUNTS)
"""The days of the predictions."""

ALPHA, BETA = 0.2, 0.5

DRAWS = 20_000

MATCHED, LOOKED_AT = (1, 2, 3, 4), (1, 2, 3, 4, 5, 6, 15)
"""The sessions of the single cell of the match, and those that are looked at."""

FREE = ("R_E", "R_ph", "alpha")
"""What is free in a match of one of its sessions, beside room and start."""


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=Path, nargs="?")
    arguments.add_argument("--rigs", type=int, default=20)
    given = arguments.parse_args()
    print("# Health\n")
    if given.rigs:
        ageing(given.rigs)
    if given.folder is not None:
        single_cell(given.folder / "single-cell")


def ageing(rigs: int) -> None:
    """Rigs whose second heater loses power."""
    print(
        f"{rigs} rigs `tclab`, {SESSIONS} sessions of 15 minutes, one every {EVERY:g} days. The "
        f"power of the second heater falls by {100 * LOSS:g} % in a day, with {100 * BETWEEN:g} % "
        f"between sessions, and passes {100 * LEFT:g} % on day {END:.1f}. "
        "`python -m benchmarks.health`."
    )
    chosen = {"all values free": None, "the power alone free": ["P_2", "T_amb", "T_start"]}
    found = {}
    for label, free in chosen.items():
        fits = matched(rigs, free)
        found[label] = [[judged(each[:count]) for count in COUNTS] for each in fits]
    table = {label: measures(each) for label, each in found.items()}
    print(f"\n| each session matched with | {' | '.join(table)} |\n|---|---|---|")
    for name in next(iter(table.values())):
        print(f"| {name} | {' | '.join(column[name] for column in table.values())} |")
    for label, each in found.items():
        reliability(label, each)


def single_cell(folder: Path) -> None:
    """The sessions of the single cell."""
    sessions = {
        number: jt.read_recording(folder / f"BMData{number}_022722.mat") for number in LOOKED_AT
    }
    reference = jt.match(jt.Twin("single-cell"), [sessions[number] for number in MATCHED])
    of_recording = [name for name, row in reference.parameters.items() if row.scope == "recording"]
    free = [*FREE, *of_recording]
    fits = {str(number): jt.match(reference, one, free=free) for number, one in sessions.items()}
    found = jt.health(fits)
    print("\n## The single cell\n")
    print(f"| parameter | {' | '.join(f'session {one}' for one in LOOKED_AT)} | error, % | p-value "
          "of a trend | the last one off the trend of the others, standard errors |")  # fmt: skip
    print(f"|{'---|' * (len(LOOKED_AT) + 4)}")
    for name in FREE:
        row = found[name]
        values = " | ".join(f"{one:.3g}" for one in row.values)
        print(
            f"| {name} | {values} | {100 * np.median(row.errors):.2g} | {row.p_value:.2g} | "
            f"{abs(row.last_distance):.1f} |"
        )


def measures(found: Sequence[Sequence[Health]]) -> dict[str, str]:
    """The measures over all rigs, as text."""
    profiles = [[end_of_life(one) for one in each] for each in found]
    horizon = np.median([prognostic_horizon(each) for each in profiles])
    accuracy = np.mean([cumulative_relative_accuracy(each) for each in profiles])
    trends = [one["P_2"].trend for each in found for one in each]
    inside = [abs(one.slope + LOSS) <= one.reach * one.slope_error for one in trends]
    clear = [each[-1]["P_2"].p_value < 0.05 for each in found]
    shares = {
        f"alpha-lambda at lambda = {part}, % of rigs": np.mean(
            [alpha_lambda(each, part) for each in profiles]
        )
        for part in (0.25, 0.5, 0.75)
    }
    shares["95 % intervals of the trend that contain the true one, %"] = np.mean(inside)
    shares["a clear trend of the power after all sessions, % of rigs"] = np.mean(clear)
    return {
        "prognostic horizon, median, days before the end": f"{horizon:.0f}",
        "cumulative relative accuracy, mean": f"{accuracy:.2f}",
        **{name: f"{100 * share:.0f}" for name, share in shares.items()},
    }


def matched(rigs: int, free: Sequence[str] | None) -> list[list[jt.Fit]]:
    """The fits of the sessions of each rig."""
    twin = jt.Twin("tclab")
    sets = []
    for rig in range(rigs):
        random = np.random.default_rng(rig)
        for session in range(SESSIONS):
            away = -LOSS * EVERY * session + random.normal(0.0, BETWEEN)
            worn = twin.with_values({"P_2": float(twin.values["P_2"]) * np.exp(away)})
            duty = random.uniform(0.2, 0.9, (4, 2))
            text = ",".join(f"{240 * n}:{a:.2f}/{b:.2f}" for n, (a, b) in enumerate(duty))
            plan = jt.Experiment.schedule(text, duration=900, step=2, cells=2)
            sets.append([jt.simulate(worn, plan).to_recording(seed=1000 * rig + session)])
    fits = jt.match_many(twin, sets, free=free)
    kept = [one for one in fits if one is not None]
    assert len(kept) == len(sets)
    return [kept[SESSIONS * rig : SESSIONS * (rig + 1)] for rig in range(rigs)]


def judged(fits: Sequence[jt.Fit]) -> Health:
    """The health after some sessions."""
    limit = LEFT * float(jt.Twin("tclab").values["P_2"])
    sessions = {f"session {number}": fit for number, fit in enumerate(fits, 1)}
    days = EVERY * np.arange(len(fits))
    return jt.health(sessions, days.tolist(), limits={"P_2": limit}, within=2 * EVERY)


def end_of_life(health: Health) -> Float[np.ndarray, " draws"]:
    """Draws of the day on which the trend passes the limit: infinite if it never does."""
    row = health["P_2"]
    assert row.limit is not None
    level, slope = lines(row.trend)
    with np.errstate(divide="ignore"):
        day = row.trend.centre + (np.log(row.limit) - level) / slope
    return np.where(slope < 0, day, np.inf)


def lines(trend: Trend) -> tuple[Float[np.ndarray, " draws"], Float[np.ndarray, " draws"]]:
    """Draws of level and slope."""
    random, freedom = np.random.default_rng(0), trend.degrees_of_freedom
    wider = np.sqrt(freedom / random.chisquare(freedom, DRAWS))
    level, slope = random.normal(size=(2, DRAWS)) * wider
    return trend.level + trend.level_error * level, trend.slope + trend.slope_error * slope


def prognostic_horizon(profile: Sequence[Float[np.ndarray, " draws"]]) -> float:
    """The time from the first prediction that is good enough to the end of life; 0 without one."""
    for time, draws in zip(TIMES, profile, strict=True):
        if time < END and np.mean(np.abs(draws - END) <= ALPHA * END) >= BETA:
            return END - time
    return 0.0


def alpha_lambda(profile: Sequence[Float[np.ndarray, " draws"]], part: float) -> bool:
    """Whether the remaining life is known well enough at a part of the life."""
    at = TIMES[0] + part * (END - TIMES[0])
    place = max(number for number, time in enumerate(TIMES) if time <= at)
    left = END - TIMES[place]
    return bool(np.mean(np.abs(profile[place] - END) <= ALPHA * left) >= BETA)


def cumulative_relative_accuracy(profile: Sequence[Float[np.ndarray, " draws"]]) -> float:
    """The mean relative accuracy of the median remaining life, 0 at least."""
    accuracies = []
    for time, draws in zip(TIMES, profile, strict=True):
        if time < END:
            away = abs(float(np.median(draws)) - END)
            accuracies.append(max(1 - away / (END - time), 0.0))
    return float(np.mean(accuracies))


def reliability(label: str, found: Sequence[Sequence[Health]]) -> None:
    """Prints how often the limit was passed where it was said to be likely."""
    pairs = [
        (one.probabilities["P_2"], time + one.within >= END)
        for each in found
        for one, time in zip(each, TIMES, strict=True)
    ]
    probabilities, passed = np.array(pairs).T
    question = f"probability of passing within {2 * EVERY:g} days"
    print(f"\n| {label}: {question} | predictions | passed, % |")
    print("|---|---|---|")
    edges: list[tuple[float, float]] = [(0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.01)]
    for low, high in edges:
        here = (probabilities >= low) & (probabilities < high)
        share = f"{100 * passed[here].mean():.0f}" if here.any() else "-"
        print(f"| {low:g} to {min(high, 1):g} | {here.sum()} | {share} |")


if __name__ == "__main__":
    main()
