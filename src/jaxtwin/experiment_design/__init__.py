"""Design of experiments: the duty schedule whose recording is the most informative about a rig.

`_design_experiment` is the entry. `_information` holds what a match knows already, and computes
what a schedule (`_schedules`) would add, by the derivatives and the noise of the match; `_search`
changes one stretch of a schedule after the other, below the limits of the rig. The result is an
`ExperimentDesign` (`_experiment_design`).

With the purpose of a diagnosis, the same search finds the schedule that tells faults apart soonest.
`_diagnosis_design` computes how soon one does, by the signatures of the faults in an observer, and
holds the result, a `DiagnosisDesign`.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
