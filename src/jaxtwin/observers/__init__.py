"""Observers: what a rig is doing, estimated from its duty and its readings.

An observer (`_observer`) is a pure object with arrays as its state, so that it runs under `jit`,
`vmap` and `grad`. `OpenLoop` (`_observer`) is the twin that only follows the duty;
`ExtendedKalmanFilter` (`_kalman_filter`) corrects its state by the readings.

`MovingHorizonEstimator` (`_moving_horizon`) looks at the last samples together, within bounds
(`_state_bounds`), by the filter and a smoother of its window.

The filter is built from parts: the twin with further states (`_augmented_model`), a step of any
length in the modes of its network, the commands in the driver's delay (`_commands`), the directions
in which a fit is uncertain (`_uncertain_values`), the distribution at the start (`_start`), and the
algebra of normal distributions (`_gaussian`). `observe` (`_observe`) runs it over a recording
(`_filter_run`); the result, `Observed`, forecasts (`_forecast`) and smooths.
`live_observer` makes a filter for a rig that is read as it runs; `_filter_run` has the steps of any
observer for what takes them one by one. `estimate_noise`
(`_estimate_noise`) finds the levels of a `ProcessNoise`, and `match_innovations`
(`_match_innovations`) the values of a twin by the likelihood of a filter.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
