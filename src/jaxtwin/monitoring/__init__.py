r"""Monitoring: what has changed in a rig, since when, how much, and how sure that is.

`monitor` (`_monitor_recording`) follows a recording with an observer and tests each sample; the
result, `Monitored`, has the findings. `LiveMonitor` (`_live_monitor`) does the same beside a rig.
Both run `Monitor` (`_monitor`), one pure step for each sample, and `FindingLog` (`_finding_log`),
which raises each finding once and lets it clear; `LiveFindings` (`_live_findings`) tells them
beside a rig. The tests:

- of innovations (`_innovation_tests`, `_cumulative`): two-sided cumulative sums, a generalised
  likelihood ratio over a window, of each channel and of all together, and their energy; all on
  innovations that are whitened in time and clipped
- of the observer's slow states (`_state_test`), which take a fault in
- of single readings (`ChannelTests`): frozen, or gone to the room although a cell is driven
  (`_response`)
- of parameters against the recordings of the match (`ShiftTest`): reported, no alarm

The thresholds follow from a mean time between false alarms $T$. `calibrate_monitor` (`_calibrate`)
looks at the largest values of each statistic in blocks of a minute, in recordings and in
simulations, and takes the rate above a level $h$ as $r\,e^{-(h-u)/b}$ (`_thresholds`); each of six
families of statistics gets $5T$. `_run_lengths` has the textbook numbers for independent normal
innovations.
"""

from ._calibrate import calibrate_monitor
from ._evidence import Evidence, Evidences, Seen
from ._finding_log import FindingLog
from ._live_monitor import LiveMonitor
from ._monitor import Monitor, MonitorState
from ._monitor_recording import monitor
from ._monitored import Monitored
from ._thresholds import MonitorCalibration, Reference, Tail

__all__ = [
    "Evidence",
    "Evidences",
    "FindingLog",
    "LiveMonitor",
    "Monitor",
    "MonitorCalibration",
    "MonitorState",
    "Monitored",
    "Reference",
    "Seen",
    "Tail",
    "calibrate_monitor",
    "monitor",
]
