"""The Nyquist plot of a loop, with the disk that it keeps away from."""

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from ..control import LoopMargins
from ._style import line_of, palette, styled

LEAST, MOST = 1.8, 6.0
"""The part of the plane to the left of the origin that is shown, so that the disk is in it."""


@styled
def plot_nyquist(margins: LoopMargins) -> Figure:
    r"""Plots the response of a loop in the complex plane, up to half the sample rate.

    The disk around -1 is that of the disk margin: gains between $\gamma_{min}$ and $\gamma_{max}$
    take its ends $-1 / \gamma_{min}$ and $-1 / \gamma_{max}$ to -1. A loop with a single output
    touches it at the frequency of the dot. Of several outputs the curves are the eigenvalues of the
    loop, which stay outside; the disk is that of changes in all outputs, also different ones, and
    no curve need touch it.

    **Arguments:**

    - `margins`: the result of `jaxtwin.control.loop_margins`.

    **Returns:** the figure.
    """
    figure = pyplot.figure(figsize=(5.4, 4.6), layout="constrained")
    axes = figure.subplots()
    low, high = margins.disk.gain
    shown = LEAST
    if low > 0 and np.isfinite(high):
        left, right = -1 / low, -1 / high
        shown = float(np.clip(-1.1 * left, LEAST, MOST))
        axes.add_patch(
            Circle(
                ((left + right) / 2, 0),
                (right - left) / 2,
                fc=palette().vermilion,
                ec=palette().vermilion,
                alpha=0.25,
                lw=1,
                label=f"disk margin {margins.disk.margin:.2f}",
            )
        )
    curves = _curves(margins.response)
    for number, curve in enumerate(curves.T):
        color = palette().cycle[number % len(palette().cycle)]
        name = "loop" if curves.shape[1] == 1 else f"eigenvalue {number + 1}"
        axes.plot(curve.real, curve.imag, color=color, ls=line_of(number), label=name)
        axes.plot(curve.real, -curve.imag, color=color, ls=line_of(number), lw=0.8, alpha=0.5)
        at = int(np.abs(np.log(margins.omega / margins.disk.omega)).argmin())
        axes.plot(curve[at].real, curve[at].imag, "o", ms=4, color=color)
    axes.plot(-1, 0, "+", ms=9, mew=1.6, color=palette().ink)
    axes.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    axes.set(xlim=(-shown, shown / 3), ylim=(-0.6 * shown, 0.6 * shown))
    axes.legend(loc="upper right")
    axes.set_title(f"nearest to instability at {margins.disk.omega:.2g} rad/s")
    return figure


def _curves(response: np.ndarray) -> np.ndarray:
    """The eigenvalues of the loop, (frequency, outputs), each along one curve."""
    eigenvalues = np.linalg.eigvals(response)
    for number in range(1, len(eigenvalues)):
        left = list(range(eigenvalues.shape[1]))
        row = []
        for value in eigenvalues[number - 1]:
            near = min(left, key=lambda k: abs(eigenvalues[number, k] - value))
            left.remove(near)
            row.append(near)
        eigenvalues[number] = eigenvalues[number, row]
    return eigenvalues
