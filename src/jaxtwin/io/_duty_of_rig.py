"""Checks of what an experiment drives against a rig: how many columns of duty it has, that no
heater is asked to cool, and that the rig has its inputs."""

import numpy as np

from .._errors import JaxtwinError
from ..rig import Rig
from ._experiment import Experiment


def check_duty_of_rig(
    experiment: Experiment, rig: Rig, label: str, error: type[JaxtwinError]
) -> None:
    """Refuses an experiment that does not drive what a rig has.

    **Arguments:**

    - `label`: the experiment in messages.

    **Raises:** `error` if it drives another number of cells and heaters, a heater is to cool, or it
    states an input that the rig does not have.
    """
    if experiment.n_cells != len(rig.driven):
        parts = [
            f"{len(group)} {name}{'s' * (len(group) != 1)}"
            for group, name in ((rig.cells, "cell"), (rig.heaters, "heater"))
            if group
        ]
        raise error(
            f"{label}: duty: expected the {' and '.join(parts)} of {rig.name}, got "
            f"{experiment.n_cells}; Experiment.schedule(..., cells={len(rig.driven)}) has a duty "
            "for each of them"
        )
    check_heats_only(experiment, rig, label, error)
    known = [one.name for one in rig.inputs]
    for name in experiment.inputs:
        if name not in known:
            raise error(
                f"{label}: inputs: expected those of {rig.name}, {', '.join(known) or 'none'}, got "
                f"{name!r}"
            )


def check_heats_only(
    experiment: Experiment, rig: Rig, label: str, error: type[JaxtwinError]
) -> None:
    """Refuses an experiment that asks a heater of a rig to cool.

    **Raises:** `error` that names the column and the time.
    """
    columns = zip(rig.driven, rig.lowest_duty, experiment.duty.T, strict=False)
    for number, (name, lowest, duty) in enumerate(columns, start=1):
        (cools,) = np.nonzero(duty < lowest)
        if cools.size:
            first = cools[0]
            raise error(
                f"{label}: duty_P{number}: expected 0 to 1, because the heater {name!r} cannot "
                f"cool, got {duty[first]:.10g} at {experiment.time[first]:.10g} s"
            )
