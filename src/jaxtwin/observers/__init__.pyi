# Public names of jaxtwin.observers. `__init__.py` imports each when it is first used.

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
from ._observer import OpenLoop as OpenLoop
from ._observer import OpenLoopState as OpenLoopState
from ._process_noise import ProcessNoise as ProcessNoise
from ._state_bounds import StateBounds as StateBounds

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._augmented_model import AugmentedModel as AugmentedModel
from ._augmented_model import ExpectedReading as ExpectedReading
from ._commands import Commands as Commands
from ._estimates import Moment as Moment
from ._estimates import Moments as Moments
from ._estimates import moments as moments
from ._estimates import parameter_estimates as parameter_estimates
from ._expected_correction import INTERVAL_SPREAD as INTERVAL_SPREAD
from ._expected_correction import expected_jump as expected_jump
from ._expected_correction import is_due as is_due
from ._filter_run import FilterSamples as FilterSamples
from ._filter_run import filtered as filtered
from ._filter_run import followed as followed
from ._filter_run import predicted as predicted
from ._filter_run import samples_between as samples_between
from ._filter_run import samples_of as samples_of
from ._filter_run import started as started
from ._filter_run import state_moments as state_moments
from ._forecast import forecast_from as forecast_from
from ._gaussian import Gaussian as Gaussian
from ._gaussian import GaussianUpdate as GaussianUpdate
from ._gaussian import measurement_update as measurement_update
from ._gaussian import symmetric as symmetric
from ._kalman_filter import CERTAIN_CORRECTION_SIGMAS as CERTAIN_CORRECTION_SIGMAS
from ._kalman_filter import CORRECTION_SIGMAS as CORRECTION_SIGMAS
from ._kalman_filter import FOLLOW_COUNT as FOLLOW_COUNT
from ._kalman_filter import GATE_SIGMAS as GATE_SIGMAS
from ._kalman_filter import MAX_REJECTED as MAX_REJECTED
from ._kalman_filter import MIN_GATE_KELVIN as MIN_GATE_KELVIN
from ._observe import filter_for as filter_for
from ._observe import stable_stepper as stable_stepper
from ._observe import usual_noise as usual_noise
from ._start import GRID as GRID
from ._start import READ_SPREAD as READ_SPREAD
from ._start import REST_SCALE as REST_SCALE
from ._start import first_reading as first_reading
