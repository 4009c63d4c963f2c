r"""Which faults can be seen, and which of them can be told apart, before anything happened.

The healthy filter runs over a simulated recording. With the signatures $g$ of the faults
(`_likelihood_ratio`) from an onset on and $C_{ij} = \sum g_i^T g_j$, fault $i$ of its usual size
raises the logarithm of its odds by $C_{ii} / 2 - \log(1 + C_{ii} \sigma^2) / 2$ in the mean, and
that of its odds against fault $j$ of any size by

$$\frac{1}{2} \left(C_{ii} - \frac{C_{ij}^2}{C_{jj}}\right).$$
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._arguments import finite_number, names_of
from .._compilation import persistent_jit
from .._display import picture
from .._jax_settings import own_settings
from .._name_suggestions import unknown_name
from .._result import AbstractResult, dataset, table
from ..errors import ObserverError
from ..io import Experiment
from ..matching import Fit
from ..observers import ExtendedKalmanFilter, Observed, ProcessNoise, observe
from ..physics import Twin
from ..simulation import simulate
from ._causes import LOG_ODDS_95, MEAN_SECONDS_BETWEEN_FAULTS
from ._diagnose import SPREAD
from ._diagnosis import TIE
from ._likelihood_ratio import RatioInputs, signature
from ._recorded import inputs_of
from ._signatures import Suspected, suspected
from ._suspects import Faults, Suspect, chosen

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

# The usual duty: all cells change after the onset as well, in both directions.
USUAL = "0:0.5,300:0.8,500:0.3"


@final
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Isolability(AbstractResult):
    """What a diagnosis can say, as `jaxtwin.isolability` finds it.

    **Arguments:**

    - `rig`: the name of the rig. `channels`: those that are read.
    - `suspects`: the faults, in the order of all tables.
    - `duration`: the time for which they are looked at, s.
    - `detection`: the time after which each fault of its usual size is found, s; infinite if it is
      not found within the duration.
    - `smallest`: the size of each fault that is found at the end of the duration.
    - `separation`: the time after which the fault of a row is told from that of a column, s;
      infinite if not within the duration.
    - `separators`: pairs of names that are not told apart -> the channel that tells them apart
      soonest if it is read as well, and after what time, s.
    """

    rig: str
    channels: tuple[str, ...]
    suspects: tuple[Suspect, ...]
    duration: float
    detection: Float[np.ndarray, " faults"]
    smallest: Float[np.ndarray, " faults"]
    separation: Float[np.ndarray, "faults faults"]
    separators: dict[tuple[str, str], tuple[str, float]]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the faults."""
        return tuple(suspect.name for suspect in self.suspects)

    @property
    def ties(self) -> list[tuple[str, str]]:
        """The pairs of faults that are found, but are not told apart, in either direction."""
        result = np.isfinite(self.detection)
        apart = np.minimum(self.separation, self.separation.T)
        count = range(len(self.names))
        return [
            (self.names[i], self.names[j])
            for i in count
            for j in count[i + 1 :]
            if result[i] and result[j] and not math.isfinite(apart[i, j])
        ]

    def summary(self) -> str:
        """It as text: a line for each fault, then the pairs that are not told apart."""
        lines = [f"{self.rig}: {len(self.channels)} channels, {self.duration:g} s"]
        for suspect, time, smallest in zip(
            self.suspects, self.detection, self.smallest, strict=True
        ):
            when = f"found after {time:.0f} s" if math.isfinite(time) else "not found"
            unit = "" if suspect.unit in ("1", "share", "multiple") else f" {suspect.unit}"
            least = f"{smallest:.3g}{unit}" if math.isfinite(smallest) else "no size"
            lines.append(f"  {suspect.name} {suspect.size:.3g}{unit}: {when}; at the end {least}")
        for pair in self.ties:
            text = f"  {pair[0]} and {pair[1]} are not told apart"
            if pair in self.separators:
                channel, time = self.separators[pair]
                text += f"; with {channel} after {time:.0f} s"
            lines.append(text)
        return "\n".join(lines)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each fault: its usual size, the time after which it is
        found, the smallest size that is found, and the times after which it is told from others."""
        columns = {
            "fault": self.names,
            "size": [suspect.size for suspect in self.suspects],
            "unit": [suspect.unit for suspect in self.suspects],
            "detection_s": self.detection,
            "smallest": self.smallest,
        }
        others = dict(zip(self.names, self.separation.T, strict=True))
        return table(columns | others, "fault")

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: detection and smallest (fault), separation (fault,
        other)."""
        return dataset(
            {
                "detection": ("fault", self.detection, "s"),
                "smallest": ("fault", self.smallest),
                "separation": ("fault other", self.separation, "s"),
            },
            {"rig": self.rig},
            fault=self.names,
            other=self.names,
        )

    def plot(self) -> "Figure":
        """Draws the matrix.

        **Returns:** the figure.
        """
        return picture("plot_isolability", self)

    def __repr__(self) -> str:
        result = int(np.isfinite(self.detection).sum())
        return (
            f"<Isolability {self.rig}: {result} of {len(self.suspects)} faults found by "
            f"{len(self.channels)} channels within {self.duration:g} s, {len(self.ties)} pairs not "
            "told apart>"
        )

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe().filter(["size", "unit", "detection_s", "smallest"])
        return rows.rename(columns={"detection_s": "found, s"})


