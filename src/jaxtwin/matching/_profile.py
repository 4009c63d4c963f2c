r"""Profile likelihood: the cost of the match as a function of one parameter.

At each value $\theta$ of the parameter all other parameters are matched again. The cost weights
residuals as if they were independent with a standard deviation of 1; eq. (11) without priors even
counts them in K. The increase of $2 \,\text{cost}$ is therefore scaled to the estimated noise of
the residuals, with its size and autocorrelation, by one factor,

$$w(\theta) = 2 \, \frac{(A^{-1})_{\theta\theta}}{\operatorname{cov}_{\theta\theta}}
\left(\text{cost}(\theta) - \text{cost}(\hat\theta)\right)$$

with $A^{-1}$ and cov of `_uncertainty`. Near the match it is the squared distance divided by the
squared standard error that the match reports, and it follows a chi-squared distribution with one
degree of freedom, which the plain increase does not (Kent, Biometrika 69 (1982) 19-27; for a single
parameter beside others Pace, Salvan and Sartori, Statistica Sinica 21 (2011) 129-148; the vertical
adjustment of Chandler and Bate, Biometrika 94 (2007) 167-183). Values where it is below 3.84 are
inside the 95 % interval. This also holds where the covariance, which contains the slope at a single
point, gives another interval.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._arguments import check_callable, of_kind, whole_number
from .._display import picture
from .._lapack import one_blas_thread
from .._name_suggestions import did_you_mean
from .._number_text import short_number
from .._progress import announced
from .._result import AbstractResult, dataset
from ..errors import MatchError, ParameterError
from ._descent import descend
from ._descent_result import DescentStep, Iteration, make_iteration
from ._fit import Fit, solution_of
from ._match import default_solver
from ._objective import make_objective

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

# The 95 % quantile of the chi-squared distribution with one degree of freedom.
CHI2_95 = 3.841

# The weight with which an entry is held: the reciprocal of the standard deviation by which it may
# move.
PINNED_PRIOR_WEIGHT = 1e6


# The smallest number of points: the match and one on each side.
MIN_POINTS = 3


@final
@dataclass(frozen=True, repr=False, eq=False)
class Profile(AbstractResult):
    """A profile likelihood.

    **Arguments:**

    - `name`, `unit`: name and unit of the parameter.
    - `values`: the values at which the parameter was held, `(points,)`.
    - `excess`: the increase of twice the cost over that at the match, `(points,)`, in units of the
      noise: near the match it is the squared distance in standard errors. In a linear model it is 9
      at three standard errors.
    - `interval`: the 95 % interval, where the excess is below 3.84. Between points the square root
      of the excess is interpolated linearly, which is exact for a linear model. An end is infinite
      if the excess does not reach the limit on that side, and a bound if that was reached.
    """

    name: str
    unit: str
    values: Float[np.ndarray, " points"]
    excess: Float[np.ndarray, " points"]
    interval: tuple[float, float]

    def plot(self) -> "Axes":
        """Plots the excess over the parameter, with the interval: `jaxtwin.plots.plot_profile`."""
        return picture("plot_profile", self)

    def to_xarray(self) -> "xarray.Dataset":
        """The profile as a dataset: excess (value); the interval is an attribute."""
        return dataset(
            {
                "excess": ("value", self.excess, "1"),
                "value": ("value", self.values, self.unit or "1"),
            },
            {"parameter": self.name, "lower": self.interval[0], "upper": self.interval[1]},
        )

    def __repr__(self) -> str:
        low, high = map(short_number, self.interval)
        interval = f"{low} to {high} {self.unit}".rstrip()
        return f"<Profile of {self.name}: 95 % interval {interval}, {len(self.values)} points>"

    def _overview(self) -> "pandas.DataFrame":
        return self.to_dataframe().rename_axis(f"{self.name}, {self.unit or '1'}")


@announced("profile likelihood")
@one_blas_thread()
def profile(
    fit: Fit,
    name: str,
    values: Sequence[float] | Float[np.ndarray, " values"] | None = None,
    points: int = 9,
    *,
    on_progress: Callable[[Iteration], None] | None = None,
) -> Profile:
    """Computes the profile likelihood of a parameter.

    **Arguments:**

    - `fit`: a match.
    - `name`: the name of a matched parameter with a single value, or the value of a group or of a
      recording as the labels of `fit.uncertainty` name it, such as `R_pc1_row2[full]`.
    - `values`: the values at which to hold the parameter, in its unit. By default `points` values
      within three standard errors (without a standard error: within a factor of twenty, or three
      tenths of its range), inside its bounds.
    - `points`: the number of values, at least 3.
    - `on_progress`: called with each `Iteration` when it ends; its `start` is the number of the
      point, counted from 0.

    **Returns:** the profile. Its points increase; points that coincide at a bound are merged.

    **Raises:** `ParameterError` for a name that was not matched; `MatchError` for values outside
    the bounds, fewer than 3 points, or a fit that was loaded without its recordings.
    """
    of_kind("profile: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    solution = solution_of(fit)
    unknowns = solution.problem.unknowns
    problem = replace(solution.problem, experiments=fit.experiments)  # a loaded problem has none
    labels = problem.labels
    if name not in labels:
        raise ParameterError(
            f"profile: expected one of the matched values {', '.join(labels)}, got {name!r}"
            f"{did_you_mean([name], labels)}"
        )
    if values is None:
        whole_number("profile: points", points, MIN_POINTS, MatchError)
    check_callable("profile: on_progress", on_progress, MatchError)
    entry = labels.index(name)
    row = unknowns.entry_parameters[entry]
    lower, upper = unknowns.lower()[entry], unknowns.upper()[entry]
    if values is None:
        standard_deviation = float(np.sqrt(fit.uncertainty.vector_covariance[entry, entry]))
        if not np.isfinite(standard_deviation) or standard_deviation == 0:
            standard_deviation = float(unknowns.default_scales()[entry])
        at = solution.vector[entry] + np.linspace(-3, 3, points) * standard_deviation
        at = np.unique(np.clip(at, lower, upper))
    else:
        given = np.sort(np.asarray(values, dtype=float))
        if given.size == 0 or not np.all((given >= row.lower) & (given <= row.upper)):
            raise MatchError(
                f"profile: {name}: expected values from {row.lower:g} to {row.upper:g} "
                f"{row.unit}, got {given.tolist()}"
            )
        at = np.log(given) if row.is_logarithmic else given
    objective = make_objective(problem, solution.noise_model)
    objectives, starts = [], []
    for value in at:
        means, weights = np.array(objective.prior_means), np.array(objective.prior_weights)
        means[entry], weights[entry] = value, PINNED_PRIOR_WEIGHT
        objectives.append(
            eqx.tree_at(lambda o: (o.prior_means, o.prior_weights), objective, (means, weights))
        )
        start = solution.vector.copy()
        start[entry] = value
        starts.append(start)

    def report_step(number: int, step: DescentStep) -> None:
        if on_progress is not None:
            on_progress(make_iteration(problem, step, number))

    results = descend(
        [problem] * len(objectives),
        objectives,
        default_solver(problem),
        starts,
        unknowns.search_space(),
        50,
        report_step,
    )
    prior = 0.5 * ((at - objective.prior_means[entry]) * objective.prior_weights[entry]) ** 2
    rise = np.array([result.cost for result in results]) + prior - fit.cost
    excess = 2 * _adjustment(fit, entry) * rise
    shown = np.exp(at) if row.is_logarithmic else at
    return Profile(name, row.unit, shown, excess, _interval(shown, excess, row.lower, row.upper))


def _adjustment(fit: Fit, entry: int) -> float:
    """The reciprocal of the factor by which the weights of the match overstate the information of
    its residuals."""
    known = fit.uncertainty
    variance = float(known.vector_covariance[entry, entry])
    if known.labels[entry] not in known.insensitive and 0 < variance < np.inf:
        return float(known.inverse_hessian[entry, entry]) / variance
    # A value at a bound, or an undetermined one, has no covariance. The factor is then that of the
    # noisier kind of residuals.
    assumed = solution_of(fit).noise_model
    pairs = zip(fit.noise, (assumed.channel, assumed.common_mode), strict=True)
    stronger = max(result.effective / counted.effective for result, counted in pairs)
    return stronger**-2 if stronger > 0 else 1.0


def _interval(
    values: Float[np.ndarray, " points"],
    excess: Float[np.ndarray, " points"],
    lower: float,
    upper: float,
) -> tuple[float, float]:
    best = int(np.argmin(excess))
    root = np.sqrt(np.maximum(excess, 0.0))

    def crossing(order: np.ndarray, bound: float, beyond: float) -> float:
        for near, far in pairwise(order):
            if excess[far] > CHI2_95:
                part = (np.sqrt(CHI2_95) - root[near]) / (root[far] - root[near])
                return float(values[near] + part * (values[far] - values[near]))
        return bound if np.isclose(values[order[-1]], bound) else beyond

    down = crossing(np.arange(best, -1, -1), lower, -np.inf)
    return down, crossing(np.arange(best, len(values)), upper, np.inf)
