# The public names of jaxtwin.live. `__init__.py` reads this file at run time and imports a name
# when it is first used: the command line takes its commands from here without loading JAX.

from ._bench import Bench as Bench
from ._bench import View as View
from ._bench import connect as connect
from ._drive import Guard as Guard
from ._drive import drive as drive
from ._drive import switch_off as switch_off
from ._faults import Faults as Faults
from ._follower import Follower as Follower
from ._framing import deframe as deframe
from ._framing import encode_line as encode_line
from ._framing import encode_packet as encode_packet
from ._live_twin import LiveTwin as LiveTwin
from ._messages import RECALIBRATING as RECALIBRATING
from ._messages import Ask as Ask
from ._messages import Beat as Beat
from ._messages import Data as Data
from ._messages import Duty as Duty
from ._messages import Hello as Hello
from ._messages import Image as Image
from ._messages import Notice as Notice
from ._messages import encode as encode
from ._messages import parse as parse
from ._mqtt import Publisher as Publisher
from ._opener import opener as opener
from ._recorder import Recorder as Recorder
from ._records import Command as Command
from ._records import Event as Event
from ._records import Gap as Gap
from ._records import Greeting as Greeting
from ._records import LinkChange as LinkChange
from ._records import LinkState as LinkState
from ._records import Reading as Reading
from ._records import Record as Record
from ._records import Sample as Sample
from ._replay import Replay as Replay
from ._report import report as report
from ._serve import InProcess as InProcess
from ._serve import MqttServer as MqttServer
from ._serve import PtyServer as PtyServer
from ._serve import Server as Server
from ._serve import TcpServer as TcpServer
from ._serve import serve as serve
from ._time import Clock as Clock
from ._time import SystemClock as SystemClock
from ._transport import Transport as Transport
from ._virtual_rig import VirtualRig as VirtualRig
from ._watch import Screen as Screen

__all__: list[str]
