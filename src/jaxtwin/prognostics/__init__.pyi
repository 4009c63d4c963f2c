# Public names of jaxtwin.prognostics. `__init__.py` imports each when it is first used.

from ._assess import health as health
from ._health import Health as Health
from ._health import ParameterHealth as ParameterHealth
from ._trend import Trend as Trend
from ._trend import random_effects_trend as random_effects_trend
