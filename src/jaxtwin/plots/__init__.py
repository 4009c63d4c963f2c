"""Plots. Each function returns the figure, or the axes if it draws into axes.

They are drawn with matplotlib in jaxtwin's style; matplotlib's settings do not change. `style`
selects another style for a block of code: for the column of a journal, print without colours, or a
dark notebook.
"""

from ._animation import animate_plate
from ._bands import plot_bands, plot_forecast
from ._bode import plot_bode
from ._bode_band import plot_bode_band
from ._camera_error import plot_camera_error
from ._closed_loop import plot_closed_loop
from ._comparison import plot_comparison, plot_residuals
from ._convergence import plot_convergence
from ._correlation import plot_correlation
from ._dc_sweep import plot_dc_curves, plot_dc_sweep
from ._design import plot_design
from ._diagnosis import plot_diagnosis
from ._distributions import plot_distributions
from ._fit_difference import plot_fit_difference
from ._frontier import plot_frontier
from ._group_values import plot_group_values
from ._health import plot_health
from ._history import plot_history
from ._index_bars import plot_index_bars
from ._indices_over_time import plot_indices_over_time
from ._isolability import plot_isolability
from ._monitored import plot_monitored
from ._morris_plane import plot_morris_plane
from ._netlist import plot_netlist
from ._nyquist import plot_nyquist
from ._observed import plot_innovations, plot_observed
from ._parameters import plot_parameters
from ._plate_map import plot_plate_map
from ._plate_range import plot_plate_range
from ._plate_seen import plot_plate_seen
from ._plates import plot_plates
from ._png import to_png
from ._profile import plot_profile
from ._recordings import plot_recordings
from ._residual_tests import plot_residual_tests
from ._retuned import plot_retuned
from ._rig_design import plot_rig_design
from ._sensitivity_indices import plot_sensitivity_indices
from ._sensitivity_matrix import plot_sensitivity_matrix
from ._sobol_bars import plot_sobol_bars
from ._style import style, styled
from ._tornado import plot_tornado
from ._tuning import plot_tuning
from ._uniformity import plot_plate_beside, plot_uniformity

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
