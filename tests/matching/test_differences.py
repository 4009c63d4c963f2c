"""Central differences of the output errors, beside their exact derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin, simulate
from jaxtwin._jax_settings import own_settings
from jaxtwin.matching import named_recordings
from jaxtwin.matching._jacobian import output_error_jacobians, output_errors_and_differences
from jaxtwin.matching._noise_model import initial_noise_model
from jaxtwin.matching._objective import make_objective
from jaxtwin.matching._problem import ParameterChoice, choose_unknowns, make_match_problem
from jaxtwin.matching._residuals import output_errors, recording_modes

NAMES = ["T_amb", "T_start", "T_sink"]


@pytest.mark.slow
@pytest.mark.parametrize("at_bound", [False, True])
def test_central_differences_are_the_exact_derivatives_also_at_a_bound(at_bound: bool):
    drive = Experiment.schedule("0:0,10:0.5", duration=40)
    twin = Twin("single-cell")
    seen = simulate(twin.with_values({"T_amb": 21.0}), drive).temperatures
    recording = Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen)
    recordings = named_recordings(twin, [recording])
    unknowns = choose_unknowns(twin, (0,), ParameterChoice(NAMES, per_recording=NAMES))
    problem = make_match_problem(twin, recordings, unknowns)
    objective = make_objective(problem, initial_noise_model(problem))
    space = replace(unknowns.search_space(), difference_steps=1e-4 * unknowns.scales())
    vector = np.array(space.upper) if at_bound else unknowns.start()
    with own_settings():

        @jax.jit
        def both(vector):
            modes = recording_modes(vector, objective)
            exact = output_errors(vector, objective), output_error_jacobians(vector, objective)
            return exact, output_errors_and_differences(vector, space, objective, modes)

        (errors, jacobians), (found_errors, found_jacobians) = both(jnp.asarray(vector))
    np.testing.assert_allclose(found_errors[0], errors[0], atol=1e-9)
    # Of one side the error is that of first order in the step.
    tolerance = 1e-4 if at_bound else 1e-7
    count = len(drive.time)
    np.testing.assert_allclose(
        found_jacobians[0][:, :, :count], jacobians[0][:, :, :count], atol=tolerance
    )