def isolability(
    fit: Twin | Fit,
    channels: Sequence[str] | None = None,
    duty: Experiment | str | None = None,
    noise: ProcessNoise | None = None,
    *,
    faults: Faults = None,
    onset: float | int = 300.0,
    duration: float | int = 600.0,
) -> Isolability:
    """Finds which faults a diagnosis would find, which pairs of them it would tell apart, and after
    what time.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `channels`: the channels that are read; None for all. Channels that are left out are tried for
      each pair that is not told apart without them.
    - `duty`: the duty, as a schedule or an experiment, of which only times, duty and inputs matter;
      None: a schedule with changes.
    - `noise`: the levels of the noise, as for `jaxtwin.observe`.
    - `faults`: as for `jaxtwin.diagnose`.
    - `onset`: when the faults begin, s. `duration`: for how long they are looked at, s.

    **Raises:** the errors of `jaxtwin.observe`; `ObserverError` for unknown channels or faults, or
    if the experiment ends before the onset.
    """
    begin = finite_number("isolability: onset", onset, ObserverError, least=0, unit="s")
    length = finite_number("isolability: duration", duration, ObserverError, above=0, unit="s")
    twin = fit.mean_twin if isinstance(fit, Fit) else fit
    read = twin.channels
    if channels is not None:
        read = names_of("isolability: channels", channels, ObserverError)
        for name in read:
            if name not in twin.channels:
                problem = unknown_name("channel", name, twin.channels)
                raise ObserverError(f"isolability: channels: {problem}")
    several = chosen(twin, faults, read)
    recording = _planned(twin, duty, begin + length)
    if recording.time[-1] < begin + 1:
        raise ObserverError(
            f"isolability: duty: expected an experiment that goes on after the onset at {begin:g} "
            f"s, got one of {recording.duration:g} s"
        )
    grams, time = _grams(fit, recording, read, noise, several, begin)
    rate = np.median(np.diff(recording.time)) / MEAN_SECONDS_BETWEEN_FAULTS / (len(several) + 1)
    own = np.diagonal(grams, axis1=1, axis2=2)
    needed = LOG_ODDS_95 - math.log(rate)
    gained = own / 2 - np.log1p(own * SPREAD**2) / 2
    detection = _first(time, gained >= needed)
    separation = _separation(grams, time)
    result = Isolability(
        twin.rig.name, tuple(read), several, float(time[-1]), detection,
        _smallest(several, own[-1], needed), separation, {},
    )  # fmt: skip
    others = [name for name in twin.channels if name not in read]
    return dataclasses.replace(
        result, separators=_separators(fit, recording, noise, begin, result, others)
    )


def _separators(
    fit: Twin | Fit,
    recording: Experiment,
    noise: ProcessNoise | None,
    onset: float,
    isolability: Isolability,
    others: Sequence[str],
) -> dict[tuple[str, str], tuple[str, float]]:
    """The channel that tells each tied pair apart soonest."""
    best: dict[tuple[str, str], tuple[str, float]] = {}
    if not isolability.ties:
        return best
    for channel in others:
        more = (*isolability.channels, channel)
        times = _separation(*_grams(fit, recording, more, noise, isolability.suspects, onset))
        for pair in isolability.ties:
            i, j = (isolability.names.index(name) for name in pair)
            time = float(min(times[i, j], times[j, i]))
            if time < best.get(pair, ("", math.inf))[1]:
                best[pair] = (channel, time)
    return best


def _planned(twin: Twin, duty: Experiment | str | None, end: float) -> Experiment:
    """A recording without noise under a duty."""
    plan = duty
    if not isinstance(plan, Experiment):
        plan = Experiment.schedule(
            USUAL if plan is None else plan,
            duration=end,
            step=1.0,
            cells=len(twin.rig.driven),
        )
    elif plan.duration > end:
        plan = plan.between(None, np.nextafter(plan.time[0] + end, np.inf))
    return simulate(twin, plan).to_recording(noise=0.0)


