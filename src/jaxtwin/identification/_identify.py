"""A twin from recordings alone."""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .._arguments import check_callable, finite_number, names_of
from .._lapack import one_blas_thread
from .._progress import advanced, announced
from ..errors import MatchError
from ..io import Experiment, read_recording
from ..matching import ModelError, match
from ..matching._model_error import MAX_SPREAD
from ..physics import Twin
from ..rig import parse_rig
from ._baselines import FirstOrder, fit_first_order, fit_two_capacities
from ._identified import Candidate, Identified, rig_text
from ._log import ScreenedLog, screened_log
from ._network import DELAY, DRIFT_OF_ROOM, Family
from ._screening import EFFECTIVE_SAMPLES, NetworkScreening, Problem, Rivals, Screened
from ._structures import WORDS, in_words, kind_of, structures

Log = Experiment | str | os.PathLike[str]

MIN_SAMPLES = 60
# The time grows with the square of the number of channels: five take two minutes on two cores.
MAX_CHANNELS = 8
# Two inputs of a larger correlation cannot be told apart.
MAX_CORRELATION = 0.999
# A channel moves if the range of its readings is above this multiple of the median absolute change
# from sample to sample.
MIN_RANGE = 4.0
# The median of the size of a difference of two normal numbers, in their standard deviations.
MEDIAN_OF_DIFFERENCES = 0.954
# Structures matched in one batch, and structures that are judged on held-out blocks.
BATCH, JUDGED = 16, 24
# The number of the best, and of the simplest, structures that are also tried with a drift of the
# room, and with a delay.
VARIED = 8
# A drift or a delay is kept if the logarithm of the probability gains at least this.
MIN_GAIN = 2.0
# The first and the last origin of a held-out block, as fractions of the recording, and how many.
FIRST_ORIGIN, LAST_ORIGIN, ORIGINS = 0.35, 0.8, 4
# The smallest fraction of the recording between the first change of the last input and an origin.
EXCITED = 0.15
# Errors below these do not count: a part of the range of the readings, and K.
RELATIVE_FLOOR, FLOOR = 0.005, 0.02
# Beyond the temperatures that were matched the error grows by this part of the way: laws of loss
# that are alike inside differ by so much outside.
EXTRAPOLATION_ERROR = 0.25

# A value that is farther from the mean of its prior, in standard deviations, is reported.
FAR = 3.0


