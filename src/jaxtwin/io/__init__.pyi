# Public names of jaxtwin.io. `__init__.py` imports each when it is first used.

from ._experiment import Experiment as Experiment
from ._fetch import SINGLE_CELL as SINGLE_CELL
from ._fetch import TWO_CELL as TWO_CELL
from ._fetch import PublishedRecording as PublishedRecording
from ._fetch import fetch_recordings as fetch_recordings
from ._fetch import find_recordings as find_recordings
from ._read import column_names as column_names
from ._read import read_recording as read_recording
from ._session import Session as Session
from ._session_rows import ClockMap as ClockMap
from ._session_rows import DeviceClock as DeviceClock
from ._session_rows import Series as Series
from ._write import backup_session as backup_session
from ._write import write_recording as write_recording

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._column_meaning import Choices as Choices
from ._column_meaning import in_english as in_english
from ._delimited import TRUTH as TRUTH
from ._delimited import text_table as text_table
from ._duty_of_rig import check_duty_of_rig as check_duty_of_rig
from ._duty_of_rig import of_rig as of_rig
from ._experiment import EXPERIMENT as EXPERIMENT
from ._experiment import Recordings as Recordings
from ._experiment import as_experiment as as_experiment
from ._experiment import as_experiments as as_experiments
from ._gaps import GAP_FACTOR as GAP_FACTOR
from ._gaps import Gaps as Gaps
from ._gaps import gap_sentences as gap_sentences
from ._gaps import parts_between_gaps as parts_between_gaps
from ._gaps import separate_recordings as separate_recordings
from ._glitches import is_missing as is_missing
from ._named_columns import meanings as meanings
from ._read import table_content as table_content
from ._session_file import APPLICATION as APPLICATION
from ._session_file import FORMAT as FORMAT
from ._session_file import Columns as Columns
from ._session_file import damage_as_recording_error as damage_as_recording_error
from ._session_file import is_session as is_session
from ._session_file import lock as lock
from ._session_file import read_metadata as read_metadata
from ._session_file import unlock as unlock
from ._text_table import TextTable as TextTable
from ._text_table import is_data as is_data
from ._timestamps import is_time as is_time
from ._timestamps import is_timestamp_title as is_timestamp_title
from ._title_units import unit_of_title as unit_of_title
