"""Bundled data: rigs, module datasheets, tables and synthetic recordings.

The files stand in `data/` at the top of a checkout, and inside the package in a wheel;
`_data_folder.py` beside the packages finds them in both. Rigs, modules and materials are read by
`jaxtwin.rig`; the numbers of the paper's tables by `_tables`, and the recordings that
`_make_synthetic` makes by `_synthetic`.
"""

from .._data_folder import data_folder as data_folder
from ._synthetic import synthetic_recordings as synthetic_recordings
from ._synthetic import synthetic_truth as synthetic_truth
from ._tables import Table as Table
from ._tables import table as table

__all__ = ["Table", "data_folder", "synthetic_recordings", "synthetic_truth", "table"]
