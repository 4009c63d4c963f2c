"""Heat pumped and coefficient of performance of a thermoelectric module, Fig. 11 of the paper."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..physics import DCSweep, ThermoelectricModule
from ..rig import Datasheet
from ._panels import caption, panels, write
from ._style import palette, rim, styled


@styled
def plot_dc_sweep(
    module: ThermoelectricModule,
    *,
    T_hot: float,
    delta_T: Sequence[float] = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0),
    datasheet: Datasheet | None = None,
    title: str = "",
) -> Figure:
    r"""Plots curves over the current, one for each temperature difference, with their best points.

    Most heat is pumped at $I = \alpha T_c / R_E$, and the coefficient of performance is largest at
    $I = \alpha \Delta T / (R_E (\sqrt{1 + Z (T_h + T_c) / 2} - 1))$ with
    $Z = \alpha^2 R_{Th} / R_E$.

    **Arguments:**

    - `module`: the thermoelectric module.
    - `T_hot`: the temperature of the hot side, K; the cold side is at `T_hot - delta_T`.
    - `delta_T`: the differences hot - cold, K.
    - `datasheet`: the datasheet of the module, see `jaxtwin.rig.load_module`. Its numbers are drawn
      as points: $Q_{max}$, if it is known, without a temperature difference, and zero heat at
      $\Delta T_{max}$, both at $I_{max}$. A line joins the first point with its curve. A curve for
      $\Delta T_{max}$ is added. The points apply to the hot side temperature of the datasheet.
    - `title`: the title of the figure.

    **Returns:** the figure.
    """
    if datasheet is not None:
        delta_T = sorted({*delta_T, datasheet.maximum_temperature_difference})
    differences = np.asarray(delta_T, float)
    currents = np.linspace(0.0, 1.12 * module.optimum_current(T_hot), 300)
    sweep = module.dc_sweep(currents, differences, T_hot)
    figure, heat, cop = _draw_curves(sweep)
    figure.suptitle(title, x=0.01, ha="left")
    best_cops: list[float] = []
    for difference, color in zip(differences, _colors(sweep), strict=True):
        best = module.optimum_current(T_hot - difference)
        most = module.dc_sweep([best], [difference], T_hot).heat_flow.item()
        if most > 0:
            _mark(heat, best, most, color)
            look = {"ha": "center", "color": palette().ink, "path_effects": rim()}
            write(heat, f"{difference:g} K", (best, most), (0, 6), **look)
        if difference > 0:
            best = _best_cop_current(module, difference, T_hot)
            best_cops.append(module.dc_sweep([best], [difference], T_hot).cop.item())
            _mark(cop, best, best_cops[-1], color)
    # Without a temperature difference it has no limit as the current falls to 0.
    cop.set_ylim(0, 1.08 * max(best_cops, default=4.0))
    note = f"$T_h$ = {T_hot:g} K; dots: best point of each curve in closed form"
    if datasheet is not None:
        most = module.dc_sweep([datasheet.maximum_current], [0.0], T_hot).heat_flow.item()
        _draw_datasheet(heat, datasheet, most)
        note += f"; squares: datasheet, $T_h$ = {datasheet.hot_side_temperature:g} K"
    caption(figure, note)
    return figure


@styled
def plot_dc_curves(sweep: DCSweep) -> Figure:
    """Plots the curves of a DC sweep over the current, one for each temperature difference.

    **Arguments:**

    - `sweep`: the result of `ThermoelectricModule.dc_sweep`.

    **Returns:** the figure.
    """
    figure, _, cop = _draw_curves(sweep)
    # Without a temperature difference it has no limit as the current falls to 0.
    driven = sweep.cop[sweep.delta_T > 0]
    cop.set_ylim(0, 1.08 * max(4.0 if driven.size == 0 else float(np.nanmax(driven)), 0.1))
    return figure


def _draw_datasheet(heat: Axes, sheet: Datasheet, computed: float) -> None:
    """Draws the numbers of the manufacturer: the largest heat flow, joined with the computed one at
    the same current, and zero heat at the largest difference."""
    stated = [(0.0, f"0 W at {sheet.maximum_temperature_difference:g} K")]
    if sheet.maximum_heat_flow is not None:
        stated.append((sheet.maximum_heat_flow, f"{sheet.maximum_heat_flow:g} W at 0 K"))
        low, high = sorted((sheet.maximum_heat_flow, computed))
        heat.vlines(sheet.maximum_current, low, high, color=palette().vermilion, lw=1.4, zorder=3)
    color = palette().vermilion
    for pumped, words in stated:
        at = (sheet.maximum_current, pumped)
        look = {"mfc": palette().ground, "mec": color, "mew": 1.8, "ms": 8, "clip_on": False}
        heat.plot(*at, "s", zorder=4, gid="datasheet", **look)
        va = "bottom" if pumped == 0 else "center"
        look = {"size": 8.5, "color": color, "fontweight": "bold", "path_effects": rim()}
        write(heat, words, at, (-9, 0), ha="right", va=va, zorder=4, **look)
    heat.set_ylim(top=max(heat.get_ylim()[1], 1.13 * max(pumped for pumped, _ in stated)))


def _draw_curves(sweep: DCSweep) -> tuple[Figure, Axes, Axes]:
    """Draws the curves, and returns the figure and its panels."""
    figure, ((heat, cop),) = panels(1, 2, 10.4, 4.3)
    curves = zip(sweep.delta_T, _colors(sweep), sweep.heat_flow, sweep.cop, strict=True)
    for difference, color, pumped, performance in curves:
        heat.plot(sweep.current, pumped, color=color)
        cop.plot(sweep.current, performance, color=color, label=f"{difference:g} K")
    top = max(float(np.max(sweep.heat_flow)), 0.1)
    heat.set(title="Heat pumped", xlabel="current, A", ylabel="$Q_c$, W", ylim=(0, 1.13 * top))
    cop.set(title="Coefficient of performance", xlabel="current, A", ylabel="$Q_c / P$")
    for axes in (heat, cop):
        axes.set_xlim(0, sweep.current.max())
    cop.legend(title="$\\Delta T$", ncols=2)
    return figure, heat, cop


def _colors(sweep: DCSweep) -> np.ndarray:
    return colormaps["viridis"](np.linspace(0.0, 0.85, len(sweep.delta_T)))


def _mark(axes: Axes, current: float, value: float, color: np.ndarray) -> None:
    axes.plot(current, value, "o", color=color, mec=palette().ground, mew=1.2, ms=7)


def _best_cop_current(module: ThermoelectricModule, difference: float, T_hot: float) -> float:
    alpha = float(np.asarray(module.seebeck_coefficient))
    R_E = float(np.asarray(module.electrical_resistance))
    # Z T_c^2 / 2 is the largest difference.
    cold = T_hot - difference
    Z = 2 * module.maximum_temperature_difference(cold) / cold**2
    return alpha * difference / (R_E * (np.sqrt(1 + Z * (T_hot + cold) / 2) - 1))
