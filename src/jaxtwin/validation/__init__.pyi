# Public names of jaxtwin.validation. `__init__.py` imports each when it is first used.

from ._validate import leave_one_out as leave_one_out
from ._validate import validate as validate
from ._validate import validate_split as validate_split
from ._validation import Prediction as Prediction
from ._validation import Validation as Validation
from ._validation import Whiteness as Whiteness
from ._validation import whiteness as whiteness
from ._validation import whiteness_of_channels as whiteness_of_channels
