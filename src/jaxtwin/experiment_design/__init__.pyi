# Public names of jaxtwin.experiment_design. `__init__.py` imports each when it is first used.

from ._design_experiment import design_experiment as design_experiment
from ._diagnosis_design import DiagnosisDesign as DiagnosisDesign
from ._diagnosis_design import PlannedTest as PlannedTest
from ._diagnosis_design import SeparationStep as SeparationStep
from ._experiment_design import DesignStep as DesignStep
from ._experiment_design import ExperimentDesign as ExperimentDesign
from ._experiment_design import PlannedSchedule as PlannedSchedule
