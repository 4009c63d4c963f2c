"""Recordings: found or fetched, read, checked and written.

An `Experiment` (`_experiment`) is what was done to a rig and what was recorded of it, on one time
grid, checked (`_checks`) and never changed. Which file holds what:

- reading: `_read` recognises the format; `_csv` and `_delimited`, `_netcdf`, `_mat` and `_matlab5`,
  `_table_files` and `_dataframe` read it; `_named_columns`, `_timestamps` and `_resample` (samples
  with times of their own) serve all
- writing: `_write`, completely or not at all
- recordings of a live rig: `_session` reads what `live/recording/` writes, also while it grows;
  `_open_session`, `_session_file` (metadata), `_session_rows` (blocks), `_clock_map` (device time
  to host time), `_lock` (one writer), `_backup`
- the authors' recordings: `_locate`, `_fetch`, `_published`
- schedules in words: `_schedule`
"""

from ._backup import backup_session
from ._clock_map import ClockMap
from ._experiment import Experiment
from ._fetch import fetch_recordings
from ._locate import find_recordings
from ._published import SINGLE_CELL, TWO_CELL, PublishedRecording
from ._read import column_names, read_recording
from ._session import Session
from ._session_rows import DeviceClock, Series
from ._write import write_recording

__all__ = [
    "SINGLE_CELL",
    "TWO_CELL",
    "ClockMap",
    "DeviceClock",
    "Experiment",
    "PublishedRecording",
    "Series",
    "Session",
    "backup_session",
    "column_names",
    "fetch_recordings",
    "find_recordings",
    "read_recording",
    "write_recording",
]
