"""Diagnoses a recording: the observer runs once, and what explains its innovations is named."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._arguments import of_kind
from .._jax_settings import own_settings
from ..errors import ObserverError
from ..io import Experiment, as_experiment
from ..matching import Fit
from ..monitoring._monitored import check_settles
from ..observers import Observed, ProcessNoise, observe
from ..physics import Twin
from ._causes import diagnosed
from ._diagnosis import Diagnosis
from ._likelihood_ratio import Prior, healthy_squares
from ._recorded import inputs_of
from ._signatures import suspected
from ._suspects import Faults, Suspect, chosen

# The standard deviation of the size of a fault beforehand, in multiples of its usual effect.
SPREAD = 1.5

# The number of samples after which the next candidate begins in a healthy recording, so that some
# become old.
STRIDE = 12


def diagnose(
    fit: Twin | Fit,
    experiment: Experiment | str | os.PathLike[str],
    faults: Faults = None,
    noise: ProcessNoise | None = None,
    *,
    healthy: Sequence[Experiment] | None = None,
) -> Diagnosis:
    """Finds which fault explains what changes in a recording, from when on and how large it is.

    `jaxtwin.diagnosis` describes how. A fault that was there in the first two minutes is part of
    what the observer takes for the rig.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `experiment`: the recording, or its file.
    - `faults`: what is looked for: names of `jaxtwin.diagnosis.suspects(twin)`; a `Suspect`; or
      functions `System -> System` by their names, `{"lid": function}`, whose size is the multiple
      of what they change. None for all usual suspects.
    - `noise`: the levels of the noise, as for `jaxtwin.observe`.
    - `healthy`: recordings in which nothing happened, from which follows how much more the
      innovations say than they should. None: those of a fit that was saved with them.

    **Raises:** the errors of `jaxtwin.observe`; `ObserverError` if the recording is too short, if
    the noise is no `ProcessNoise`, for an unknown fault, or for one that changes the nodes.
    """
    rig = (fit.twin if isinstance(fit, Fit) else fit).rig
    experiment = as_experiment("diagnose: experiment", experiment, ObserverError, rig)
    if noise is not None:
        expected = "a ProcessNoise, as jaxtwin.estimate_noise finds it"
        of_kind("diagnose: noise", noise, ProcessNoise, expected, ObserverError)
    check_settles(experiment)
    observed = observe(fit, experiment, noise)
    if observed.impossible.any():  # what was back at the next sample is no fault of the rig
        assert experiment.temperatures is not None
        possible = np.where(observed.impossible, np.nan, experiment.temperatures)
        observed = observe(fit, replace(experiment, temperatures=possible), noise)
    model = observed.observer.model
    several = chosen(model.twin, faults, observed.channels)
    arrays = suspected(model, several)
    if healthy is None:
        healthy = ()
        if isinstance(fit, Fit) and fit.comparisons is not None:
            healthy = fit.experiments
    prior = learned(several, [observe(fit, recording, noise) for recording in healthy])
    return diagnosed(observed, several, arrays, prior)


def learned(several: Sequence[Suspect], healthy: Sequence[Observed]) -> Prior:
    """What is known beforehand of suspects, with the variance of their statistics in healthy
    recordings."""
    prior = Prior(
        np.full(len(several), SPREAD),
        np.array([suspect.is_one_sided for suspect in several]),
        np.ones(len(several) + 1),
        np.asarray(math.inf),
        np.asarray(math.inf),
    )
    squares, counts = np.zeros(len(several) + 1), np.zeros(len(several) + 1)
    for observed in healthy:
        inputs = inputs_of(observed, 0)
        is_turn = np.arange(len(inputs.begins)) % STRIDE == 0
        inputs = inputs._replace(begins=np.asarray(inputs.begins) & is_turn)
        with own_settings():
            own = suspected(observed.observer.model, several)
            result = healthy_squares(observed.observer, own, prior, inputs)
        squares, counts = squares + np.asarray(result[0]), counts + np.asarray(result[1])
    inflation = np.maximum(squares / np.maximum(counts, 1.0), 1.0)
    return prior._replace(inflation=np.where(counts > 0, inflation, 1.0))
