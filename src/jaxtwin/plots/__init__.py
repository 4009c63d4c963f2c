"""Plots. Each function returns the figure, or the axes if it draws into axes.

They are drawn with matplotlib in jaxtwin's style; matplotlib's settings do not change. `style`
selects another style for a block of code: for the column of a journal, print without colours, or a
dark notebook.

A picture is layers on one grid of panels. `_style` has the colours and the size of letters.
`_panels` lays out the grid, the axis of time, and what is written around the panels: notes,
legends, captions and scales of colours. `_layers` draws into a panel what many pictures have: lines
over time with bands and gaps, bars, estimates with their intervals, matrices. `_plate_map` draws
the plate with its cells and channels, `_netlist_parts` the nodes of a network.

The other files say what is drawn. Of measurements beside the twin: `_recordings`, and what is left
over in `_residuals`; what an observer, a monitor and a diagnosis say of them: `_monitoring`. Of the
result of a match: `_fit` and `_estimates`. Of parameters: `_sensitivity`, `_index_curves`,
`_distributions` and `_design`. Of the plate: `_plates`, and its film in `_animation`. Of models and
loops: `_netlist`, `_dc_sweep`, `_frequency_response` and `_closed_loop`.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
