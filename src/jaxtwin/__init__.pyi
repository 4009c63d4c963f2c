# The public names of jaxtwin, one line each. `__init__.py` reads this file at run time and imports
# a name when it is first used; type checkers and editors read it as it stands.

from ._errors import JaxtwinError as JaxtwinError  # what all the following are
from ._errors import MatchError as MatchError
from ._errors import ParameterError as ParameterError
from ._errors import RecordingError as RecordingError
from ._errors import RigError as RigError
from ._errors import SimulationError as SimulationError
from .rig import Rig as Rig  # a rig file, read and checked
from .rig import bundled_rigs as bundled_rigs  # names of the rigs that come along
from .rig import load_rig as load_rig  # a bundled rig, or one's own .toml

__all__: list[str]
__version__: str
