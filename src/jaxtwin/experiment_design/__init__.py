"""Design of experiments: the duty schedule whose recording is the most informative about a rig.

`_design_experiment` is the entry. `_prior_information` holds what a match knows already;
`_information` computes what a schedule (`_schedules`) would add, by the derivatives and the noise
of the match; `_exchange` searches, one stretch of a schedule after the other. The result is an
`ExperimentDesign` (`_experiment_design`).
"""

from ._design_experiment import design_experiment
from ._experiment_design import DesignStep, ExperimentDesign, PlannedSchedule

__all__ = ["DesignStep", "ExperimentDesign", "PlannedSchedule", "design_experiment"]
