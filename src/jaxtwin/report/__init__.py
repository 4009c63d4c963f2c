"""Reports: a fit, or the demo of the paper's rig, as one HTML page that needs no other file."""

from .._progress import Progress
from ._demo import write_demo
from ._report import write_report

__all__ = ["Progress", "write_demo", "write_report"]
