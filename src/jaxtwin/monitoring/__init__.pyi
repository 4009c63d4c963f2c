# Public names of jaxtwin.monitoring. `__init__.py` imports each when it is first used.

from ._calibrate import calibrate_monitor as calibrate_monitor
from ._evidence import Evidence as Evidence
from ._evidence import Evidences as Evidences
from ._evidence import ObservedSample as ObservedSample
from ._finding_log import FindingLog as FindingLog
from ._live_monitor import LiveMonitor as LiveMonitor
from ._monitor import Monitor as Monitor
from ._monitor import MonitorState as MonitorState
from ._monitored import Monitored as Monitored
from ._monitored import monitor as monitor
from ._thresholds import MonitorCalibration as MonitorCalibration
from ._thresholds import Reference as Reference
from ._thresholds import Tail as Tail

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._evidence import joined as joined
from ._evidence import observed_sample as observed_sample
from ._finding_log import KINDS as KINDS
from ._finding_log import events as events
from ._live_monitor import LiveFindings as LiveFindings
from ._monitor import SETTLE as SETTLE
from ._monitor import channels_of as channels_of
from ._monitored import monitor_observed as monitor_observed
from ._response import response_of as response_of
from ._thresholds import DAY as DAY
from ._thresholds import nominal_calibration as nominal_calibration
