"""Recordings of a live rig: one SQLite file that survives a kill and a power failure.

`_recorder` writes records into the tables of `_tables`; `_replay` reads them again, in the order of
their arrival. `jaxtwin.io.Session` reads a recording as a time series. `_report` says what was
lost.
"""
