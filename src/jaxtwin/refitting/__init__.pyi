# Public names of jaxtwin.refitting. `__init__.py` imports each when it is first used.

from ._gate import GateCheck as GateCheck
from ._refit import Refit as Refit
from ._refit import keep_refit as keep_refit
from ._refit import refit as refit

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._refit import TAG as TAG
