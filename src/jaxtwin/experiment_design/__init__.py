"""Design of experiments: the duty schedule whose recording is the most informative about a rig."""

from ._design_experiment import design_experiment
from ._experiment_design import DesignStep, ExperimentDesign, PlannedSchedule

__all__ = ["DesignStep", "ExperimentDesign", "PlannedSchedule", "design_experiment"]
