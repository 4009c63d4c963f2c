"""Selects the twin for an experiment: a fit has a different one for each recording."""

import os
from typing import Protocol, runtime_checkable

from .._arguments import of_kind
from ..errors import SimulationError
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

    **Raises:** `SimulationError` if it is neither, or the experiment is none; the errors of
    `Fit.twin_for`.
    """
    if not isinstance(twin, FittedTwins):
        check_twin("twin", twin, SimulationError)
    if isinstance(experiment, str | os.PathLike):
        place = repr(os.fspath(experiment))
        raise SimulationError(
            f"experiment: expected {EXPERIMENT}, got {place}; read a file with "
            f"read_recording({place}), or run a schedule in words with twin.simulate"
        )
    of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
    return twin.twin_for(experiment) if isinstance(twin, FittedTwins) else twin
