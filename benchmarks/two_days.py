"""Do matches and predictions of two days hold? Synthetic studies of known truth, by `dual-cell`.

Each study is a rig whose parameters are drawn from their priors, recorded as the paper's was: three
step responses on the first day, and one at full power on a second day, on which the camera looks at
other places and both cells were remounted. The differences are drawn from the rig file's
`between_groups`. A reading has the sensor's noise, noise that stays for half a minute, and a camera
with an offset, a drift and corrections.

Two matches of each study are judged:

- all recordings together: is the camera's shift found to a millimetre, and do the 95 % intervals of
  the contacts hold their true values?
- the first day alone, which predicts the second from its first minute and from its first 120, 200
  and 300 s: how many readings lie inside the 95 % bands?

With `--plant` the recorded rig is not the twin's. `finer` has plate elements of half the size,
cells that lie half an element beside their place, and the radiation of tarnished copper.

    python -m benchmarks.two_days --studies 200

The results also hold 64 studies of an earlier twin and plant, in whose pictures the plate's outline
was a sharp step.

Every study is a line of `benchmarks/results/two_days.jsonl`; the script goes on where it ended and
writes the table `two_days.md` beside it.
"""

import argparse
import json
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from jaxtwin import Experiment, Fit, Twin, match_many, prediction_band, simulate
from jaxtwin.data import data_folder
from jaxtwin.rig import rig_from_tables

RESULTS = Path(__file__).parent / "results"
DAYS = ("steps", "steps", "steps", "full")
ZONES = {
    "A": ("T11", "T12", "T21", "T22", "TAM"),
    "B": ("T13", "T14", "T23", "T24", "TBM"),
    "C": ("T15", "T16", "T25", "T26", "TCM"),
}
STEPS, FULL = "0:0.502,500:0.784", "55:1"
SAMPLE = 2.0
SENSOR, CREEP, JUMP, MEMORY = 0.1, 0.05, 1.0, 20.0
"""Standard deviations, K: of the sensor, of noise with a memory of `MEMORY` s, of a correction."""
GIVEN = (60.0, 120.0, 200.0, 300.0)
CONTACTS = tuple(f"R_pc{cell}_{to}" for cell in (1, 2) for to in ("row1", "row2", "end"))
BATCH = 4
COLUMNS = (
    "given",
    "samples inside the 95 % band",
    "studies with 90 % or more inside",
    "mean width, K",
    "median RMSE, K",
    "largest bias, K",
)

Study = dict[str, Any]


