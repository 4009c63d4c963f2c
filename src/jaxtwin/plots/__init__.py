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

from ._animation import animate_plate
from ._closed_loop import (
    plot_closed_loop,
    plot_frontier,
    plot_plate_range,
    plot_retuned,
    plot_tuning,
)
from ._dc_sweep import plot_dc_curves, plot_dc_sweep
from ._design import plot_design
from ._distributions import plot_distributions
from ._estimates import (
    plot_correlation,
    plot_fit_difference,
    plot_group_values,
    plot_health,
    plot_profile,
)
from ._fit import plot_history, plot_parameters
from ._frequency_response import plot_bode, plot_bode_band, plot_nyquist
from ._index_curves import plot_convergence, plot_indices_over_time
from ._monitoring import plot_diagnosis, plot_isolability, plot_monitored, plot_observed
from ._netlist import plot_netlist
from ._plates import (
    plot_plate_beside,
    plot_plate_map,
    plot_plate_seen,
    plot_plates,
    plot_rig_design,
)
from ._recordings import (
    plot_bands,
    plot_comparison,
    plot_forecast,
    plot_recordings,
    plot_uniformity,
)
from ._residuals import plot_camera_error, plot_innovations, plot_residual_tests, plot_residuals
from ._sensitivity import (
    plot_index_bars,
    plot_morris_plane,
    plot_sensitivity_indices,
    plot_sensitivity_matrix,
    plot_sobol_bars,
    plot_tornado,
)
from ._style import style, styled, to_png

__all__ = [
    "animate_plate",
    "plot_bands",
    "plot_bode",
    "plot_bode_band",
    "plot_camera_error",
    "plot_closed_loop",
    "plot_comparison",
    "plot_convergence",
    "plot_correlation",
    "plot_dc_curves",
    "plot_dc_sweep",
    "plot_design",
    "plot_diagnosis",
    "plot_distributions",
    "plot_fit_difference",
    "plot_forecast",
    "plot_frontier",
    "plot_group_values",
    "plot_health",
    "plot_history",
    "plot_index_bars",
    "plot_indices_over_time",
    "plot_innovations",
    "plot_isolability",
    "plot_monitored",
    "plot_morris_plane",
    "plot_netlist",
    "plot_nyquist",
    "plot_observed",
    "plot_parameters",
    "plot_plate_beside",
    "plot_plate_map",
    "plot_plate_range",
    "plot_plate_seen",
    "plot_plates",
    "plot_profile",
    "plot_recordings",
    "plot_residual_tests",
    "plot_residuals",
    "plot_retuned",
    "plot_rig_design",
    "plot_sensitivity_indices",
    "plot_sensitivity_matrix",
    "plot_sobol_bars",
    "plot_tornado",
    "plot_tuning",
    "plot_uniformity",
    "style",
    "styled",
    "to_png",
]
