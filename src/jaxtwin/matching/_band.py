r"""What a match does not know, carried on to what it predicts.

A match determines combinations of its parameters far better than the parameters themselves. A
Gaussian sample of them leaves these combinations where they are curved, and its simulations then
lie beside the recordings that were matched. The prediction is therefore linear in the unknowns $u$
about the match, as the covariance is (the delta method; for models of many parameters see Immer,
Korzepa and Bauer, AISTATS 2021):

$$\operatorname{var} \hat y_{tc} = J_{tc} \operatorname{cov}(u) J_{tc}^T + \sigma^2$$
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arguments import finite_number, of_kind
from .._display import html_table, picture
from .._errors import MatchError
from .._jax_settings import own_settings
from .._waiting import announced
from ..io import Experiment
from ..io._experiment import as_experiments
from ..physics import Twin
from ..rig import Parameter
from ..simulation import Run, response, simulate
from ._fit import Fit
from ._group_values import group_and_shared_values
from ._initial_conditions import WARM_UP, InitialConditions, estimate_initial_conditions
from ._match_group import NEW_GROUP, check_given, match_first_part, match_group

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, repr=False, eq=False)
class Band:
    """Where a reading lies with a given probability.

    **Arguments:**

    - `run`: what the twin says, in the middle of the band.
    - `lower`, `upper`: edges of the channels' readings, `(times, channels)`, degC.
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
        """What the twin says, `(times, channels)`, degC."""
        return self.run.temperatures

    def plot(self) -> "Figure":
        """The band and the twin, a panel for each channel, with what was recorded where something
        was: `jaxtwin.plots.plot_bands`."""
        return picture("plot_bands", self.run, self.lower, self.upper, level=self.level)

    def to_xarray(self) -> "xarray.Dataset":
        """The band with labels: lower, middle and upper (time, channel), degC."""
        import xarray

        edges = {"lower": self.lower, "middle": self.middle, "upper": self.upper}
        return xarray.Dataset(
            {name: (("time", "channel"), edge, {"units": "degC"}) for name, edge in edges.items()},
            coords={"time": ("time", self.time, {"units": "s"}), "channel": list(self.channels)},
            attrs={"rig": self.run.rig, "level": self.level},
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row for each time and channel, its index, and columns lower, middle and upper, degC."""
        return self.to_xarray().to_dataframe()

    def __repr__(self) -> str:
        width = float(np.mean(self.upper - self.lower))
        return (
            f"<Band of {self.run.rig}: {100 * self.level:g} % within {width:.2f} K on average, "
            f"{len(self.time)} times, {len(self.channels)} channels>"
        )

    def _repr_html_(self) -> str:
        widths = self.upper - self.lower
        rows = [
            (channel, f"{width.mean():.2f}", f"{width.max():.2f}")
            for channel, width in zip(self.channels, widths.T, strict=True)
        ]
        return html_table(repr(self), ("channel", "mean width, K", "largest, K"), rows)


@announced("prediction band")
def prediction_band(
    fit: Fit,
    recording: str | None = None,
    *,
    experiment: Experiment | None = None,
    level: float = 0.95,
    warm_up: float | int = WARM_UP,
    group: str | None = None,
    given: Experiment | Sequence[Experiment] | float | int | None = None,
) -> Band:
    """Where readings are expected, with everything that is not known of them.

    What is not known: the matched parameters, by their joint covariance; the noise of a reading,
    with what the twin leaves unexplained and the camera's common error in it; and for an experiment
    that the match has not seen, by how much the rig differs from recording to recording
    (`Uncertainty.between_recordings`) and the recording's own values (room, start, delay) as
    `estimate_initial_conditions` finds them in its first `warm_up` seconds, with their covariance.
    Samples in that part are not predicted.

    **Arguments:**

    - `fit`: a match.
    - `recording`: name of a matched recording whose own values to take; by default `experiment`
      where that was matched, and the first where it has no temperatures.
    - `experiment`: inputs to predict; by default that recording's.
    - `level`: probability inside the band.
    - `warm_up`: s.
    - `group`: of the experiment; by default what it says itself.
    - `given`: from what the values of a new group are estimated: the first part of the experiment
      itself, s, in place of `warm_up`, or other recordings; as in `validate`. By default they are
      those that are expected of any group, give or take what differs between groups.

    **Returns:** the band at the experiment's times, for the channels that it names, else all.

    **Raises:** `MatchError` for a recording that was not matched, a level outside 0 to 1, or an
    experiment too short to begin from; `SimulationError` for an experiment of another rig.
    """
    from scipy.special import ndtri  # takes a while to import

    of_kind("prediction_band: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    if recording is not None and recording not in fit.recordings:
        raise MatchError(
            f"recording: expected one of {', '.join(fit.recordings)}, got {recording!r}"
        )
    if not 0 < finite_number("prediction_band: level", level, MatchError) < 1:
        raise MatchError(f"prediction_band: level: expected a level between 0 and 1, got {level!r}")
    if recording is None and experiment is not None and experiment.fingerprint in fit.fingerprints:
        recording = fit.recordings[fit.fingerprints.index(experiment.fingerprint)]
    if recording is None and experiment is not None and experiment.temperatures is not None:
        group = experiment.group if group is None else group
        if given is not None:
            group = group or NEW_GROUP
            check_given(fit, [group])
            if isinstance(given, float | int):
                span = finite_number("prediction_band: given", given, MatchError)
                first = match_first_part(fit, experiment, span, group)
                return prediction_band(
                    first, first.recordings[0], experiment=experiment, level=level
                )
            recordings = as_experiments("prediction_band: given", given, MatchError)
            fit = match_group(fit, recordings, group)
        start = estimate_initial_conditions(fit, experiment, warm_up, group=group)
        twin, (rows, known) = start.twin, _known_of_unseen(fit, group, start)
    else:
        unknowns, covariance = (
            fit.problem.unknowns,
            np.nan_to_num(fit.uncertainty.vector_covariance),
        )
        rows = unknowns.shared + unknowns.per_group + unknowns.per_recording
        number = 0 if recording is None else fit.recordings.index(recording)
        experiment = fit.experiments[number] if experiment is None else experiment
        twin = fit.twins[fit.recordings[number]]
        places = unknowns.layout.entry_indices()[number]
        known = covariance[np.ix_(places, places)]
    slopes = _slopes(twin, experiment, rows)
    variance = np.einsum("tci,ij,tcj->tc", slopes, known, slopes) + _reading_noise(fit) ** 2
    run = simulate(twin, experiment)
    half = float(ndtri((1 + level) / 2)) * np.sqrt(variance)
    return Band(run, run.temperatures - half, run.temperatures + half, float(level))


def _known_of_unseen(
    fit: Fit, group: str, start: InitialConditions
) -> tuple[tuple[Parameter, ...], Float[np.ndarray, "rows rows"]]:
    """The uncertain values of a recording that was not matched, and their covariance."""
    groups = fit.problem.groups
    number = groups.index(group) if group in groups else None
    match = group_and_shared_values(fit.problem.unknowns, fit.vector, number)
    between = np.diag(fit.uncertainty.between_recordings**2)
    covariance = match.covariance(fit.uncertainty.vector_covariance + between)
    # What was estimated in the recording itself is known from there.
    kept = [n for n, row in enumerate(match.rows) if row.name not in start.values]
    table = fit.twin.rig.parameters
    rows = [match.rows[n] for n in kept] + [table[name] for name in start.values]
    known = np.zeros((len(rows), len(rows)))
    known[: len(kept), : len(kept)] = covariance[np.ix_(kept, kept)]
    known[len(kept) :, len(kept) :] = start.covariance
    return tuple(rows), known


def _slopes(
    twin: Twin, experiment: Experiment, rows: tuple[Parameter, ...]
) -> Float[np.ndarray, "times channels entries"]:
    """Derivatives of the readings in parameters, or in the logarithms of those that are matched by
    them."""
    values = np.array([float(twin.parameters[row.name]) for row in rows])

    def read(vector: Float[Array, " entries"]) -> Float[Array, "times channels"]:
        named = {row.name: vector[entry] for entry, row in enumerate(rows)}
        return response(twin.with_parameters(named), experiment)

    with own_settings():
        slopes = np.asarray(jax.jacfwd(read)(jnp.asarray(values)))
    return slopes * np.where([row.is_logarithmic for row in rows], values, 1.0)


def _reading_noise(fit: Fit) -> float:
    """Standard deviation of what a reading has beside the twin's temperature, K."""
    return math.hypot(fit.rmse, fit.camera_error)
