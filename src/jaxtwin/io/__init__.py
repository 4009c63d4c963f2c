"""Recordings: found or fetched, read, checked and written.

An `Experiment` (`_experiment`) is what was done to a rig and what was recorded of it, on one time
grid, checked (`_checks`) and never changed. Which file holds what:

- reading: `_read` recognises the format; `_netcdf` and `_mat` read theirs, and
  `_table_files`, `_mat` and `_dataframe` make columns of tables
- text: `_text_table` finds titles and rows, `_named_columns` with `_column_meaning` and
  `_title_units` says what the columns mean, `_delimited` makes numbers of them with `_timestamps`,
  and `_recorded_columns` an experiment, with `_glitches`; `_csv` for all
- writing: `_write`, completely or not at all, also a copy of what still grows
- recordings of a live rig: `_session` reads what `live/recording/` writes, also while it grows;
  `_session_file` (metadata, one writer), `_session_rows` (blocks, device time to host time)
- the authors' recordings: `_fetch`
- schedules in words: `_schedule`
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
