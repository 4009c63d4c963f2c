r"""Monitoring: what has changed in a rig, since when, how much, and how sure that is.

`monitor` (`_monitored`) follows a recording with an observer and tests each sample; the
result, `Monitored`, has the findings. `LiveMonitor` (`_live_monitor`) does the same beside a rig.
Both run `Monitor` (`_monitor`), one pure step for each sample, and `FindingLog` (`_finding_log`),
which raises each finding once and lets it clear; `LiveFindings` (`_live_monitor`) tells them
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
families of statistics gets $5T$. There too are the textbook numbers for independent normal
innovations.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__, {"Seen": "ObservedSample"})