@announced("identification")
@one_blas_thread()
def identify(
    recordings: Log | Sequence[Log],
    *,
    channels: Iterable[str] | None = None,
    ambient: float | int | None = None,
    notes: str | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> Identified:
    """Finds a twin from recordings alone: the structure of its thermal network and its values.

    Thermal networks of growing size are matched side by side to the averaged recordings, by draws
    of one network that contains the parts of all. Of the most probable ones the one that predicts
    what the others do on average is chosen and matched to all readings. Matches to the first part
    of the recordings, which predict the rest, tell how far it can be trusted. The powers of the
    heaters are not in a log: the first one has 10 W, to which all heat capacities and resistances
    are relative.

    **Arguments:**

    - `recordings`: one or several recordings of the same device, or their files, with duties
      of 0 to 1 for heaters, -1 to 1 for thermoelectric cells.
    - `channels`: the channels to use, at most 8; by default all.
    - `ambient`: the temperature of the room, degC, if it is known; a recorded one is used as it is.
    - `notes`: a description of the device for its rig file.
    - `on_progress`: called with a sentence when a step begins.

    **Returns:** the chosen twin with its rivals.

    **Raises:** `MatchError` if the recordings are too short or differ in their columns, if a duty
    or a channel never changes, or if two duties always change together. `RecordingError` if a file
    cannot be read.
    """
    check_callable("identify: on_progress", on_progress, MatchError)
    room = None if ambient is None else finite_number("identify: ambient", ambient, MatchError)
    names = None if channels is None else names_of("identify: channels", channels, MatchError)

    def report(text: str, done: int = 0, total: int | None = None) -> None:
        advanced(done, total, text)
        if on_progress is not None:
            on_progress(text)

    experiments, remarks = _checked(recordings, names)
    logs = [screened_log(experiment) for experiment in experiments]
    report("first-order systems")
    first_log = logs[0]
    everything = np.ones(len(first_log.experiment.time), dtype=bool)
    firsts = [_first_order(first_log, column, everything) for column in first_log.temperatures.T]
    family = Family.of(first_log, firsts, room, _has_levels(experiments))
    spread = np.nanstd(np.concatenate([log.temperatures for log in logs]), axis=0)
    floor = np.maximum(RELATIVE_FLOOR * spread, FLOOR)
    screen, matched = _screened(family, logs, floor, report)
    report(f"judging {in_words(matched[0].problem.parts)}")
    origins = _origins(logs)
    judged = _judged(screen, logs, matched[:JUDGED], origins)
    costs = [
        end.cost + _held_out_cost(blocks, floor)
        for end, blocks in zip(matched, judged, strict=False)
    ]
    order = [int(place) for place in np.argsort(costs, kind="stable")]
    rivals = Rivals(screen, [matched[place] for place in order], np.sort(costs))
    # The chosen one is the first.
    order.insert(0, order.pop(rivals.central))
    candidates = [
        _candidate(screen, logs, costs[place], matched[place], judged[place]) for place in order
    ]
    candidates += [_candidate(screen, logs, end.cost, end, {}) for end in matched[JUDGED:]]
    baselines = _baselines(logs, origins)
    chosen, blocks = matched[order[0]], judged[order[0]]
    report(f"matching {in_words(chosen.problem.parts)}")
    text = _text(family, chosen, _reading_noise(experiments, candidates[0]), notes)
    fit = match(Twin(parse_rig(text.encode(), "identified.toml")), experiments)
    # Blocks that were matched anew say more than one linear step from the whole match.
    model_error = _model_error(family.channels, logs, blocks, fit.rmse)
    if len(experiments) == 1:
        remarks.append(
            "one recording: how much the device differs from one recording to the next is not known"
        )
    return Identified(
        replace(fit, model_error=model_error),
        tuple(candidates),
        baselines,
        tuple(remarks),
        rivals,
    )


def _checked(
    recordings: Log | Sequence[Log], channels: tuple[str, ...] | None
) -> tuple[list[Experiment], list[str]]:
    """The recordings, and remarks on what was left out of them."""
    several = (
        [recordings] if isinstance(recordings, Experiment | str | os.PathLike) else list(recordings)
    )
    if not several:
        raise MatchError("identify: recordings: expected at least one, got none")
    experiments, remarks = [], []
    for given in several:
        experiment = given if isinstance(given, Experiment) else read_recording(os.fspath(given))
        if experiment.temperatures is None:
            raise MatchError(f"{experiment.name}: expected temperatures, got none")
        if channels is not None:
            experiment = experiment.select(channels)
        if experiment.glitches:
            remarks += [f"{experiment.name}: left out {glitch}" for glitch in experiment.glitches]
            experiment = experiment.without_glitches()
        if len(experiment.channels) > MAX_CHANNELS:
            raise MatchError(
                f"{experiment.name}: expected at most {MAX_CHANNELS} channels, got "
                f"{len(experiment.channels)}; choose some by channels=, in a command --channel, or "
                "describe the rig (jaxtwin new-rig)"
            )
        _check_content(experiment)
        experiments.append(experiment)
    first = experiments[0]
    for other in experiments[1:]:
        if other.channels != first.channels or other.n_cells != first.n_cells:
            raise MatchError(
                f"{other.name}: expected the columns of {first.name}: {first.n_cells} duties and "
                f"{', '.join(first.channels)}, got {other.n_cells} and {', '.join(other.channels)}"
            )
    return experiments, remarks


def _check_content(experiment: Experiment) -> None:
    """Refuses a recording from which nothing can be learnt."""
    name, duty, readings = experiment.name, np.asarray(experiment.duty), experiment.temperatures
    assert readings is not None
    count = int(np.isfinite(readings).sum(axis=0).min())
    if count < MIN_SAMPLES:
        raise MatchError(
            f"{name}: expected at least {MIN_SAMPLES} readings of each channel, got {count}"
        )
    for actuator, column in zip(experiment.cell_names, duty.T, strict=True):
        if re.fullmatch(r"\w+", actuator, re.ASCII) is None:
            raise MatchError(
                f"{name}: duty of {actuator}: expected a name of letters, digits and _, as in a "
                "rig file; rename the column"
            )
        if np.ptp(column) == 0:
            raise MatchError(
                f"{name}: duty of {actuator}: expected a duty that changes, got {column[0]:g} "
                "throughout: its effect is not in the recording"
            )
    correlations = np.corrcoef(duty.T) if duty.shape[1] > 1 else np.eye(1)
    for a in range(duty.shape[1]):
        for b in range(a):
            if abs(correlations[a, b]) > MAX_CORRELATION:
                raise MatchError(
                    f"{name}: duties of {experiment.cell_names[b]} and {experiment.cell_names[a]}: "
                    "expected duties that also change apart, got two that always change together: "
                    "their effects cannot be separated"
                )
    for channel, column in zip(experiment.channels, readings.T, strict=True):
        present = column[np.isfinite(column)]
        noise = float(np.median(np.abs(np.diff(present))))
        if np.ptp(present) <= MIN_RANGE * noise or np.ptp(present) == 0:
            raise MatchError(
                f"{name}: {channel}: expected readings that move, got {np.ptp(present):.2g} K "
                "altogether; leave it out by channels="
            )


def _has_levels(experiments: Sequence[Experiment]) -> bool:
    """Whether a log has a single input that is no switch: with levels between off and full."""
    duty = np.concatenate([np.asarray(experiment.duty) for experiment in experiments])
    levels = np.unique(np.round(duty, 3))
    is_heater = duty.shape[1] == 1 and duty.min() >= 0
    return bool(is_heater) and int(np.count_nonzero((levels > 0) & (levels < 1))) >= 2


def _first_order(
    log: ScreenedLog, readings: Float[np.ndarray, " times"], known: np.ndarray
) -> FirstOrder:
    return fit_first_order(np.asarray(log.experiment.duty), readings, known, log.sample_time)


def _screened(
    family: Family,
    logs: Sequence[ScreenedLog],
    floor: Float[np.ndarray, " channels"],
    report: Callable[..., None],
) -> tuple[NetworkScreening, list[Screened]]:
    """All structures matched to the whole recordings, the most probable first, and with what."""
    several = structures(family)
    known = tuple(np.isfinite(log.temperatures) for log in logs)
    everything = frozenset(family.choices)
    screen = NetworkScreening(family, logs, floor, everything - {DELAY})
    ends: list[Screened] = []
    for place in range(0, len(several), BATCH):
        batch = several[place : place + BATCH]
        report(f"{in_words(batch[0])} and {len(batch) - 1} more", place, len(several))
        ends += screen.match([Problem(parts, known, {}) for parts in batch])
    ends = _most_probable(ends)
    if not ends:
        raise MatchError("identify: expected a structure with finite temperatures, got none")
    simplest = [end for end in ends[VARIED:] if end.problem.parts in several[:VARIED]]
    delayed = NetworkScreening(family, logs, floor, everything)
    bases, better = [*ends[:VARIED], *simplest], list[Screened]()
    for part, of_part in ((DRIFT_OF_ROOM, screen), (DELAY, delayed)):
        if part not in family.choices:
            continue
        report(f"the best ones and {WORDS[kind_of(part)]}", len(several), len(several))
        varied = of_part.match(
            [Problem(end.problem.parts | {part}, known, end.values) for end in bases]
        )
        gains = [base.cost - end.cost for base, end in zip(bases, varied, strict=True)]
        better += [end for end, gain in zip(varied, gains, strict=True) if gain > MIN_GAIN]
    ends = _most_probable([*ends, *better])
    if any(DELAY in end.problem.parts for end in ends[:JUDGED]):
        return delayed, ends
    # Without draws that differ in a delay runs are shorter.
    return screen, [end for end in ends if DELAY not in end.problem.parts]


def _most_probable(ends: Sequence[Screened]) -> list[Screened]:
    return sorted((end for end in ends if np.isfinite(end.cost)), key=lambda end: end.cost)


def _origins(logs: Sequence[ScreenedLog]) -> list[float]:
    """Where held-out blocks begin: all inputs have changed before."""
    first = FIRST_ORIGIN
    for log in logs:
        for column in np.asarray(log.experiment.duty).T:
            changed = np.flatnonzero(column != column[0])
            if len(changed):
                first = max(
                    first, log.experiment.time[changed[0]] / log.experiment.duration + EXCITED
                )
    return list(np.linspace(min(first, LAST_ORIGIN), LAST_ORIGIN, ORIGINS))


Blocks = dict[float, list[Float[np.ndarray, "times channels"]]]


def _judged(
    screen: NetworkScreening,
    logs: Sequence[ScreenedLog],
    matched: Sequence[Screened],
    origins: list[float],
) -> list[Blocks]:
    """For each structure, origin -> the errors of the rest of each recording, K."""
    problems = [
        Problem(end.problem.parts, tuple(_before(log, origin) for log in logs), end.values)
        for end in matched
        for origin in origins
    ]
    ends = screen.match(problems)
    errors = [
        [
            (run - log.temperatures)[log.experiment.time >= origin * log.experiment.duration]
            for run, log in zip(end.predicted, logs, strict=True)
        ]
        for end, origin in zip(ends, origins * len(matched), strict=True)
    ]
    count = len(origins)
    return [
        dict(zip(origins, errors[count * n : count * (n + 1)], strict=True))
        for n in range(len(matched))
    ]


def _before(log: ScreenedLog, origin: float) -> np.ndarray:
    """Which readings are before an origin."""
    early = log.experiment.time < origin * log.experiment.duration
    return np.isfinite(log.temperatures) & early[:, None]


def _held_out_cost(blocks: Blocks, floor: Float[np.ndarray, " channels"]) -> float:
    """What the held-out blocks add to the cost of a structure: they count as much as the readings
    that were matched."""
    variances = [np.nanmean(np.concatenate(errors) ** 2, axis=0) for errors in blocks.values()]
    return 0.5 * EFFECTIVE_SAMPLES * float(np.log(variances + floor**2).sum(axis=1).mean())


def _candidate(
    screen: NetworkScreening,
    logs: Sequence[ScreenedLog],
    cost: float,
    end: Screened,
    blocks: Blocks,
) -> Candidate:
    errors = np.concatenate(
        [run - log.temperatures for run, log in zip(end.predicted, logs, strict=True)]
    )
    rmse = np.sqrt(np.nanmean(errors**2, axis=0))
    return Candidate(
        structure=in_words(end.problem.parts),
        unknowns=len(end.values),
        cost=float(cost),
        rmse=dict(zip(screen.family.channels, map(float, rmse), strict=True)),
        held_out={origin: _root_mean_square(block) for origin, block in blocks.items()},
        far_from_prior=tuple(
            name for (name, _), entry in screen.entries(end).items() if abs(entry) > FAR
        ),
    )


def _root_mean_square(errors: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate([block.ravel() for block in errors]) ** 2)))


