"""Recordings: found or fetched, read, checked and written."""

from ._backup import backup_session
from ._clock_map import ClockMap
from ._experiment import Experiment
from ._fetch import fetch_recordings
from ._locate import find_recordings
from ._published import SINGLE_CELL, TWO_CELL, PublishedRecording
from ._read import read_recording
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
    "fetch_recordings",
    "find_recordings",
    "read_recording",
    "write_recording",
]
