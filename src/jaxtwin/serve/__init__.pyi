# Public names of jaxtwin.serve. `__init__.py` imports each when it is first used.

from ._access import Access as Access
from ._access import Refusal as Refusal
from ._app import web_app as web_app
from ._champion import Champion as Champion
from ._champion import TwinBeside as TwinBeside
from ._child_process import VirtualLink as VirtualLink
from ._desk import Desk as Desk
from ._frame_ring import Batch as Batch
from ._frame_ring import FrameRing as FrameRing
from ._history import History as History
from ._live_diagnosis import LiveDiagnosis as LiveDiagnosis
from ._live_diagnosis import LiveRefit as LiveRefit
from ._order_in_force import compile_loop as compile_loop
from ._page import Page as Page
from ._page_server import PageServer as PageServer
from ._recent_samples import RecentSamples as RecentSamples
from ._rig_loop import RigLoop as RigLoop
from ._self_optimiser import SelfOptimiser as SelfOptimiser
from ._web_server import WebServer as WebServer
from ._web_server import listening as listening

__all__: list[str]

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._live_demo import DemoScript as DemoScript
from ._live_demo import demo_controller as demo_controller
from ._live_demo import demo_faults as demo_faults
from ._live_demo import demo_rig as demo_rig
from ._live_demo import demo_store as demo_store
