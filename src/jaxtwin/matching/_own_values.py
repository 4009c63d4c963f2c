"""The twin of a fit for any experiment: with the values that belong to it and not to the rig."""

from ..io import Experiment
from ..physics import Twin
from ._fit import Fit
from ._initial_conditions import estimate_initial_conditions, mean_twin


def twin_for(fit: Fit, experiment: Experiment) -> Twin:
    """The twin of a fit with an experiment's own values.

    - Of a recording that was matched they are those of the match. It is known by its contents,
      whatever its name.
    - Of another recording they are estimated from its first minute, as `jaxtwin.validate` does: see
      `estimate_initial_conditions`.
    - Of a drive without recorded temperatures nothing is known: it gets the mean of the matched
      recordings' values.

    **Raises:** what `estimate_initial_conditions` raises.
    """
    if experiment.fingerprint in fit.fingerprints:
        return fit.twins[fit.recordings[fit.fingerprints.index(experiment.fingerprint)]]
    if experiment.temperatures is None:
        return mean_twin(fit)[0]
    return estimate_initial_conditions(fit, experiment).twin
