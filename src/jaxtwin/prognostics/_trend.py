r"""A trend over sessions that differ by more than their own errors.

The estimate of session $k$, made at the time $t_k$ with the standard error $s_k$, is

$$y_k = a + b (t_k - \bar t) + u_k + e_k, \qquad u_k \sim N(0, \tau^2), \; e_k \sim N(0, s_k^2).$$

This is a random-effects meta-regression (Thompson and Sharp, Statistics in Medicine 18 (1999)
2693-2708). With the weights $w_k = 1 / (s_k^2 + \tau^2)$, $Q(\tau^2) = \sum_k w_k (y_k - \hat
y_k)^2$ falls with $\tau^2$. The estimate of Paule and Mandel (J. Res. Natl. Bur. Stand. 87 (1982)
377-385) solves $Q(\tau^2) = n - 2$, its expected value. $Q$ at the true $\tau^2$ is distributed as
$\chi^2_{n-2}$, which gives an interval of $\tau$ (Viechtbauer, Statistics in Medicine 26 (2007)
37-52). Student's distribution with $n - 2$ degrees of freedom stands for what is not known of
$\tau$, as in Knapp and Hartung (Statistics in Medicine 22 (2003) 2693-2710): their factor $Q / (n -
2)$ is 1 here, or would be below 1 where $\tau = 0$, where it is left out.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

# The fewest sessions that a trend can be found in: two of them always lie on a line.
MIN_SESSIONS = 3

# The quantile at the upper end of an interval of 95 %.
UPPER_QUANTILE = 0.975

# The number of values of the line at one time over which its value at another is integrated.
QUADRATURE_POINTS = 1001


@final
@dataclass(frozen=True, eq=False)
class Trend:
    r"""A straight line over the times of sessions, with the spread between sessions.

    **Arguments:**

    - `centre`: the weighted mean of the times, at which the line has the value `level`.
    - `level`, `slope`: of the line. `level_error`, `slope_error`: their standard errors, which are
      independent.
    - `degrees_of_freedom`: those of Student's distribution of both, the sessions less two.
    - `spread`: $\tau$, the standard deviation of a session from the line, beyond its own error.
    - `spread_interval`: its 95 % interval.
    """

    centre: float
    level: float
    level_error: float
    slope: float
    slope_error: float
    degrees_of_freedom: int
    spread: float
    spread_interval: tuple[float, float]

    @property
    def p_value(self) -> float:
        """The probability of a slope at least as large in size if there were no trend."""
        from scipy.stats import t

        return float(2 * t.sf(abs(self.slope) / self.slope_error, self.degrees_of_freedom))

    @property
    def reach(self) -> float:
        """How many standard errors an interval of 95 % reaches to each side."""
        from scipy.stats import t

        return float(t.ppf(UPPER_QUANTILE, self.degrees_of_freedom))

    def line(self, times: ArrayLike | float | int) -> Float[np.ndarray, "..."]:
        """The line at some times."""
        return np.asarray(self.level + self.slope * (np.asarray(times) - self.centre))

    def line_error(self, times: ArrayLike | float | int) -> Float[np.ndarray, "..."]:
        """Its standard error."""
        away = np.asarray(times) - self.centre
        return np.asarray(np.hypot(self.level_error, self.slope_error * away))

    def session_error(self, times: ArrayLike | float | int) -> Float[np.ndarray, "..."]:
        """The standard error of the prediction for a new session: that of the line and the spread
        between sessions."""
        return np.asarray(np.hypot(self.line_error(times), self.spread))

    def distance(self, time: float, value: float, error: float) -> tuple[float, float]:
        """How far the estimate of another session is from the line, in standard errors, and the
        probability of a distance at least as large."""
        from scipy.stats import t

        away = (value - self.line(time)) / np.hypot(self.session_error(time), error)
        return float(away), float(2 * t.sf(abs(away), self.degrees_of_freedom))

    def probability_of_passing(
        self, limit: float, now: float, within: float | int, *, is_upward: bool
    ) -> float:
        r"""The probability that the line is beyond a limit at some time within the span.

        A line is beyond a limit within a span if it is at one of the ends of the span. Its values
        at both have a joint Student's distribution; given the value $z$ at the first, in standard
        errors, that at the second has the degrees of freedom $\nu + 1$ and a variance that is
        larger by $(\nu + z^2) / (\nu + 1)$.

        **Arguments:**

        - `limit`: the limit.
        - `now`, `within`: the span begins at `now` and ends `within` later, 0 or more.
        - `is_upward`: whether values above the limit are beyond it, or those below.
        """
        from scipy.stats import t

        nu, then = self.degrees_of_freedom, now + within
        z = t.ppf((np.arange(QUADRATURE_POINTS) + 0.5) / QUADRATURE_POINTS, nu)
        first = self.line(now) + z * self.line_error(now)
        covariance = self.level_error**2 + self.slope_error**2 * (now - self.centre) * (
            then - self.centre
        )
        slope = covariance / self.line_error(now)
        left = np.maximum(self.line_error(then) ** 2 - slope**2, 0.0)
        spread = np.sqrt(left * (nu + z**2) / (nu + 1))
        away = limit - (self.line(then) + slope * z)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(spread > 0, away / spread, np.copysign(np.inf, away))
        later = t.sf(distance, nu + 1) if is_upward else t.cdf(distance, nu + 1)
        is_beyond = first > limit if is_upward else first < limit
        return float(np.mean(np.where(is_beyond, 1.0, later)))


def random_effects_trend(
    times: Float[np.ndarray, " sessions"],
    values: Float[np.ndarray, " sessions"],
    errors: Float[np.ndarray, " sessions"],
) -> Trend:
    """Finds the trend of estimates of several sessions.

    **Arguments:**

    - `times`: the times of three sessions or more, not all of them equal.
    - `values`, `errors`: the estimates and their standard errors, which are above 0.
    """
    from scipy.stats import chi2

    freedom = len(values) - 2
    variance = _variance_at(float(freedom), times, values, errors)
    ends = [
        _variance_at(float(chi2.ppf(part, freedom)), times, values, errors)
        for part in (UPPER_QUANTILE, 1 - UPPER_QUANTILE)
    ]
    weights = 1 / (errors**2 + variance)
    centre, level, slope = _weighted_line(times, values, weights)
    return Trend(
        centre=centre,
        level=level,
        level_error=float(weights.sum() ** -0.5),
        slope=slope,
        slope_error=float((weights @ (times - centre) ** 2) ** -0.5),
        degrees_of_freedom=freedom,
        spread=variance**0.5,
        spread_interval=(ends[0] ** 0.5, ends[1] ** 0.5),
    )


def _weighted_line(
    times: Float[np.ndarray, " sessions"],
    values: Float[np.ndarray, " sessions"],
    weights: Float[np.ndarray, " sessions"],
) -> tuple[float, float, float]:
    """The weighted mean of the times, and level and slope of the line of least squares there."""
    centre, level = (float(weights @ part / weights.sum()) for part in (times, values))
    away = times - centre
    slope = float(weights @ (away * (values - level)) / (weights @ away**2))
    return centre, level, slope


def _variance_at(
    target: float,
    times: Float[np.ndarray, " sessions"],
    values: Float[np.ndarray, " sessions"],
    errors: Float[np.ndarray, " sessions"],
) -> float:
    """The variance between sessions at which Q has this value; 0 if it is never as large."""
    from scipy.optimize import brentq

    def excess(variance: float) -> float:
        weights = 1 / (errors**2 + variance)
        centre, level, slope = _weighted_line(times, values, weights)
        residuals = values - level - slope * (times - centre)
        return float(weights @ residuals**2) - target

    if excess(0.0) <= 0:
        return 0.0
    # Q is at most the sum of squares about the unweighted mean, divided by the variance.
    upper = float(np.var(values)) * len(values) / target
    return float(brentq(excess, 0.0, upper, xtol=1e-14 * upper))  # pyright: ignore[reportArgumentType]
