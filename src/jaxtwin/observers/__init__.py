"""Observers: what a rig is doing, estimated from its duty and its readings.

An observer (`_observer`) is a pure object with arrays as its state, so that it runs under `jit`,
`vmap` and `grad`. `OpenLoop` (`_open_loop`) is the twin that only follows the duty; an estimator
corrects its state by the readings as well.
"""

from ._observer import AbstractObserver
from ._open_loop import OpenLoop, OpenLoopState

__all__ = ["AbstractObserver", "OpenLoop", "OpenLoopState"]
