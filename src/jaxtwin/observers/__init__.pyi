# The public names of jaxtwin.observers. `__init__.py` reads this file at run time and imports a
# name when it is first used.

from ._estimate_noise import estimate_noise as estimate_noise
from ._estimates import Estimate as Estimate
from ._estimates import Estimates as Estimates
from ._forecast import Forecast as Forecast
from ._kalman_filter import ExtendedKalmanFilter as ExtendedKalmanFilter
from ._kalman_filter import KalmanState as KalmanState
from ._match_innovations import match_innovations as match_innovations
from ._moving_horizon import MovingHorizonEstimator as MovingHorizonEstimator
from ._moving_horizon import MovingHorizonState as MovingHorizonState
from ._observe import live_observer as live_observer
from ._observe import observe as observe
from ._observed import Observed as Observed
from ._observer import AbstractObserver as AbstractObserver
from ._open_loop import OpenLoop as OpenLoop
from ._open_loop import OpenLoopState as OpenLoopState
from ._process_noise import ProcessNoise as ProcessNoise
from ._state_bounds import StateBounds as StateBounds
