"""How well does a twin that is found from a log alone predict the rest of the log?

    python -m benchmarks.identify FOLDER_WITH_LOGS
    python -m benchmarks.identify --devices 60

The first part of each public log is identified, the rest is predicted, beside the two simple
models, fitted to the same first part. The splits are those of the README beside the logs. With
`--devices`, random thermal networks take the place of the logs: the rest is then compared with what
their temperatures really are.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxtwin import (
    Experiment,
    Twin,
    identify,
    match,
    prediction_band,
    read_recording,
    simulate,
)
from jaxtwin.identification._baselines import fit_first_order, fit_two_capacities
from jaxtwin.identification._log import screened_log
from jaxtwin.identification._network import Family
from jaxtwin.identification._structures import kind_of
from jaxtwin.matching import ModelError
from jaxtwin.rig import rig_from_tables

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


# Networks that a person may write down, by the kinds of their parts.
NETWORKS = {
    "one body": {"linear", "link"},
    "two bodies": {"linear", "shell", "link"},
    "two bodies, radiation, lag": {"linear", "radiation", "shell", "lag", "link"},
}


def judged_networks(path: Path, split: float) -> list[dict[str, Any]]:
    """The bands of networks that are given, matched to the first part of a log, with and without
    the error of the model itself."""
    log = read_recording(path)
    assert log.temperatures is not None
    early = log.between(None, split)
    averaged = screened_log(early)
    duty, known = np.asarray(averaged.experiment.duty), np.ones(len(averaged.experiment.time), bool)
    firsts = [
        fit_first_order(duty, column, known, averaged.sample_time)
        for column in averaged.temperatures.T
    ]
    family = Family.of(averaged, firsts, None, False)
    later = log.between(split)
    results = []
    for name, kinds in NETWORKS.items():
        parts = {part for part in family.choices if kind_of(part) in kinds}
        fit = match(Twin(rig_from_tables(family.tables(parts), name)), early)
        without, band = (
            prediction_band(each, fit.recordings[0], experiment=log).between(split)
            for each in (replace(fit, model_error=ModelError()), fit)
        )
        errors = band.middle - later.temperatures
        for number, channel in enumerate(log.channels):
            results.append(
                {
                    "log": f"{path.stem}, {channel}",
                    "network": name,
                    "rmse": float(np.sqrt(np.mean(errors[:, number] ** 2))),
                    "inside_without": float(100 * without.coverage[number]),
                    "width_without": float(without.width[number]),
                    "inside": float(100 * band.coverage[number]),
                    "width": float(band.width[number]),
                }
            )
    return results


def table_of_networks(rows: list[dict[str, Any]]) -> str:
    """The bands of given networks as a part of the page."""
    head = ("log", "network", "RMSE, K", "without: inside, %", "width, K", "inside, %", "width, K")
    names = ("rmse", "inside_without", "width_without", "inside", "width")
    cells = [(row["log"], row["network"], *(f"{row[name]:.3g}" for name in names)) for row in rows]
    return (
        "\n## Bands of networks that are given\n\n"
        "The same first parts, matched to networks that a person may write down, most of which "
        "lack something: the band of 95 % over what follows, without and with the error of the "
        "model itself (`Fit.model_error`).\n\n" + table(head, cells)
    )


def random_device(random: np.random.Generator) -> tuple[Twin, str]:
    """A heated block with a random choice of other parts, and what it has, in words."""

    def about(value: float, spread: float = 0.5) -> float:
        return float(value * np.exp(spread * random.standard_normal()))

    rise, tau = random.uniform(20, 80), about(600)
    resistance = about(1.0)
    power = rise / resistance
    capacitance = tau / resistance
    bodies = [{"name": "block", "capacitance": f"{capacitance} J/K"}]
    links, words = [], []
    channel = {"name": "T", "nodes": ["block"]}
    heater = {"name": "heater", "power": f"{power} W", "contacts": ["block"]}
    losses = [("linear",), ("convection",), ("radiation",), ("linear", "radiation")]
    for loss in losses[random.integers(len(losses))]:
        share = 1 / resistance
        laws = {
            "linear": {"resistance": f"{1 / share} K/W"},
            "convection": {"convection": f"{share} W/K"},
            "radiation": {"radiating_area": f"{share / 6.5} m^2"},
        }
        links.append({**laws[loss], "between": ["block-ambient"]})
        words.append(loss)
    for back in ("wall", "shell"):
        if random.random() < 0.4:
            bodies.append({"name": back, "capacitance": f"{about(2 * capacitance)} J/K"})
            contact = {"resistance": f"{about(0.5 * resistance)} K/W"}
            links.append({**contact, "between": [f"block-{back}"]})
            if back == "shell":
                loss = {"resistance": f"{about(2 * resistance)} K/W"}
                links.append({**loss, "between": ["shell-ambient"]})
            words.append(back)
    if random.random() < 0.5:
        channel["lag"] = f"{about(0.05 * tau)} s"
        words.append("lag")
    if random.random() < 0.4:
        heater["capacitance"] = f"{about(0.2 * capacitance)} J/K"
        heater["contacts"] = {"block": f"{about(0.3 * resistance)} K/W"}
        words.append("heater")
    tables = {
        "format": 1,
        "name": "device",
        "ambient": {"temperature": f"{random.uniform(17, 25)} degC"},
        "sensors": {"noise": "0.1 K"},
        "channels": [channel],
        "heaters": [heater],
        "bodies": bodies,
        "links": links,
    }
    return Twin(rig_from_tables(tables, "device")), ", ".join(words)


def judged_device(seed: int) -> dict[str, Any]:
    """The numbers of one random device: the first 60 % of its log are identified."""
    random = np.random.default_rng(seed)
    device, parts = random_device(random)
    duration = float(np.round(random.uniform(3600, 10_800)))
    time_ = np.arange(0.0, duration, 10.0)
    lengths = np.cumsum(random.uniform(200, 900, 60))
    levels = np.append(0.0, random.uniform(0, 1, 60))
    duty = levels[np.searchsorted(lengths, time_)][:, None]
    truth = simulate(device, Experiment(time_, duty, channels=["T"])).temperatures
    noise = random.uniform(0.1, 0.3)
    readings = truth + random.normal(0, noise, truth.shape)
    log = Experiment(time_, duty, channels=["T"], temperatures=readings, name=f"device {seed}")
    split = float(time_[int(0.6 * len(time_))])
    began, cpu = time.perf_counter(), time.process_time()
    identified = identify(log.between(None, split))
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    band = identified.predict(log)
    later = time_ >= split
    inside = (readings > band.lower) & (readings < band.upper)
    return {
        "seed": seed,
        "parts": parts,
        "structure": identified.candidates[0].structure,
        "fit": fit_percent(truth[later, 0], band.middle[later, 0]),
        "rmse": float(np.sqrt(np.mean((truth - band.middle)[later] ** 2))),
        "range": float(np.ptp(truth)),
        "inside": float(100 * inside[later].mean()),
        "width": float((band.upper - band.lower)[later].mean()),
        "noise": float(noise),
        "wall": wall,
        "cpu": cpu,
    }


def page_of_devices(rows: list[dict[str, Any]], where: dict[str, Any]) -> str:
    """The results of random devices as a page."""
    fits, inside, cpu = (np.array([row[name] for row in rows]) for name in ("fit", "inside", "cpu"))
    ranges = np.array([row["range"] for row in rows])
    errors = 100 * np.array([row["rmse"] for row in rows]) / ranges
    widths = 100 * np.array([row["width"] for row in rows]) / ranges
    near = int(np.sum(errors <= 2))
    lines = [
        ("devices", f"{len(rows)}"),
        ("predicted within 2 % of the range of their temperatures (RMSE)", f"{near}"),
        ("this error, median and worst, %", f"{np.median(errors):.2f}, {errors.max():.2f}"),
        (
            "fit of these temperatures, median and worst, %",
            f"{np.median(fits):.1f}, {fits.min():.1f}",
        ),
        (
            "readings inside the band of 95 %: mean, median, least, %",
            f"{inside.mean():.1f}, {np.median(inside):.1f}, {inside.min():.1f}",
        ),
        ("mean width of the band over the range of the readings, %", f"{widths.mean():.1f}"),
        ("CPU time of `identify`, median, s", f"{np.median(cpu):.0f}"),
    ]
    return (
        "# Twins of random devices from a log alone\n\n"
        "A heated block with a loss by conduction, natural convection, radiation or two of them; "
        "by chance a wall, a shell, a lag of the sensor and a heater with a heat capacity. Duties "
        "change every 200 to 900 s, one to three hours are logged every 10 s with noise of 0.1 to "
        "0.3 K. The first 60 % are identified; the rest is compared with the device's own "
        f"temperatures. {where['cores']} cores of {where['processor']}, {where['date']} "
        "(`python -m benchmarks.identify --devices 60`).\n\n" + table(("", ""), lines)
    )


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
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--devices", type=int, default=0, help="random devices in place of logs")
    parser.add_argument("--first-seed", type=int, default=1000)
    given = parser.parse_args()
    where = machine()
    if given.devices:
        seeds = range(given.first_seed, given.first_seed + given.devices)
        rows = []
        for seed in seeds:
            rows.append(judged_device(seed))
            print(rows[-1], flush=True)
        text = page_of_devices(rows, where)
        write_results(
            given.out / "identify_devices.json", {"machine": where, "devices": rows}, text
        )
        return
    if given.folder is None:
        parser.error("expected a folder of logs, or --devices")
    paths = {given.folder / f"{name}.csv": split for name, split in SPLITS.items()}
    rows = [row for path, split in paths.items() for row in judged(path, split)]
    networks = [row for path, split in paths.items() for row in judged_networks(path, split)]
    numbers = {"machine": where, "logs": rows, "networks": networks}
    text = page(rows, where) + table_of_networks(networks)
    write_results(given.out / "identify.json", numbers, text)


if __name__ == "__main__":
    main()
