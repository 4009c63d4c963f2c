"""Checks of an experiment's duty against a rig: how many columns it has, and that no heater is
asked to cool."""

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

    **Raises:** `error` if it drives another number of cells and heaters, or a heater is to cool.
    """
    if experiment.n_cells != len(rig.driven):
        parts = [
            f"{len(group)} {name}{'s' * (len(group) != 1)}"
            for group, name in ((rig.cells, "cell"), (rig.heaters, "heater"))
            if group
        ]
        raise error(
            f"{label}: duty: expected the {' and '.join(parts)} of {rig.name}, got "
            f"{experiment.n_cells}"
        )
    check_heats_only(experiment, rig, label, error)


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
                f"cool, got {duty[first]:g} at {experiment.time[first]:g} s"
            )
