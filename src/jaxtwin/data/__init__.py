"""Bundled data: rigs, module datasheets, tables and synthetic recordings."""

from .._data_folder import data_folder as data_folder
from ._synthetic import synthetic_recordings as synthetic_recordings
from ._synthetic import synthetic_truth as synthetic_truth
from ._tables import Table as Table
from ._tables import table as table

__all__ = ["Table", "data_folder", "synthetic_recordings", "synthetic_truth", "table"]
