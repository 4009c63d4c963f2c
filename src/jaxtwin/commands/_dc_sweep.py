"""`jaxtwin dc-sweep`: heat pumped and coefficient of performance of a thermoelectric module."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._display import aligned
from ._options import JsonOption
from ._output import (
    check_folder,
    check_json,
    make_folder,
    say,
    say_written,
    write_json,
    write_pictures,
)
from ._show_progress import show_progress

if TYPE_CHECKING:
    from ..physics import ThermoelectricModule
    from ..rig import Datasheet


def dc_sweep(
    module: Annotated[
        str, typer.Argument(metavar="MODULE", help="A bundled module, e.g. TEC1-12706.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="A folder for the curves: .nc and .png."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Sweep the current of a module: heat pumped and coefficient of performance."""
    from ..physics import ThermoelectricModule
    from ..rig import load_module

    check_json(json)
    check_folder(out)
    sheet = load_module(module)
    T_hot = sheet.hot_side_temperature
    constants = ThermoelectricModule.from_datasheet(module)
    numbers = _numbers(constants, T_hot)
    if out is not None:
        with show_progress() as progress:
            progress.step(f"drawing into {out}")
            _save(constants, sheet, out)
    say(_table(module, constants, T_hot, numbers), json)
    say_written(out, json_path=json)
    write_json(json, {"module": module, "T_hot_K": T_hot, "best_points": numbers})


def _numbers(module: "ThermoelectricModule", T_hot: float) -> list[dict[str, float]]:
    """The current at which most heat is pumped, for each temperature difference."""
    rows = []
    for difference in range(0, 80, 10):
        best = module.optimum_current(T_hot - difference)
        sweep = module.dc_sweep([best], [float(difference)], T_hot)
        if (heat := sweep.heat_flow.item()) > 0:
            rows.append(
                {
                    "delta_T_K": float(difference),
                    "current_A": best,
                    "heat_flow_W": heat,
                    "cop": sweep.cop.item(),
                }
            )
    return rows


def _table(
    name: str, module: "ThermoelectricModule", T_hot: float, numbers: list[dict[str, float]]
) -> str:
    rows = [("delta T, K", "current, A", "heat pumped, W", "COP")]
    rows += [tuple(f"{value:.3g}" for value in row.values()) for row in numbers]
    return (
        f"{name} at a hot side of {T_hot:g} K: {module.seebeck_coefficient:.4f} V/K, "
        f"{module.electrical_resistance:.3f} ohm, {module.thermal_resistance:.3f} K/W\n"
        f"where most heat is pumped:\n{aligned(rows)}"
    )


def _save(module: "ThermoelectricModule", sheet: "Datasheet", folder: Path) -> None:
    import numpy as np

    from ..plots import plot_dc_sweep

    name, T_hot = sheet.name, sheet.hot_side_temperature
    picture = plot_dc_sweep(module, T_hot=T_hot, datasheet=sheet, title=name)
    currents = np.linspace(0.0, 1.12 * module.optimum_current(T_hot), 200)
    sweep = module.dc_sweep(currents, np.arange(0.0, 80.0, 10.0), T_hot)
    make_folder(folder)
    sweep.save(folder / f"{name}.nc")
    write_pictures(folder, [(name, picture)])
