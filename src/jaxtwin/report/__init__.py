"""Reports: the demo of the paper's rig as one page that needs nothing but itself."""

from ._demo import write_demo
from ._progress import Progress

__all__ = ["Progress", "write_demo"]
