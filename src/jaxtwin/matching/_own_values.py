"""The values that belong to a recording and not to the rig, of a fit and any experiment."""

from ..io import Experiment
from ..physics import Twin
from ._fit import Fit
from ._settle import settle


def twin_for(fit: Fit, experiment: Experiment) -> Twin:
    """The twin of a fit with an experiment's own values.

    - Of a recording that was matched they are those of the match. It is known by its contents,
      whatever its name.
    - Of another recording they are taken from its first minute, as `jaxtwin.validate` does: see
      `settle`.
    - Of a drive without recorded temperatures nothing is known: it gets the mean of the matched
      recordings' values.

    **Raises:** what `settle` raises.
    """
    for name, matched in zip(fit.recordings, fit.experiments, strict=True):
        if matched == experiment:
            return fit.twins[name]
    twin, own = unseen_twin(fit)
    return twin if experiment.temperatures is None else settle(twin, experiment, own=own)


def unseen_twin(fit: Fit) -> tuple[Twin, list[str]]:
    """The twin of a fit for a recording that is not among its own, and the names of the values
    that it needs from there; until then their mean."""
    own = {row.name: row.value for row in fit.parameters if row.free and row.scope == "recording"}
    return fit.twin.with_parameters(own), list(own)
