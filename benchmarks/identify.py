"""How well does a twin that is found from a log alone predict the rest of the log?

    python -m benchmarks.identify FOLDER_WITH_LOGS

The first part of each public log is identified, the rest is predicted, beside the two simple
models, fitted to the same first part. The splits are those of the README beside the logs.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxtwin import identify, read_recording
from jaxtwin.identification._baselines import fit_first_order, fit_two_capacities
from jaxtwin.identification._log import screened_log

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

SPLITS = {"lamp": 1000.0, "tec-chamber": 500.0, "mash-pot-20l": 3200.0, "tclab-step": 360.0}

HEAD = (
    "log",
    "first order with delay, %",
    "two capacities, %",
    "identified, %",
    "RMSE, K",
    "inside, %",
    "band, K",
    "wall / CPU, s",
)


def fit_percent(readings: np.ndarray, predicted: np.ndarray) -> float:
    """NRMSE fit, %."""
    error = np.linalg.norm(readings - predicted)
    return float(100 * (1 - error / np.linalg.norm(readings - readings.mean())))


def judged(path: Path, split: float) -> list[dict[str, Any]]:
    """The numbers of each channel of a log."""
    log = read_recording(path)
    assert log.temperatures is not None
    began, cpu = time.perf_counter(), time.process_time()
    identified = identify(log.between(None, split))
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    band = identified.predict(log)
    averaged = screened_log(log)
    duty, early = np.asarray(averaged.experiment.duty), averaged.experiment.time < split
    later = log.time >= split
    results = []
    for number, channel in enumerate(log.channels):
        column = averaged.temperatures[:, number]
        first = fit_first_order(duty, column, early, averaged.sample_time)
        second = fit_two_capacities(duty, column, early, averaged.sample_time, first)
        readings = log.temperatures[later, number]
        low, middle, high = (edge[later, number] for edge in (band.lower, band.middle, band.upper))
        results.append(
            {
                "log": f"{path.stem}, {channel}",
                "first_order": fit_percent(column[~early], first.predicted[~early]),
                "two_capacities": fit_percent(column[~early], second[~early]),
                "identified": fit_percent(readings, middle),
                "rmse": float(np.sqrt(np.mean((readings - middle) ** 2))),
                "inside": float(100 * np.mean((readings > low) & (readings < high))),
                "width": float(np.mean(high - low)),
                "wall": wall,
                "cpu": cpu,
                "structure": identified.candidates[0].structure,
            }
        )
    return results


def page(rows: list[dict[str, Any]], where: dict[str, Any]) -> str:
    """The results as a page."""
    names = ("first_order", "two_capacities", "identified")
    cells = [
        (
            row["log"],
            *(f"{row[name]:.1f}" for name in names),
            f"{row['rmse']:.2f}",
            f"{row['inside']:.0f}",
            f"{row['width']:.1f}",
            f"{row['wall']:.0f} / {row['cpu']:.0f}",
        )
        for row in rows
    ]
    chosen = "".join(f"- {row['log']}: {row['structure']}\n" for row in rows)
    return (
        "# A twin from the first part of a log\n\n"
        "Public logs of ordinary devices. The first part of each was identified, the rest is "
        "predicted: the fit of what follows, the error of the identified twin, the part of the "
        "readings inside its band of 95 % and the band's mean width, and the time of `identify`, "
        f"with compilation, on {where['cores']} cores of {where['processor']}, {where['date']} "
        "(`python -m benchmarks.identify`).\n\n" + table(HEAD, cells) + "\nChosen:\n\n" + chosen
    )


def main() -> None:
    """Runs the benchmark."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    rows = [row for n, split in SPLITS.items() for row in judged(given.folder / f"{n}.csv", split)]
    where = machine()
    write_results(given.out / "identify.json", {"machine": where, "logs": rows}, page(rows, where))


if __name__ == "__main__":
    main()
