"""Heat pumped and coefficient of performance of a thermoelectric module, Fig. 11 of the paper."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps, pyplot
from matplotlib.figure import Figure

from ..physics import ThermoelectricModule
from ._style import INK, MUTED, styled


@styled
def plot_dc_sweep(
    module: ThermoelectricModule,
    *,
    T_hot: float,
    delta_T: Sequence[float] = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0),
    title: str = "",
) -> Figure:
    r"""Curves over the current, one for each temperature difference, with their best points.

    Most heat is pumped at $I = \alpha T_c / R_E$, and the coefficient of performance is largest at
    $I = \alpha \Delta T / (R_E (\sqrt{1 + Z (T_h + T_c) / 2} - 1))$ with
    $Z = \alpha^2 R_{Th} / R_E$.

    **Arguments:**

    - `module`: of which one.
    - `T_hot`: hot side temperature, K; the cold side is at `T_hot - delta_T`.
    - `delta_T`: differences hot - cold, K.
    - `title`: of the figure.

    **Returns:** the figure.
    """
    differences = np.asarray(delta_T, float)
    currents = np.linspace(0.0, 1.12 * module.optimum_current(T_hot), 300)
    sweep = module.dc_sweep(currents, differences, T_hot)
    colors = colormaps["viridis"](np.linspace(0.0, 0.85, len(differences)))
    figure = pyplot.figure(figsize=(10.4, 4.3), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left")
    heat, cop = figure.subplots(1, 2)
    best_cops: list[float] = []
    for difference, color, pumped, performance in zip(
        differences, colors, sweep.heat_flow, sweep.cop, strict=True
    ):
        heat.plot(currents, pumped, color=color)
        cop.plot(currents, performance, color=color, label=f"{difference:g} K")
        best = module.optimum_current(T_hot - difference)
        most = module.dc_sweep([best], [difference], T_hot).heat_flow.item()
        if most > 0:
            _mark(heat, best, most, color)
            heat.annotate(
                f"{difference:g} K", (best, most), xytext=(0, 6), textcoords="offset points",
                ha="center", color=INK, fontsize=9,
            )  # fmt: skip
        if difference > 0:
            best = _best_cop_current(module, difference, T_hot)
            best_cops.append(module.dc_sweep([best], [difference], T_hot).cop.item())
            _mark(cop, best, best_cops[-1], color)
    top = float(np.max(sweep.heat_flow))
    heat.set(title="Heat pumped", xlabel="current, A", ylabel="$Q_c$, W", ylim=(0, 1.13 * top))
    cop.set(title="Coefficient of performance", xlabel="current, A", ylabel="$Q_c / P$")
    # Without a temperature difference it has no limit as the current falls to 0.
    cop.set_ylim(0, 1.08 * max(best_cops, default=4.0))
    for axes in (heat, cop):
        axes.set_xlim(0, currents[-1])
    cop.legend(title="$\\Delta T$", ncols=2)
    figure.supxlabel(
        f"$T_h$ = {T_hot:g} K; dots: best point of each curve in closed form",
        fontsize=9, color=MUTED, x=0.01, ha="left",
    )  # fmt: skip
    return figure


def _mark(axes, current: float, value: float, color) -> None:
    axes.plot([current], [value], "o", color=color, mec="white", mew=1.2, ms=7, clip_on=True)


def _best_cop_current(module: ThermoelectricModule, difference: float, T_hot: float) -> float:
    alpha = float(np.asarray(module.seebeck_coefficient))
    R_E = float(np.asarray(module.electrical_resistance))
    # Z T_c^2 / 2 is the largest difference.
    cold = T_hot - difference
    Z = 2 * module.maximum_temperature_difference(cold) / cold**2
    return alpha * difference / (R_E * (np.sqrt(1 + Z * (T_hot + cold) / 2) - 1))
