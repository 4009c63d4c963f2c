r"""The uncertainty of a match, propagated to its predictions.

A match determines some combinations of its parameters far better than the parameters themselves.
These combinations are nonlinear: simulations of a Gaussian sample of the parameters would deviate
from the recordings that were matched. The prediction is therefore linearised in the unknowns $u$ at
the match, as the covariance is (the delta method; for models of many parameters see Immer, Korzepa
and Bauer, AISTATS 2021):

$$\operatorname{var} \hat y_{tc} = J_{tc} \operatorname{cov}(u) J_{tc}^T + \sigma^2$$

The error of the model itself comes on top, which grows with the time since the last known reading:
`_model_error`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arguments import finite_number, of_kind, whole_number
from .._display import picture
from .._jax_settings import own_settings
from .._name_suggestions import did_you_mean
from .._progress import announced
from .._result import AbstractResult, dataset, table
from ..errors import MatchError
from ..io import Experiment, as_experiments
from ..physics import Twin
from ..rig import Parameter
from ..simulation import Initial, Run, response, simulate
from ._fit import Fit, solution_of
from ._group_values import group_and_shared_values
from ._initial_conditions import WARM_UP, InitialConditions, estimate_initial_conditions
from ._match_group import NEW_GROUP, check_given, match_first_part, match_group

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


def posterior_draws(
    fit: Fit, draws: int, *, seed: int = 0, group: str | None = None
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draws the matched parameters of the rig from the covariance of a match.

    The parameters are drawn jointly from a normal distribution, positive parameters by their
    logarithms, and clipped to their bounds. The covariance includes the differences of the rig
    between recordings (`Uncertainty.between_recordings`). Values that belong to a single recording,
    such as the ambient temperature, are not drawn.

    The distribution is that of a linear model at the match. If the recordings determine a nonlinear
    combination of parameters far better than each parameter, simulations of some draws deviate from
    the recordings. `prediction_band` is linear and is not affected.

    **Arguments:**

    - `fit`: a match.
    - `draws`: the number of draws.
    - `seed`: the seed; the same seed gives the same draws.
    - `group`: the group of recordings whose values are drawn; None for a group that was not
      matched, whose values vary more.

    **Returns:** name -> values `(draws,)` in the unit of the rig's table, as `simulate_batch` and
    `simulate_closed_loops` take them.

    **Raises:** `MatchError` if `fit` is not a fit, the group was not matched, or a number is not a
    positive whole number.
    """
    of_kind("posterior_draws: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    count = whole_number("posterior_draws: draws", draws, 1, MatchError)
    solution = solution_of(fit)
    names = solution.problem.group_names
    if group is not None and group not in names:
        raise MatchError(
            f"posterior_draws: group: expected one of {', '.join(names)}, or None, got {group!r}"
            f"{did_you_mean([group], names)}"
        )
    number = 0 if len(names) == 1 else None if group is None else names.index(group)
    known = group_and_shared_values(solution.problem.unknowns, solution.vector, number)
    between = np.diag(fit.uncertainty.between_recordings**2)
    covariance = known.covariance(fit.uncertainty.vector_covariance + between)
    # By eigenvectors, because a singular covariance has no Cholesky factor.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    random = np.random.default_rng(whole_number("posterior_draws: seed", seed, 0, MatchError))
    entries = known.mean + random.normal(size=(count, len(values))) @ root.T
    with np.errstate(
        over="ignore"
    ):  # of values that are hardly known; they are clipped to their bounds
        return {
            row.name: np.clip(
                np.exp(column) if row.is_logarithmic else column, row.lower, row.upper
            )
            for row, column in zip(known.rows, entries.T, strict=True)
        }


# The default probability inside a band.
LEVEL = 0.95


@final
@dataclass(frozen=True, repr=False, eq=False)
class Band(AbstractResult):
    """The interval in which a reading lies with a given probability, for each channel and time.

    **Arguments:**

    - `run`: the twin's prediction, the middle of the band.
    - `lower`, `upper`: the edges of the band, `(times, channels)`, degC.
    - `level`: the probability.
    """

    run: Run
    lower: Float[np.ndarray, "times channels"]
    upper: Float[np.ndarray, "times channels"]
    level: float

    @property
    def time(self) -> Float[np.ndarray, " times"]:
        """Times of the samples, s."""
        return self.run.time

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return self.run.channels

    @property
    def middle(self) -> Float[np.ndarray, "times channels"]:
        """The twin's prediction, `(times, channels)`, degC."""
        return self.run.temperatures

    @property
    def width(self) -> Float[np.ndarray, " channels"]:
        """The mean width of the band in each channel, K."""
        return (self.upper - self.lower).mean(axis=0)

    @property
    def coverage(self) -> Float[np.ndarray, " channels"]:
        """The part of the recorded samples inside the band in each channel, 0 to 1.

        A band that is wide enough contains everything: the coverage says nothing without the width.

        **Raises:** `MatchError` if the experiment has no temperatures.
        """
        recorded = self.run.experiment.temperatures
        if recorded is None:
            raise MatchError("coverage: expected recorded temperatures, got none")
        inside = (recorded >= self.lower) & (recorded <= self.upper)
        sampled = self.run.experiment.sampled
        return np.sum(inside & sampled, axis=0) / np.maximum(sampled.sum(axis=0), 1)

    def between(self, t0: float | int | None = None, t1: float | int | None = None) -> "Band":
        """The part of the band with `t0 <= time < t1`, as `Experiment.between` cuts.

        **Raises:** the errors of `Experiment.between`.
        """
        run = self.run.between(t0, t1)
        inside = np.isin(self.time, run.time)
        return Band(run, self.lower[inside], self.upper[inside], self.level)

    def plot(self) -> "Figure":
        """Plots the band, the prediction and the recorded temperatures, a panel for each channel:
        `jaxtwin.plots.plot_bands`."""
        return picture("plot_bands", self.run, self.lower, self.upper, level=self.level)

    def to_xarray(self) -> "xarray.Dataset":
        """The band as a dataset: lower, middle and upper (time, channel), degC."""
        band = "time channel"
        return dataset(
            {
                "lower": (band, self.lower, "degC"),
                "middle": (band, self.middle, "degC"),
                "upper": (band, self.upper, "degC"),
                "time": ("time", self.time, "s"),
            },
            {"rig": self.run.rig, "level": self.level},
            channel=self.channels,
        )

    def __repr__(self) -> str:
        return (
            f"<Band of {self.run.rig}: {100 * self.level:g} % within {self.width.mean():.2f} K on "
            f"average, {len(self.time)} times, {len(self.channels)} channels>"
        )

    def _overview(self) -> "pandas.DataFrame":
        widths = self.upper - self.lower
        columns = {
            "channel": self.channels,
            "mean width, K": self.width,
            "largest, K": widths.max(axis=0),
        }
        if self.run.experiment.temperatures is not None:
            columns["samples inside, %"] = 100 * self.coverage
        return table(columns)


@announced("prediction band")
def prediction_band(
    fit: Fit,
    recording: str | None = None,
    *,
    experiment: Experiment | None = None,
    level: float = LEVEL,
    warm_up: float | int = WARM_UP,
    group: str | None = None,
    given: Experiment | Sequence[Experiment] | float | int | None = None,
    initial: Initial = None,
) -> Band:
    """Computes the interval in which each reading is expected.

    The band includes the joint covariance of the matched parameters, the noise of a reading with
    the twin's unexplained error and the camera's common error, and the error of the model itself
    (`Fit.model_error`), which grows after the last known reading. For an experiment that was not
    matched it also includes the differences of the rig between recordings
    (`Uncertainty.between_recordings`) and the recording's own values (room, start, delay) with
    their covariance. `estimate_initial_conditions` estimates these from the first `warm_up`
    seconds; samples in that part are not predicted.

    **Arguments:**

    - `fit`: a match.
    - `recording`: the name of the matched recording whose own values are used. By default that is
      `experiment` if it was matched, and the first recording if `experiment` has no temperatures.
    - `experiment`: the inputs to predict; by default those of that recording.
    - `level`: the probability inside the band.
    - `warm_up`: the length of the part from which own values are estimated, s.
    - `group`: the group of the experiment; by default the one that it names itself.
    - `given`: further data of the group, as in `validate`: the length of the first part of the
      experiment itself, s, which replaces `warm_up`, or other recordings. By default the values are
      those that the fit knows of the group; for a new one those expected of any group, and the band
      contains the differences between groups.
    - `initial`: the temperatures at the start of an experiment that was not matched, as in
      `validate`.

    **Returns:** the band at the experiment's times, for the channels that the experiment names, or
    for all channels.

    **Raises:** `MatchError` for a recording that was not matched, a level outside 0 to 1, or an
    experiment that is too short; `SimulationError` for an experiment of another rig.
    """
    of_kind("prediction_band: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    if recording is not None and recording not in fit.recordings:
        raise MatchError(
            f"recording: expected one of {', '.join(fit.recordings)}, got {recording!r}"
            f"{did_you_mean([recording], fit.recordings)}"
        )
    finite_number("prediction_band: level", level, MatchError, above=0, below=1)
    if recording is None and experiment is not None and experiment.fingerprint in fit.fingerprints:
        recording = fit.recordings[fit.fingerprints.index(experiment.fingerprint)]
    if recording is None and experiment is not None and experiment.temperatures is not None:
        group = experiment.group if group is None else group
        if given is not None:
            group = group or NEW_GROUP
            check_given(fit, [group], [experiment])
            if isinstance(given, float | int):
                span = finite_number("prediction_band: given", given, MatchError)
                first = match_first_part(fit, experiment, span, group)
                return prediction_band(
                    first, first.recordings[0], experiment=experiment, level=level
                )
            recordings = as_experiments("prediction_band: given", given, MatchError, fit.twin.rig)
            check_given(fit, [group], recordings)
            fit = match_group(fit, recordings, group)
        start = estimate_initial_conditions(fit, experiment, warm_up, group=group, initial=initial)
        known_until = float(experiment.time[0]) + warm_up
        values = values_of_unseen(fit, group, start)
        return band_about(fit, experiment, values, known_until, level)
    number = 0 if recording is None else fit.recordings.index(recording)
    experiment = fit.experiments[number] if experiment is None else experiment
    values = values_of_matched(fit, fit.recordings[number])
    return band_about(fit, experiment, values, _known_until(fit, number, experiment), level)


def _known_until(fit: Fit, number: int, experiment: Experiment) -> float:
    """The end of a matched recording in an experiment that begins with it, else the start, s."""
    problem = solution_of(fit).problem
    matched = problem.experiments[number] if problem.experiments else experiment
    is_continued = experiment.begins_with(matched)
    return float(matched.time[-1] if is_continued else experiment.time[0])


@final
@dataclass(frozen=True, eq=False)
class UncertainValues:
    """The values of a recording with their uncertainty.

    - `twin`: the twin with these values.
    - `rows`: the uncertain parameters. `covariance`: of their entries in the optimiser's vector.
    - `initial`: the temperatures at the start, as `simulate` takes them.
    """

    twin: Twin
    rows: tuple[Parameter, ...]
    covariance: Float[np.ndarray, "rows rows"]
    initial: Initial = None


def band_about(
    fit: Fit,
    experiment: Experiment,
    values: UncertainValues,
    known_until: float,
    level: float = LEVEL,
) -> Band:
    """The band about the run of an experiment with uncertain values.

    **Arguments:**

    - `known_until`: the time of the last reading that the values rest on, s.
    """
    from scipy.special import ndtri  # takes a while to import

    slopes = _slopes(values, experiment)
    variance = np.einsum("tci,ij,tcj->tc", slopes, values.covariance, slopes)
    variance += _reading_noise(fit) ** 2
    run = simulate(values.twin, experiment, initial=values.initial)
    ahead = np.maximum(experiment.time - known_until, 0.0)
    variance += fit.model_error.variance(ahead, run.temperatures, run.channels)
    half = float(ndtri((1 + level) / 2)) * np.sqrt(variance)
    return Band(run, run.temperatures - half, run.temperatures + half, float(level))


def values_of_matched(fit: Fit, recording: str) -> UncertainValues:
    """The values of a matched recording."""
    unknowns = solution_of(fit).problem.unknowns
    places = unknowns.layout.entry_indices()[fit.recordings.index(recording)]
    covariance = np.nan_to_num(fit.uncertainty.vector_covariance)[np.ix_(places, places)]
    rows = unknowns.shared + unknowns.per_group + unknowns.per_recording
    initial = solution_of(fit).problem.initial
    return UncertainValues(fit.twins[recording], rows, covariance, initial)


def values_of_unseen(fit: Fit, group: str, start: InitialConditions) -> UncertainValues:
    """The values of a recording that was not matched."""
    solution = solution_of(fit)
    names = solution.problem.group_names
    number = names.index(group) if group in names else None
    match = group_and_shared_values(solution.problem.unknowns, solution.vector, number)
    between = np.diag(fit.uncertainty.between_recordings**2)
    covariance = match.covariance(fit.uncertainty.vector_covariance + between)
    # Estimates from the recording itself replace those of the match.
    kept = [n for n, row in enumerate(match.rows) if row.name not in start.values]
    table = fit.twin.rig.parameters
    rows = [match.rows[n] for n in kept] + [table[name] for name in start.values]
    known = np.zeros((len(rows), len(rows)))
    known[: len(kept), : len(kept)] = covariance[np.ix_(kept, kept)]
    known[len(kept) :, len(kept) :] = start.covariance
    return UncertainValues(start.twin, tuple(rows), known, start.initial)


def _slopes(
    known: UncertainValues, experiment: Experiment
) -> Float[np.ndarray, "times channels entries"]:
    """Derivatives of the readings with respect to parameters, or to the logarithms of those that
    are matched by them."""
    twin, rows = known.twin, known.rows
    values = np.array([float(twin.values[row.name]) for row in rows])

    def read(vector: Float[Array, " entries"]) -> Float[Array, "times channels"]:
        named = {row.name: vector[entry] for entry, row in enumerate(rows)}
        return response(twin.with_values(named), experiment, initial=known.initial)

    with own_settings():
        slopes = np.asarray(jax.jacfwd(read)(jnp.asarray(values)))
    return slopes * np.where([row.is_logarithmic for row in rows], values, 1.0)


def _reading_noise(fit: Fit) -> float:
    """Standard deviation of a reading about the twin's temperature, K."""
    return math.hypot(fit.rmse, fit.camera_error)