def _grams(
    fit: Twin | Fit,
    recording: Experiment,
    read: Sequence[str],
    noise: ProcessNoise | None,
    several: Sequence[Suspect],
    onset: float,
) -> tuple[Float[np.ndarray, "times faults faults"], Float[np.ndarray, " times"]]:
    """C at each time since the onset, if some channels are read; those that are not have no
    readings, so that all choices share a program."""
    assert recording.temperatures is not None
    is_read = np.array([name in read for name in recording.channels])
    readings = np.where(is_read, recording.temperatures, np.nan)
    partly = dataclasses.replace(recording, temperatures=readings)
    observed = observe(fit, partly, noise)
    return grams_of(observed, suspected(observed.observer.model, several), onset)


def grams_of(
    observed: Observed, arrays: Suspected, onset: float
) -> tuple[Float[np.ndarray, "times faults faults"], Float[np.ndarray, " times"]]:
    """C at each time since the onset, by an observer that follows a recording of a healthy rig."""
    inputs = inputs_of(observed, 0)
    time = np.cumsum(observed.samples.dt)
    length = len(inputs.begins)
    begins = np.zeros(length, bool)
    begins[int(np.searchsorted(time, onset, side="right"))] = True
    with own_settings():
        result = np.asarray(_followed(observed.observer, arrays, inputs._replace(begins=begins)))
    is_after = time > onset
    return result[: len(time)][is_after], time[is_after] - onset


@persistent_jit
def _followed(
    kalman: ExtendedKalmanFilter, faults: Suspected, inputs: RatioInputs
) -> Float[Array, "samples faults faults"]:
    """C after each sample, for faults from one sample on."""
    size, count = kalman.model.layout.size, len(faults.drift)

    def take(carry: tuple[Array, ...], given: RatioInputs) -> tuple[tuple[Array, ...], Array]:
        error, held, gram, begun = carry
        readings = jnp.nan_to_num(kalman.model.from_degC(jnp.asarray(given.sample.readings)))
        held = jnp.where(given.begins, readings, held)
        begun = begun | given.begins
        (error, seen), _ = signature(kalman, faults, given.before, error, held[None], given.sample)
        error, seen = jnp.where(begun, error, 0.0), jnp.where(begun, seen[:, 0], 0.0)
        gram = gram + seen.T @ seen
        return (error, held, gram, begun), gram

    none = (
        jnp.zeros((size, 1, count)),
        jnp.zeros(len(kalman.model.columns)),
        jnp.zeros((count, count)),
        jnp.asarray(False),
    )
    return jax.lax.scan(take, none, inputs)[1]


def evidence_of(
    grams: Float[np.ndarray, "times faults faults"],
) -> Float[np.ndarray, "times faults faults"]:
    """The mean logarithm of the odds of the fault of each row against that of each column, of any
    size."""
    own = np.diagonal(grams, axis1=1, axis2=2)
    shared = grams**2 / np.maximum(own[:, None, :], 1e-12)
    return (own[:, :, None] - shared) / 2


def _separation(
    grams: Float[np.ndarray, "times faults faults"], time: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "faults faults"]:
    """The time after which the fault of each row is told from that of each column."""
    apart = _first(time, evidence_of(grams) >= math.log(TIE))
    np.fill_diagonal(apart, math.inf)
    return apart


def _first(
    time: Float[np.ndarray, " times"], is_there: Bool[np.ndarray, "times *faults"]
) -> Float[np.ndarray, "*faults"]:
    """The first time from which on something holds; infinite if it does not at the end."""
    # From the last time on at which it does not hold.
    since = len(time) - np.argmin(is_there[::-1], axis=0)
    since = np.where(is_there.all(axis=0), 0, since)
    return np.where(is_there[-1], time[np.minimum(since, len(time) - 1)], math.inf)


def _smallest(
    several: Sequence[Suspect], information: Float[np.ndarray, " faults"], needed: float
) -> Float[np.ndarray, " faults"]:
    """The size at which each fault is found at the end."""
    limits = []
    for suspect, own in zip(several, information, strict=True):
        least = needed + math.log1p(own * SPREAD**2) / 2
        multiple = math.sqrt(2 * least / own) if own > 0 else math.inf
        limits.append(suspect.size_of(multiple) if multiple <= suspect.largest else math.nan)
    return np.array(limits)
