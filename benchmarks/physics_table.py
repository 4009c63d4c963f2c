"""What each part of the physics is worth: the two-cell rig from the paper's twin to the full one.

Each row adds one part to the row above and matches the three step recordings together. The second
half is predicted by a match that gives the samples after 500 s no weight. AIC and BIC count
n = samples / 58 as independent (the autocorrelation of the last row's residuals), the same n for
all rows: n ln(RMSE^2) + 2 k and n ln(RMSE^2) + k ln n, with k the matched values and the camera's
shapes. Fit and RMSE of the last row are with the camera's common error, its prediction without.

    python benchmarks/physics_table.py FOLDER_WITH_RECORDINGS
"""

import argparse
import copy
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxtwin import Experiment, Fit, Twin, match, read_recording
from jaxtwin.data import data_folder
from jaxtwin.matching._fit import solution_of
from jaxtwin.rig import rig_from_tables
from jaxtwin.simulation import Run, fit_percent

HALF = 500.0
CORRELATED = 58.0

Document = dict[str, Any]


def without_camera(rig: Document) -> None:
    del rig["camera"]["common_error"]


def without_registration(rig: Document) -> None:
    del rig["camera"]["registration"]


def without_gains(rig: Document) -> None:
    for channel in rig["channels"]:
        channel.pop("gain")


def without_lag(rig: Document) -> None:
    del rig["driver"]["lag"], rig["driver"]["delay"]


def with_linear_losses(rig: Document) -> None:
    del rig["plate"]["film_exponent"], rig["plate"]["emissivity"]


def with_ideal_supply(rig: Document) -> None:
    rig["driver"]["supply_resistance"] = "0.001 ohm"


def with_massless_sinks(rig: Document) -> None:
    for cell in rig["cells"]:
        del cell["sink_capacitance"], cell["sink_air_resistance"]


def with_one_contact(rig: Document) -> None:
    for cell, element in zip(rig["cells"], ("V23", "V26"), strict=True):
        cell["contacts"] = {element: cell["contacts"][element]}


def with_mean_voltage(rig: Document) -> None:
    rig["driver"]["averaging"] = "voltage"


PARTS: tuple[tuple[str, Callable[[Document], None]], ...] = (
    ("+ on/off switching of the bridge", with_mean_voltage),
    ("+ contacts to neighbouring elements", with_one_contact),
    ("+ heat capacity of the sinks", with_massless_sinks),
    ("+ resistance of the supply", with_ideal_supply),
    ("+ natural convection and radiation", with_linear_losses),
    ("+ lag and delay of the driver", without_lag),
    ("+ gain of each channel", without_gains),
    ("+ registration of the camera", without_registration),
    ("+ camera's common error", without_camera),
)
"""What each row adds, and how to take it away."""


def stages() -> list[tuple[str, Twin]]:
    """Twins by geometry, each with one part more."""
    full = tomllib.loads((data_folder() / "rigs" / "dual-cell.toml").read_text())
    names = ["geometry: 1 mm copper, handbook priors", *(name for name, _ in PARTS)]
    found = []
    for count, name in enumerate(names):
        rig = copy.deepcopy(full)
        for _, take_away in PARTS[count:]:
            take_away(rig)
        text = repr(rig)
        used = {key: row for key, row in rig["parameters"].items() if text.count(f"'{key}'") > 1}
        rig["parameters"] = used
        found.append((name, Twin(rig_from_tables(rig, name))))
    return found


def hottest_cell(runs: Sequence[Run], twin: Twin) -> float:
    """Of all cell sides at all times, degC."""
    sides = [n for n, node in enumerate(twin.netlist.nodes) if node.kind == "cell"]
    return float(max(run.states[:, sides].max() for run in runs))


def second_half(fit: Fit) -> float:
    """RMSE after `HALF` of what a match without it predicts, K."""
    errors = [
        (fit.runs[name].temperatures - experiment.temperatures)[experiment.time > HALF]
        for name, experiment in zip(fit.recordings, fit.experiments, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def row(name: str, values: Sequence[float | None], digits: Sequence[int]) -> str:
    cells = ["-" if v is None else f"{v:.{d}f}" for v, d in zip(values, digits, strict=True)]
    return f"| {' | '.join([name, *cells])} |"


DIGITS = (1, 2, 2, 0, 0, 0, 0, 0)


def matched(name: str, twin: Twin, experiments: list[Experiment]) -> str:
    fit = match(twin, experiments)
    solution = solution_of(fit)
    tail = {
        e: [(float(experiment.time[experiment.time > HALF][0]), float(experiment.time[-1]))]
        for e, experiment in zip(fit.recordings, experiments, strict=True)
    }
    half = match(twin, experiments, masks=tail)
    samples = sum(experiment.size for experiment in recorded_temperatures(experiments))
    shapes = sum(
        1
        + int(np.ceil(np.ptp(experiment.time) / error.drift_time) + 1)
        + len(error.relaxation) * len(c)
        for experiment, c in zip(experiments, (c.events for c in fit.camera.values()), strict=True)
        if (error := solution.problem.common_error) is not None
    )
    n, k = samples / CORRELATED, len(solution.vector) + shapes
    deviance = n * np.log(fit.rmse**2)
    values = (
        fit.mean_fit_percent,
        fit.rmse,
        second_half(half),
        k,
        deviance + 2 * k,
        deviance + k * np.log(n),
        hottest_cell(list(fit.runs.values()), twin),
        fit.wall_time,
    )
    return row(name, values, DIGITS)


def recorded_temperatures(experiments: list[Experiment]) -> list[np.ndarray]:
    return [
        experiment.temperatures for experiment in experiments if experiment.temperatures is not None
    ]


def published(experiments: list[Experiment]) -> str:
    """The paper's twin with the paper's values."""
    twin = Twin("paper-2024")
    twin = twin.with_values(twin.rig.parameter_sets["published"])
    runs = [twin.simulate(experiment) for experiment in experiments]
    pairs = [
        (recorded, run.temperatures)
        for recorded, run in zip(recorded_temperatures(experiments), runs, strict=True)
    ]
    fits = np.concatenate([np.atleast_1d(fit_percent(*pair)) for pair in pairs])
    errors = np.concatenate([(run - recorded).ravel() for recorded, run in pairs])
    late = np.concatenate(
        [(r - y)[e.time > HALF].ravel() for (y, r), e in zip(pairs, experiments, strict=True)]
    )
    size, after = (float(np.sqrt(np.mean(part**2))) for part in (errors, late))
    hottest = hottest_cell(runs, twin)
    values = (float(fits.mean()), size, after, None, None, None, hottest, None)
    return row("paper's twin, published values", values, DIGITS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    experiments = [read_recording(folder / f"peltierMIMOStepSec{zone}.mat") for zone in "ABC"]
    print(
        "| twin | fit % | RMSE K | RMSE of the predicted second half, K | k | AIC | BIC "
        "| hottest cell degC | wall s |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    print(published(experiments), flush=True)
    as_built = Twin("paper-2024")
    print(matched("as-built circuit, matched with jaxtwin", as_built, experiments), flush=True)
    for name, twin in stages():
        print(matched(name, twin, experiments), flush=True)


if __name__ == "__main__":
    main()
