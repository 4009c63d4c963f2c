# Public names of jaxtwin.identification. `__init__.py` imports each when it is first used.

from ._identified import Candidate as Candidate
from ._identified import Identified as Identified
from ._identify import identify as identify
