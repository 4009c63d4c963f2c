# Public names of jaxtwin.diagnosis. `__init__.py` imports each when it is first used.

from ._diagnose import diagnose as diagnose
from ._diagnosis import Cause as Cause
from ._diagnosis import Diagnosis as Diagnosis
from ._diagnosis import Explanation as Explanation
from ._isolability import Isolability as Isolability
from ._isolability import isolability as isolability
from ._suspects import Suspect as Suspect
from ._suspects import suspects as suspects

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._diagnosis import HEALTHY as HEALTHY
from ._diagnosis import NONE_OF_THESE as NONE_OF_THESE
from ._diagnosis import TIE as TIE
from ._isolability import evidence_of as evidence_of
from ._isolability import grams_of as grams_of
from ._signatures import suspected as suspected
from ._suspects import Faults as Faults
from ._suspects import chosen as chosen
