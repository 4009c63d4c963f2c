"""Pictures. Each function returns the figure, or the axes where it draws into one.

They are drawn with matplotlib in a style of their own; matplotlib's settings are left alone.
"""

from ._comparison import plot_comparison, plot_residuals
from ._dc_sweep import plot_dc_sweep
from ._history import plot_history
from ._parameters import plot_parameters
from ._recordings import plot_recordings

__all__ = [
    "plot_comparison",
    "plot_dc_sweep",
    "plot_history",
    "plot_parameters",
    "plot_recordings",
    "plot_residuals",
]
