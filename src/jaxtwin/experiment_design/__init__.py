"""Design of experiments: the duty schedule whose recording is the most informative about a rig.

`_design_experiment` is the entry. `_prior_information` holds what a match knows already;
`_information` computes what a schedule (`_schedules`) would add, by the derivatives and the noise
of the match; `_exchange` searches, one stretch of a schedule after the other. The result is an
`ExperimentDesign` (`_experiment_design`).

With the purpose of a diagnosis, `_separation_search` searches in the same way for the schedule that
tells faults apart soonest; `_evidence` computes how soon one does, by the signatures of the faults
in an observer. The result is a `DiagnosisDesign` (`_diagnosis_design`). Both keep below the limits
of the rig (`_hottest`).
"""

from ._design_experiment import design_experiment
from ._diagnosis_design import DiagnosisDesign, PlannedTest, SeparationStep
from ._experiment_design import DesignStep, ExperimentDesign, PlannedSchedule

__all__ = [
    "DesignStep",
    "DiagnosisDesign",
    "ExperimentDesign",
    "PlannedSchedule",
    "PlannedTest",
    "SeparationStep",
    "design_experiment",
]
