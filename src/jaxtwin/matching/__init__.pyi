# The public names of jaxtwin.matching. `__init__.py` reads this file at run time and imports a name
# when it is first used.

from ._band import Band as Band
from ._band import prediction_band as prediction_band
from ._comparison import CameraError as CameraError
from ._comparison import Comparison as Comparison
from ._difference import FitDifference as FitDifference
from ._difference import ParameterDifference as ParameterDifference
from ._difference import compare_fits as compare_fits
from ._fit import Fit as Fit
from ._fitted_parameters import FittedParameter as FittedParameter
from ._fitted_parameters import FittedParameters as FittedParameters
from ._initial_conditions import WARM_UP as WARM_UP
from ._initial_conditions import InitialConditions as InitialConditions
from ._initial_conditions import estimate_initial_conditions as estimate_initial_conditions
from ._iterations import Iteration as Iteration
from ._iterations import Optimum as Optimum
from ._levenberg_marquardt import BoundedLevenbergMarquardt as BoundedLevenbergMarquardt
from ._many import match_many as match_many
from ._match import match as match
from ._noise import Noise as Noise
from ._noise import estimate_noise as estimate_noise
from ._posterior_draws import posterior_draws as posterior_draws
from ._problem import named_recordings as named_recordings
from ._profile import Profile as Profile
from ._profile import profile as profile