def draw(twin: Twin, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Day -> name -> true value, from the priors cut at two standard deviations."""
    days: dict[str, dict[str, float]] = {"steps": {}, "full": {}}

    def normal() -> float:
        return float(np.clip(rng.standard_normal(), -2, 2))

    for name, row in twin.rig.parameters.items():
        if not row.free or row.prior_value is None or row.prior_spread is None:
            continue
        shared = row.to_entry(row.prior_value) + row.prior_spread * normal()
        for values in days.values():
            entry = shared + (row.group_spread or 0.0) * normal()
            values[name] = float(np.clip(row.from_entry(entry), row.lower, row.upper))
    for values in days.values():
        values["T_start"] = values["T_amb"]  # at rest
    return days


def finer_plant() -> Twin:
    """A rig that the twin does not describe exactly."""
    rig = tomllib.loads((data_folder() / "rigs" / "dual-cell.toml").read_text())
    plate = rig["plate"]
    for axis in ("columns", "rows"):
        halves = [f"{float(size.split()[0]) / 2} cm" for size in plate[axis]]
        plate[axis] = [half for half in halves for _ in range(2)]
    for key in ("film_coefficient", "film_row_factor"):
        plate[key] = [value for value in plate[key] for _ in range(2)]
    for cell in rig["cells"]:
        cell["contacts"] = {
            f"V{2 * int(to[1]) - 1 + j}_{2 * int(to[2:]) + i}": name
            for to, name in cell["contacts"].items()
            for i in range(2)
            for j in range(2)
        }
    return Twin(rig_from_tables(rig, "finer"))


def plant_values(plant: str, values: dict[str, float]) -> dict[str, float]:
    if plant == "twin":
        return values
    # Four halves share what was one contact.
    return values | {name: 4 * values[name] for name in CONTACTS} | {"e_copper": 0.3}


def camera_noise(twin: Twin, drive: Experiment, rng: np.random.Generator) -> np.ndarray:
    """What a camera adds to the temperatures of one recording, K."""
    shape = (len(drive.time), len(drive.channels))
    added = SENSOR * rng.standard_normal(shape)
    memory = np.exp(-SAMPLE / MEMORY)
    shocks = np.sqrt(1 - memory**2) * rng.standard_normal(shape)
    added += CREEP * np.asarray(lfilter([1.0], [1, -memory], shocks, axis=0))
    error = twin.rig.common_error
    assert error is not None
    common = np.full(len(drive.time), error.offset * rng.standard_normal())
    corners = np.arange(0, drive.time[-1] + error.drift_time, error.drift_time)
    common += np.interp(drive.time, corners, error.drift * rng.standard_normal(len(corners)))
    for event in rng.uniform(20, 160) + 164.0 * np.arange(7):
        fading = np.exp(-np.maximum(drive.time - event, 0) / 25) * (drive.time >= event)
        common += JUMP * rng.standard_normal() * fading
    return added + common[:, None]


def recordings(
    twin: Twin, plant: Twin, kind: str, seed: int
) -> tuple[list[Experiment], dict[str, dict[str, float]]]:
    """The four recordings of a study, and its true values."""
    rng = np.random.default_rng([seed, 16])
    truth = draw(twin, rng)
    made = []
    for number, day in enumerate(DAYS):
        drive = Experiment.schedule(
            FULL if day == "full" else STEPS,
            duration=1000,
            step=SAMPLE,
            cells=2,
            channels=ZONES["A" if day == "full" else "ABC"[number]],
        )
        values = truth[day] | {"t_delay": float(rng.uniform(1, 4))}
        room = 16 + 1.5 * float(rng.standard_normal())
        values |= {"T_amb": room, "T_start": room}
        run = simulate(plant.with_values(plant_values(kind, values)), drive)
        made.append(
            Experiment(
                drive.time,
                drive.duty,
                channels=drive.channels,
                temperatures=run.temperatures + camera_noise(twin, drive, rng),
                name=f"{day} {number}",
                group=day,
            )
        )
    return made, truth


def of_joint_match(fit: Fit, truth: dict[str, dict[str, float]]) -> Study:
    """Errors of the shifts, mm, and of the contacts in their standard errors."""
    errors = fit.uncertainty.standard_errors
    shifts = {
        f"{name}[{day}]": fit.group_values[day][name] - truth[day][name]
        for day in truth
        for name in ("d_x", "d_y")
    }
    contacts = {}
    for day, values in truth.items():
        for name in CONTACTS:
            found = fit.group_values[day][name]
            deviation = errors[f"{name}[{day}]"] / found
            contacts[f"{name}[{day}]"] = float(np.log(found / values[name]) / deviation)
    return {"fit": fit.mean_fit_percent, "shift_mm": shifts, "contact_sd": contacts}


def of_prediction(fit: Fit, experiment: Experiment, given: float) -> Study:
    """Bias, RMSE and 95 % band after the first part."""
    band = (
        prediction_band(fit, experiment=experiment, warm_up=60)
        if given <= 60
        else prediction_band(fit, experiment=experiment, given=given)
    )
    late = experiment.time >= given
    assert experiment.temperatures is not None
    seen = experiment.temperatures[late]
    errors = band.middle[late] - seen
    inside = (seen >= band.lower[late]) & (seen <= band.upper[late])
    return {
        "bias": float(errors.mean()),
        "rmse": float(np.sqrt(np.mean(errors**2))),
        "inside": float(inside.mean()),
        "width": float((band.upper - band.lower)[late].mean()),
        "rise": float(np.mean(seen[-20:]) - np.mean(experiment.temperatures[:20])),
    }


def studies(twin: Twin, plant: Twin, kind: str, seeds: Sequence[int]) -> Iterator[Study]:
    made = [recordings(twin, plant, kind, seed) for seed in seeds]
    first = match_many(twin, [members[:3] for members, _ in made])
    joint = match_many(twin, [members for members, _ in made])
    for seed, (members, truth), day, both in zip(seeds, made, first, joint, strict=True):
        study: Study = {"seed": seed, "plant": kind}
        if both is not None:
            study["joint"] = of_joint_match(both, truth)
        if day is not None:
            study["predicted"] = {
                f"{given:g}": of_prediction(day, members[3], given) for given in GIVEN
            }
        yield study


def table(done: Sequence[Study]) -> str:
    """The studies of one kind of plant as a table."""
    joint = [study["joint"] for study in done if "joint" in study]
    shifts = np.abs([list(study["shift_mm"].values()) for study in joint])
    contacts = np.abs([list(study["contact_sd"].values()) for study in joint])
    near, held = 100 * np.mean(shifts < 1), 100 * np.mean(contacts < 1.96)
    fit = np.median([study["fit"] for study in joint])
    lines = [
        f"- Fit of the joint match: {fit:.1f} % (median).",
        f"- Shifts: median error {np.median(shifts):.2f} mm, {near:.1f} % within 1 mm.",
        f"- Contacts: {held:.1f} % of the true values are inside the 95 % intervals.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|---" + "|---:" * (len(COLUMNS) - 1) + "|",
    ]
    predicted = [study["predicted"] for study in done if "predicted" in study]
    for given in GIVEN:
        rows = [study[f"{given:g}"] for study in predicted]
        inside, width, rmse, bias = (
            np.array([row[key] for row in rows]) for key in ("inside", "width", "rmse", "bias")
        )
        cells = (
            f"first {given:g} s",
            f"{100 * inside.mean():.1f} %",
            f"{100 * np.mean(inside >= 0.9):.0f} %",
            f"{width.mean():.2f}",
            f"{np.median(rmse):.2f}",
            f"{bias[np.abs(bias).argmax()]:+.1f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first study")
    parser.add_argument("--plant", choices=("twin", "finer"), default="twin")
    parser.add_argument("--minutes", type=float, default=np.inf, help="ends after this time")
    options = parser.parse_args()
    path = RESULTS / "two_days.jsonl"
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {(study["plant"], study["seed"]) for study in done}
    seeds_of_all = range(options.first, options.first + options.studies)
    left = [seed for seed in seeds_of_all if (options.plant, seed) not in known]
    twin = Twin("dual-cell")
    plant = twin if options.plant == "twin" else finer_plant()
    began = time.perf_counter()
    for first in range(0, len(left), BATCH):
        if time.perf_counter() - began > 60 * options.minutes:
            break
        work = time.process_time()
        seeds = left[first : first + BATCH]
        seeds += left[: BATCH - len(seeds)]  # a full batch uses the same programs
        found = list(studies(twin, plant, options.plant, seeds))[: len(left) - first]
        done += found
        with path.open("a") as file:
            file.writelines(json.dumps(study) + "\n" for study in found)
        print(f"studies {seeds}: {time.process_time() - work:.0f} s of CPU time", flush=True)
    texts = ["# Two days: synthetic studies", "", "`python -m benchmarks.two_days`"]
    for kind in dict.fromkeys(study["plant"] for study in done):
        of_kind = [study for study in done if study["plant"] == kind]
        texts += ["", f"## {len(of_kind)} studies, plant `{kind}`", "", table(of_kind)]
    (RESULTS / "two_days.md").write_text("\n".join(texts) + "\n")
    print("\n".join(texts))


if __name__ == "__main__":
    main()
