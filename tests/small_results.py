"""A match and a sensitivity analysis that take seconds, for tests of what is made of them."""

from dataclasses import replace
from functools import cache

import numpy as np

from jaxtwin import (
    Experiment,
    Fit,
    Twin,
    global_sensitivity,
    load_rig,
    match,
    read_recording,
    sensitivity,
)
from jaxtwin.data import synthetic_recordings
from jaxtwin.sensitivity_analysis import GlobalSensitivity, Sensitivity


@cache
def recordings() -> tuple[Experiment, ...]:
    """The first minute of zones A and B, synthetic."""
    return tuple(read_recording(path).between(0, 60) for path in synthetic_recordings()[:2])


@cache
def fit() -> Fit:
    """Three parameters, one of them with a value for each recording; a few iterations."""
    rig = load_rig("paper-2024")
    twin = Twin(rig, rig.parameter_sets["published"])
    return match(twin, recordings(), free=["R_E", "R_pc", "T_amb"], max_iterations=6)


# Of the logarithms of R_E and R_pc in `correlated_fit`.
COVARIANCE = np.array([[0.04, 0.016], [0.016, 0.01]])


def correlated_fit() -> Fit:
    """The small fit, as if its recordings left R_E and R_pc open with this covariance."""
    covariance = np.eye(4)
    covariance[:2, :2] = COVARIANCE
    return replace(fit(), uncertainty=replace(fit().uncertainty, vector_covariance=covariance))


@cache
def analysis() -> Sensitivity:
    """Twenty draws of four parameters."""
    names = ["R_pc", "R_E", "R_Tez", "R_Tfx"]
    return sensitivity(list(fit().twins.values()), recordings(), draws=20, names=names)


@cache
def global_analysis() -> GlobalSensitivity:
    """Sobol's indices of the costs, from sixteen base samples."""
    return global_sensitivity(fit(), method="sobol", draws=16, names=["R_pc", "R_E"])
