"""Reports: a fit, or the demo of the paper's rig, as one HTML page that needs no other file.

A report is a list of blocks (`_blocks`), which `_page` makes a page of and `_folder` writes as a
whole or not at all. `_report` is the report of a fit: any rig (`_rig`), its recordings
(`_recordings`, `_corrections`), parameters (`_parameters`, `_sensitivity`), agreement
(`_agreement`, `_uniformity`) and the machine (`_environment`). `_demo` is the paper's example on
the same blocks, a step a file (`_demo_simulate`, `_demo_match`, `_demo_sensitivity`), with the
recordings of `_demo_source` and the expected numbers of `_demo_checks`.
"""

from .._progress import Progress
from ._demo import write_demo
from ._report import write_report

__all__ = ["Progress", "write_demo", "write_report"]
