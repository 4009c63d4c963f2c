"""Plot of a closed loop: outputs and references, the plate's temperature range, duty and power."""

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from ..control import ClosedLoopRun
from ._style import line_of, palette, styled


@styled
def plot_closed_loop(run: ClosedLoopRun) -> Figure:
    """Plots the outputs beside their references, the plate's range, the duty of the cells and their
    power.

    **Arguments:**

    - `run`: the result of `simulate_closed_loop`.

    **Returns:** the figure.
    """
    figure = pyplot.figure(figsize=(7.2, 6.4), layout="constrained")
    above, duty, power = figure.subplots(3, 1, sharex=True, height_ratios=(4, 1.4, 1.4))
    time, plate = run.time, np.asarray(run.loop.plate)
    if run.loop.elements:
        above.fill_between(
            time,
            plate.min(axis=1),
            plate.max(axis=1),
            color=palette().faint,
            lw=0,
            label="plate, all elements",
        )
    references = np.unique(run.reference, axis=1).T
    for number, reference in enumerate(references):
        label = "reference" if number == 0 else None
        above.step(
            time, reference, where="post", color=palette().muted, ls="--", lw=1.2, label=label
        )
    for number, (name, output) in enumerate(zip(run.outputs, run.output.T, strict=True)):
        above.plot(time, output, color=palette().cycle[number % len(palette().cycle)], label=name)
    above.set_ylabel("temperature, °C")
    # Legends are above the axes, because curves would cross them inside.
    above_right = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
    above.legend(ncols=4, **above_right)
    names = run.run.experiment.cell_names
    for number, (part, watts) in enumerate(zip(run.duty.T, run.power.T, strict=True)):
        color = palette().cycle[number % len(palette().cycle)]
        look = {"color": color, "lw": 1.4, "ls": line_of(number)}
        duty.step(time, 100 * part, where="post", label=names[number], **look)
        power.plot(time, watts, **look)
    duty.legend(ncols=len(run.duty.T), **above_right)
    duty.set_ylabel("duty, %")
    if len(run.power.T) > 1:
        power.plot(time, run.power.sum(axis=1), color=palette().ink, lw=1.2, label="all cells")
        power.legend(**above_right)
    power.set_ylabel("power, W")
    power.set_xlabel("time, s")
    power.set_xlim(time[0], time[-1])
    return figure
