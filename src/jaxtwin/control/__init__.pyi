# The public names of jaxtwin.control; `__init__.py` reads this file at run time.

from ._directions import Directions as Directions  # mean and uniformity
from ._discrete_model import DiscreteModel as DiscreteModel  # a linear model step by step
from ._linear_model import LinearModel as LinearModel  # a twin near an operating point
from ._linearize import linearize as linearize  # twin or fit -> LinearModel
from ._margins import DiskMargin as DiskMargin  # of gain and phase together
from ._margins import Margins as Margins  # gm, pm, wcg, wcp
from ._margins import disk_margin as disk_margin  # of a loop with one channel or several
from ._margins import margins as margins  # of a loop with a single channel
from ._margins import sensitivity_peak as sensitivity_peak  # by how much a loop makes worse
from ._operating_point import OperatingPoint as OperatingPoint  # a steady state

__all__: list[str]
