"""The twin that an experiment is run with, where a fit has one for each."""

from typing import Protocol, runtime_checkable

from .._arguments import of_kind
from .._errors import SimulationError
from ..io import Experiment
from ..io._experiment import EXPERIMENT
from ..physics import Twin
from ..physics._twin import check_twin


@runtime_checkable
class FittedTwins(Protocol):
    """A twin for each experiment, as a `jaxtwin.Fit` has it; matching stands above simulation."""

    def twin_for(self, experiment: Experiment) -> Twin:
        """The twin with the experiment's own values."""
        ...


def own_twin(twin: Twin | FittedTwins, experiment: Experiment) -> Twin:
    """A twin as it is, or a fit's twin for an experiment.

    **Raises:** `SimulationError` where it is neither; what `Fit.twin_for` raises.
    """
    if isinstance(twin, FittedTwins):
        of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
        return twin.twin_for(experiment)
    check_twin("twin", twin, SimulationError)
    return twin
