"""Step 3 of the paper, multidomain simulation, and the recordings that the demo uses: those of the
authors, or the bundled synthetic ones.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from .._statistics import mean_fit_percent
from ..data import synthetic_recordings
from ..errors import RecordingError
from ..io import Experiment, find_recordings, read_recording
from ..matching import Fit
from ..physics import ThermoelectricModule, Twin
from ..plots import plot_comparison, plot_dc_sweep, plot_plate_map, to_png
from ..rig import load_module
from ..simulation import Run
from ._page import KeyNumbers, ReportPicture, Section, Text

VARIABLE = "JAXTWIN_RECORDINGS"


@final
@dataclass(frozen=True)
class Source:
    """Recordings and their origin.

    **Arguments:**

    - `experiments`: the recordings.
    - `real`: whether they were measured on a rig.
    - `note`: a sentence for the report.
    """

    experiments: tuple[Experiment, ...]
    real: bool
    note: str


def find_source(folder: Path | None) -> Source:
    """Returns the authors' recordings if they are found, else the synthetic ones.

    **Arguments:**

    - `folder`: the folder of the recordings; None to look for them in the usual places.

    **Raises:** `RecordingError` if a folder was given, here or by `JAXTWIN_RECORDINGS`, and does
    not contain them: recordings that were asked for are never silently replaced.
    """
    try:
        paths = find_recordings(folder)
    except RecordingError:
        if folder is not None or os.environ.get(VARIABLE):
            raise
        return synthetic_source(
            "The authors' recordings are not on this machine (`jaxtwin data fetch` downloads them, "
            "`--recordings DIR` names their folder): what follows was done on the synthetic "
            "recordings that come with jaxtwin. No rig was measured, and no number here can be "
            "compared with the paper's."
        )
    return Source(
        tuple(read_recording(path) for path in paths),
        True,
        f"The authors' recordings, found in `{paths[0].parent}`.",
    )


def synthetic_source(note: str = "") -> Source:
    """The synthetic recordings that come with jaxtwin."""
    return Source(tuple(read_recording(path) for path in synthetic_recordings()), False, note)


# The mean fit of the paper's values on the paper's circuit, %, by an independent implementation
# (scipy's LSODA); the paper reports "an average accuracy of 70 %".
REPORTED_FIT_PERCENT = 69.2

# The times of the maps, s; the first three are those of the paper's Fig. 5.
MAP_TIMES = (100.0, 300.0, 500.0, 600.0, 1000.0)


# The modules of the paper's tables and of its model file.
MODULES = ("CP10-127-05", "TEC1-12706")


def dc_sweeps() -> Section:
    """The section on the modules without a rig."""
    pictures = []
    for name in MODULES:
        sheet = load_module(name)
        module = ThermoelectricModule.from_datasheet(name)
        hot = sheet.hot_side_temperature
        figure = plot_dc_sweep(module, T_hot=hot, datasheet=sheet, title=name)
        best = module.optimum_current(hot)
        most = module.dc_sweep([best], [0.0], hot).heat_flow.item()
        largest = _largest_difference(module, hot)
        pictures.append(
            ReportPicture(
                f"dc-sweep-{name}",
                to_png(figure),
                f"{name}: {float(np.asarray(module.seebeck_coefficient)):.4f} V/K, "
                f"{float(np.asarray(module.electrical_resistance)):.3f} Ω, "
                f"{float(np.asarray(module.thermal_resistance)):.3f} K/W. It pumps at most "
                f"{most:.1f} W without a temperature difference, at {best:.2f} A; no current "
                f"reaches a difference above {largest:.1f} K (the paper's Fig. 11).",
            )
        )
    return Section(
        "3 Simulate: the modules, the plate, the published twin",
        (
            Text(
                "A thermoelectric module has three constants, which follow from its datasheet by "
                "eq. (10) of the paper. Swept over the current with its hot side held, it shows "
                "how much heat it pumps and at what cost. Squares are what the datasheet states in "
                "numbers; of its curves none has been digitised."
            ),
            *pictures,
        ),
    )


def simulate_published(twin: Twin, source: Source) -> tuple[Section, list[Run], dict[str, float]]:
    """The twin with the paper's final values, run through the recordings.

    **Returns:** the section, the runs, and their numbers.
    """
    runs = [twin.simulate(experiment) for experiment in source.experiments]
    numbers = fit_numbers(runs)
    numbers["warm_simulation_s"] = min(_timed(twin, source.experiments[0]) for _ in range(10))
    hottest = max(runs, key=lambda run: run.states.max())
    numbers["hottest_node_degC"] = float(hottest.states.max())
    node = hottest.nodes[int(hottest.states.max(axis=0).argmax())]
    if source.real:
        verdict = (
            f"The mean fit of {numbers['mean_fit_percent']:.1f} % is the “average accuracy of "
            f"70 %” that the paper reports ({REPORTED_FIT_PERCENT} % by an independent "
            "implementation)."
        )
    else:
        verdict = "The values were published for another rig's recordings, and fit these badly."
    section = Section(
        "The published twin",
        (
            Text(
                "The circuit with the final values of the paper's Table 4, ambient and start at "
                f"15 °C, driven as the rig was. {verdict} The same values put the plate side of a "
                f"cell at {numbers['hottest_node_degC']:.0f} °C: they fit the plate without "
                "describing the cells."
            ),
            KeyNumbers(
                (
                    (f"{numbers['mean_fit_percent']:.1f} %", "mean NRMSE fit"),
                    (f"{numbers['rmse_K']:.2f} K", "RMSE"),
                    (f"{numbers['hottest_node_degC']:.0f} °C", f"hottest node ({node})"),
                    (f"{1e3 * numbers['warm_simulation_s']:.1f} ms", "a 1000 s run, compiled"),
                )
            ),
            ReportPicture(
                "published-response",
                to_png(plot_comparison(runs)),
                "Published twin against recording; the fit of a channel is "
                "100 (1 - |y - ŷ| / |y - mean y|) %.",
            ),
        ),
        level=3,
    )
    return section, runs, numbers


def plate_map(fit: Fit) -> Section:
    """The section with the plate's temperatures over time, simulated by the matched twin."""
    run = next(iter(fit.runs.values()))
    rig = fit.twin.rig
    samples = np.clip(np.searchsorted(run.time, MAP_TIMES), 0, len(run.time) - 1)
    figure = plot_plate_map(
        rig,
        run.states[samples, : len(rig.plate.element_names)],
        [f"{run.time[sample]:g} s" for sample in samples],
        columns=3,
    )
    return Section(
        "The plate over time",
        (
            ReportPicture(
                "plate-map",
                to_png(figure),
                "Temperatures of the plate's elements (the paper's Figs. 5 and 13b), by the twin "
                f"matched with one ambient per recording, driven as in {run.experiment.name}, and "
                "the places of the camera's channels.",
            ),
        ),
        level=3,
    )


def _timed(twin: Twin, experiment: Experiment) -> float:
    began = time.perf_counter()
    twin.simulate(experiment)
    return time.perf_counter() - began


def fit_numbers(runs: Sequence[Run]) -> dict[str, float]:
    """Mean fit and RMSE over the channels of all runs."""
    fits = [fit for run in runs for fit in run.fit_percent.values()]
    squares = [run.rmse**2 for run in runs for _ in run.channels]
    return {
        "mean_fit_percent": mean_fit_percent(fits),
        "rmse_K": float(np.sqrt(np.mean(squares))),
    }


def _largest_difference(module: ThermoelectricModule, T_hot: float) -> float:
    """The difference that the module reaches without a load, from Z T_c^2 / 2 = T_h - T_c, K."""
    Z = 2 * module.maximum_temperature_difference(T_hot) / T_hot**2
    return T_hot - (np.sqrt(1 + 2 * Z * T_hot) - 1) / Z
