r"""Behavioural matching: parameters from recordings, step 4 of the paper.

A match finds the unknowns $u$, the free parameters, that minimise

$$\sum_{tc} \frac{w_{tc} (D_{tc} - m_t)^2}{\sigma_i^2} + \sum_t \frac{w_t (m_t - c_t)^2}{\sigma_m^2}
+ \text{priors of } u \text{ and of the camera's error } c,$$

where $D$ is the simulated minus the recorded temperature, and $m$ its mean over the channels. Their
covariance is $A^{-1} (J^T \Gamma J + P) A^{-1}$ with $A = J^T J + P$. Which file holds what:

- the unknowns: `_unknowns` (vector, bounds), `_group_values` (days that differ)
- what is given: `_recordings` (checks, masks), `_start` (how they begin), `_problem` (arguments)
- what a sample counts: `_noise_model`, `_loss`, `_camera_error`, `_residual_weights`
- the cost: `_objective` (recordings as arrays), `_native_recordings` (draws in C), `_residuals` and
  `_jacobian` (solve and subtract)
- the minimum: `_descent`, `_descent_result`, `_levenberg_marquardt`,
  `_optimistix` (other solvers), `_reweighted_least_squares` (rounds with new weights)
- the uncertainty: `_uncertainty`, `_autocovariance` ($\Gamma$), `_model_error`
- the entries: `_match`, `_many` (sets side by side), `_match_group` (a new group)
- the result: `_fit`, `_fitted_parameters`, `_summary`, `_nominal_twin`
- its file: `_stored_fit` (what it holds), `_save_fit`, `_load_fit`
- what follows from it: `_band`, `_profile`, `_compare_fits`
- a recording that was not matched: `_initial_conditions`, `_initial_condition_priors`
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
