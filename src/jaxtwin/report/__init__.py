"""Reports: the demo of the paper's rig as one page that needs nothing but itself."""

from .._progress import Progress
from ._demo import write_demo

__all__ = ["Progress", "write_demo"]
