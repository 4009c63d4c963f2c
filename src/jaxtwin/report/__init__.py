"""Reports: a fit, or the demo of the paper's rig, as one HTML page that needs no other file.

A report is a list of blocks, which become a page and are written with their files as a whole or not
at all (`_page`). `_report` is the report of a fit: any rig, its recordings and the agreement with
them (`_recordings`), and parameters (`_parameters`). `_demo` is the paper's example on the same
blocks, a step a file (`_demo_simulate`, `_demo_match`).
"""

from .._progress import Progress
from ._demo import write_demo
from ._report import write_report

__all__ = ["Progress", "write_demo", "write_report"]