def _baselines(logs: Sequence[ScreenedLog], origins: Sequence[float]) -> dict[str, float]:
    """Root mean square errors of the simple models over the held-out blocks of the first
    recording, K."""
    log = logs[0]
    duty, time = np.asarray(log.experiment.duty), log.experiment.time
    squares: dict[str, list[float]] = {"first order with delay": [], "two capacities": []}
    for origin in origins:
        early = time < origin * log.experiment.duration
        for column in log.temperatures.T:
            first = _first_order(log, column, early)
            second = fit_two_capacities(duty, column, early, log.sample_time, first)
            for name, run in zip(squares, (first.predicted, second), strict=True):
                squares[name].append(float(np.nanmean((run - column)[~early] ** 2)))
    return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}


def _model_error(
    channels: Sequence[str], logs: Sequence[ScreenedLog], blocks: Blocks, rmse: float
) -> ModelError:
    """The growth of the error over the held-out blocks, beyond that of a matched reading."""
    rates = []
    for origin, errors in blocks.items():
        squares = np.nanmean(np.concatenate(errors) ** 2, axis=0)
        ahead = max(log.experiment.duration for log in logs) * (1 - origin)
        rates.append(np.maximum(squares - rmse**2, 0.0) / ahead**2)
    readings = np.concatenate([log.temperatures for log in logs])

    def named(numbers: Float[np.ndarray, " channels"]) -> dict[str, float]:
        return dict(zip(channels, map(float, numbers), strict=True))

    return ModelError(
        growth=named(np.sqrt(np.mean(rates, axis=0))),
        largest=named(MAX_SPREAD * np.nanstd(readings, axis=0)),
        lowest=named(np.nanmin(readings, axis=0)),
        highest=named(np.nanmax(readings, axis=0)),
        extrapolation=EXTRAPOLATION_ERROR,
    )


