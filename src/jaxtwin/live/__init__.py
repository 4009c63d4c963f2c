"""A live rig: links, protocol, recorder, drive, virtual rig, replay.

Bytes become records (`Sample`, `Reading`, ...), which are in the journal before anyone sees them.
The contract is in docs/reliability.md, what goes over the wire in docs/protocol.md.
"""

from ._bench import Bench, View, connect
from ._clock_map import ClockMap
from ._drive import Guard, drive, switch_off
from ._faults import Faults
from ._follower import Follower
from ._framing import deframe, encode_line, encode_packet
from ._live_twin import LiveTwin
from ._messages import encode, parse
from ._recorder import Recorder
from ._records import (
    Command,
    Event,
    Gap,
    Greeting,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Sample,
)
from ._replay import Replay
from ._report import report
from ._serve import InProcess, PtyServer, TcpServer, serve
from ._session import DeviceClock, Series, Session
from ._time import Clock, SystemClock
from ._transport import Transport, opener
from ._virtual_rig import VirtualRig

__all__ = [
    "Bench",
    "Clock",
    "ClockMap",
    "Command",
    "DeviceClock",
    "Event",
    "Faults",
    "Follower",
    "Gap",
    "Greeting",
    "Guard",
    "InProcess",
    "LinkChange",
    "LinkState",
    "LiveTwin",
    "PtyServer",
    "Reading",
    "Record",
    "Recorder",
    "Replay",
    "Sample",
    "Series",
    "Session",
    "SystemClock",
    "TcpServer",
    "Transport",
    "View",
    "VirtualRig",
    "connect",
    "deframe",
    "drive",
    "encode",
    "encode_line",
    "encode_packet",
    "opener",
    "parse",
    "report",
    "serve",
    "switch_off",
]
