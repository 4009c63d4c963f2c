"""Selects the twin for an experiment: a fit has a different one for each recording."""

from typing import Protocol, runtime_checkable

from .._arguments import of_kind
from .._errors import SimulationError
from ..io import Experiment
from ..io._experiment import EXPERIMENT
from ..physics import Twin
from ..physics._twin import check_twin


@runtime_checkable
class FittedTwins(Protocol):
    """The interface of `jaxtwin.Fit` that simulation uses: a twin for each experiment. Simulation
    cannot import matching."""

    def twin_for(self, experiment: Experiment) -> Twin:
        """The twin with the experiment's own values."""
        ...


def twin_of_experiment(twin: Twin | FittedTwins, experiment: Experiment) -> Twin:
    """Returns a twin unchanged, or the twin of a fit for an experiment.

    **Raises:** `SimulationError` if it is neither; the errors of `Fit.twin_for`.
    """
    if isinstance(twin, FittedTwins):
        of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
        return twin.twin_for(experiment)
    check_twin("twin", twin, SimulationError)
    return twin