def _reading_noise(experiments: Sequence[Experiment], candidate: Candidate) -> float:
    """The standard deviation of a reading about a structure, of the channel where it is largest, K:
    the error of the averaged readings, and what averaging has removed."""
    noises = []
    for place, rmse in enumerate(candidate.rmse.values()):
        columns = [np.asarray(experiment.temperatures)[:, place] for experiment in experiments]
        steps = np.concatenate([np.diff(column[np.isfinite(column)]) for column in columns])
        noises.append(float(np.hypot(rmse, np.median(np.abs(steps)) / MEDIAN_OF_DIFFERENCES)))
    return max(noises)


def _text(family: Family, end: Screened, noise: float, notes: str | None) -> str:
    """The text of the rig file of a matched structure."""
    values: dict[str, list[float]] = {}
    for (name, _), value in end.values.items():
        values.setdefault(name, []).append(float(value))
    means = {name: float(np.mean(several)) for name, several in values.items()}
    comment = (
        f"Found from a log by `jaxtwin identify`: {in_words(end.problem.parts)}.\n"
        "The power of the first heater is not in a log: all heat capacities and resistances are\n"
        "relative to it. Priors are what is typical for the log's time constants and gains."
    )
    tables = family.tables(end.problem.parts, means)
    tables["sensors"] = {"noise": f"{noise:.2g} K"}
    if notes is not None:
        tables = {"description": notes, **tables}
    return rig_text(tables, comment)
