"""Makes a `Fit` from the problem of a match, its best descent and its noise model."""

import time
from datetime import UTC, datetime

import jax
import numpy as np

from .. import __version__
from ..simulation import simulate
from ._comparison import CameraError, Comparison
from ._estimate_uncertainty import estimate_uncertainty
from ._first_sample import first_sample
from ._fit import Fit, Solution
from ._fitted_parameters import fitted_parameters
from ._iterations import Optimum, make_iteration
from ._problem import MatchProblem
from ._reweighted_least_squares import Estimate


def make_fit(
    problem: MatchProblem,
    estimate: Estimate,
    start: int,
    optima: tuple[Optimum, ...],
    began: float,
) -> Fit:
    """Makes the fit of the best descent.

    **Arguments:**

    - `start`: the number of the start of the best descent.
    - `optima`: the ends of the descents from all starts, best first.
    - `began`: the time at which the match began, by `time.perf_counter`.
    """
    twin, unknowns, names = problem.twin, problem.unknowns, problem.names
    result, noise_model = estimate
    values = [
        {name: float(value) for name, value in of_recording.items()}
        for of_recording in unknowns.recording_values(result.vector)
    ]
    runs = [
        simulate(twin.with_values(of_recording), experiment, initial=problem.initial)
        for of_recording, experiment in zip(values, problem.experiments, strict=True)
    ]
    errors = result.recording_errors()
    cameras = [
        CameraError(events, of_recording.camera)
        for events, of_recording in zip(noise_model.events, errors, strict=True)
    ]
    comparisons = tuple(map(Comparison, runs, cameras))
    gaps = [
        run.temperatures - solved for run, solved in zip(runs, result.temperatures(), strict=True)
    ]
    uncertainty, noise = estimate_uncertainty(problem, estimate)
    return Fit(
        twin=twin.with_values(values[0]),
        recordings=names,
        fingerprints=tuple(experiment.fingerprint for experiment in problem.experiments),
        channels=tuple(experiment.channels for experiment in problem.experiments),
        first_samples=tuple(map(first_sample, problem.experiments)),
        parameters=fitted_parameters(problem, result.vector, uncertainty),
        recording_values={
            name: {
                row.name: of_recording[row.name]
                for row in unknowns.per_group + unknowns.per_recording
            }
            for name, of_recording in zip(names, values, strict=True)
        },
        fit_percent={
            (name, channel): percent
            for name, comparison in zip(names, comparisons, strict=True)
            for channel, percent in comparison.reading.fit_percent.items()
        },
        rmse=float(np.sqrt(result.mean_square)),
        status=result.status,
        converged=result.converged,
        history=tuple(make_iteration(problem, step, start) for step in result.steps),
        optima=optima,
        wall_time=time.perf_counter() - began,
        solver_gap=max(float(np.abs(gap).max()) for gap in gaps),
        camera_error=float(
            np.sqrt(np.mean(np.concatenate([camera.error for camera in cameras]) ** 2))
        ),
        noise=noise,
        uncertainty=uncertainty,
        cost=result.cost,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        versions={"jaxtwin": __version__, "jax": jax.__version__},
        comparisons=comparisons,
        _solution=Solution(problem, noise_model, result.vector),
    )
