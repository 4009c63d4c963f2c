"""Many networks matched side by side, in one network that contains the parts of all.

A part that a network lacks has values with which it does nothing: all networks are draws of one
twin, and one program runs them, so that a new structure costs no compilation. Derivatives are
differences of two draws.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ..io import Experiment
from ..physics import Twin
from ..rig import rig_from_tables
from ..simulation import simulate_batch
from ._log import ScreenedLog, screened_log
from ._network import ROOM, Family

# The number of readings of each channel that count as independent, because the errors of a
# structure are correlated for long.
EFFECTIVE_SAMPLES = 60

# The step of a difference quotient, of a logarithm; ten times as large, in K, of a temperature.
DIFFERENCE = 1e-3

MAX_ITERATIONS = 40

# An iteration that lowers the cost by less is the last.
MIN_DECREASE = 1e-3

# The damping of the first step, its factors after a good and a bad step, and the one that ends a
# search.
DAMPING, GOOD_STEP, BAD_STEP, MAX_DAMPING = 1e-2, 0.2, 8.0, 1e4

# The longest step, and the farthest end from what was expected, in standard deviations of a prior.
MAX_STEP, MAX_DISTANCE = 1.5, 5.0

# The width of the weights of rivals in their cost: that of a posterior is 1, which trusts the
# network of the highest probability too much.
WEIGHT_WIDTH = 10.0

# A rival of less than this part of the largest weight is not chosen.
MIN_WEIGHT = 0.02

# A parameter, and the number of the recording whose own value it is, or SHARED.
Key = tuple[str, int]
SHARED = -1


@final
@dataclass(frozen=True, eq=False)
class Problem:
    """A network and the readings that it is matched to.

    **Arguments:**

    - `parts`: of the network.
    - `known`: for each recording, which readings are matched.
    - `start`: values to start from; others start at what is expected.
    """

    parts: frozenset[str]
    known: tuple[Bool[np.ndarray, "times channels"], ...]
    start: dict[Key, float]


@final
@dataclass(frozen=True, eq=False)
class Screened:
    """The end of a search.

    **Arguments:**

    - `values`: all values of the network.
    - `cost`: minus the logarithm of the posterior probability, up to a constant.
    - `predicted`: the temperatures of each recording, over all of it, degC.
    """

    problem: Problem
    values: dict[Key, float]
    cost: float
    predicted: tuple[Float[np.ndarray, "times channels"], ...]


@final
@dataclass(eq=False)
class _NetworkSearch:
    """Where the search for one problem is.

    - `vector`: the entries to try next, in standard deviations of the priors.
    - `base`, `jacobian`, `residuals`: of the best entries so far.
    """

    problem: Problem
    keys: list[Key]
    vector: Float[np.ndarray, " entries"]
    damping: float = DAMPING
    best: Screened | None = None
    base: np.ndarray = field(default_factory=lambda: np.zeros(0))
    jacobian: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    residuals: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def next_vector(self) -> Float[np.ndarray, " entries"]:
        """The entries after a Levenberg-Marquardt step from the best ones."""
        normal = self.jacobian.T @ self.jacobian + np.eye(len(self.base))
        gradient = self.jacobian.T @ self.residuals + self.base
        step = np.linalg.solve(normal + self.damping * np.diag(np.diag(normal)), -gradient)
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max()), 1e-12))
        return np.clip(self.base + step, -MAX_DISTANCE, MAX_DISTANCE)


@final
class NetworkScreening:
    """Matches networks of a family to recordings.

    **Arguments:**

    - `family`: the networks.
    - `logs`: the recordings.
    - `floor`: the smallest error of each channel that counts, K.
    - `parts`: which the networks may have.
    """

    def __init__(
        self,
        family: Family,
        logs: Sequence[ScreenedLog],
        floor: Float[np.ndarray, " channels"],
        parts: Set[str],
    ):
        self.family, self.logs, self.floor = family, tuple(logs), floor
        self.unknowns = {row.name: row for row in family.unknowns(parts)}
        self.twin = Twin(rig_from_tables(family.tables(parts), "the log"))

    def keys(self, parts: Set[str]) -> list[Key]:
        """The unknowns of a network."""
        result: list[Key] = []
        is_recorded = self.logs[0].experiment.ambient is not None
        for row in self.family.unknowns(parts):
            if row.name == ROOM and is_recorded:
                continue
            numbers = range(len(self.logs)) if row.is_own else (SHARED,)
            result += [(row.name, number) for number in numbers]
        return result

    def entries(self, end: Screened) -> dict[Key, float]:
        """How far each value is from what was expected of it, in standard deviations."""
        return {key: self._entry(key, value) for key, value in end.values.items()}

    def _entry(self, key: Key, value: float) -> float:
        row = self.unknowns[key[0]]
        if row.is_positive:
            return float(np.log(value / row.prior)) / row.spread
        return (value - self._expected_temperature(key)) / row.spread

    def _value(self, key: Key, entry: float) -> float:
        row = self.unknowns[key[0]]
        if row.is_positive:
            return row.prior * float(np.exp(entry * row.spread))
        return self._expected_temperature(key) + entry * row.spread

    def _expected_temperature(self, key: Key) -> float:
        """What is expected of a temperature: at the start, the first reading of the recording."""
        name, number = key
        if not self.unknowns[name].is_start:
            return self.unknowns[name].prior
        return self.logs[number].first_reading(_place(name))

    def run(
        self, log: ScreenedLog, number: int, networks: Sequence[dict[Key, float]]
    ) -> Float[np.ndarray, "networks times channels"]:
        """Runs many networks through a recording, with the own values of a recording's number."""
        draws = {}
        for row in self.unknowns.values():
            key = (row.name, number if row.is_own else SHARED)
            # A part that is absent begins where the place does, whose temperature is always there.
            at_start = (f"T_start_{_place(row.name) + 1}", number) if row.is_start else key
            draws[row.name] = np.array(
                [values.get(key, values.get(at_start, row.absent)) for values in networks]
            )
        return simulate_batch(self.twin, log.experiment, draws)

    def match(self, problems: Sequence[Problem]) -> list[Screened]:
        """Matches all networks side by side by a Levenberg-Marquardt method."""
        searches = []
        for problem in problems:
            keys = self.keys(problem.parts)
            vector = [
                self._entry(key, problem.start[key]) if key in problem.start else 0.0
                for key in keys
            ]
            searches.append(_NetworkSearch(problem, keys, np.array(vector)))
        active = searches
        for _ in range(MAX_ITERATIONS):
            if not active:
                break
            networks = [values for search in active for values in self._neighbours(search)]
            runs = [self.run(log, number, networks) for number, log in enumerate(self.logs)]
            edges = np.cumsum([0, *(1 + len(search.keys) for search in active)])
            active = [
                search
                for search, start, stop in zip(active, edges[:-1], edges[1:], strict=True)
                if self._advance(search, [run[start:stop] for run in runs])
            ]
        return [search.best for search in searches if search.best is not None]

    def _neighbours(self, search: _NetworkSearch) -> list[dict[Key, float]]:
        """The values to try, and those with one entry a little larger, for derivatives."""
        vectors = [search.vector]
        for column, key in enumerate(search.keys):
            vectors.append(search.vector.copy())
            vectors[-1][column] += self._difference(key)
        return [
            {key: self._value(key, entry) for key, entry in zip(search.keys, vector, strict=True)}
            for vector in vectors
        ]

    def _difference(self, key: Key) -> float:
        row = self.unknowns[key[0]]
        return DIFFERENCE / row.spread * (1 if row.is_positive else 10)

    def _advance(
        self, search: _NetworkSearch, runs: Sequence[Float[np.ndarray, "neighbours times channels"]]
    ) -> bool:
        """Accepts or rejects the step that was tried; returns whether the search goes on."""
        problem, before = search.problem, search.best
        cost, residuals, weights = self._cost(problem, [run[0] for run in runs], search.vector)
        if before is None or cost < before.cost:
            entries = zip(search.keys, search.vector, strict=True)
            values = {key: self._value(key, entry) for key, entry in entries}
            search.best = Screened(problem, values, cost, tuple(run[0] for run in runs))
            search.base = search.vector
            changes = [
                (run[1:] - run[0])[:, known].T
                for run, known in zip(runs, problem.known, strict=True)
            ]
            steps = np.array([self._difference(key) for key in search.keys])
            jacobian = np.concatenate(changes) / steps * weights[:, None]
            is_finite = np.isfinite(jacobian).all(axis=1) & np.isfinite(residuals)
            search.jacobian = jacobian[is_finite]
            search.residuals = (residuals * weights)[is_finite]
            search.damping *= GOOD_STEP
            if before is not None and before.cost - cost < MIN_DECREASE:
                return False
        else:
            search.damping *= BAD_STEP
            if search.damping > MAX_DAMPING:
                return False
        search.vector = search.next_vector()
        return True

    def _cost(
        self,
        problem: Problem,
        runs: Sequence[Float[np.ndarray, "times channels"]],
        vector: Float[np.ndarray, " entries"],
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """The cost with the most likely variance of each channel's errors, the residuals and their
        weights."""
        pairs = list(zip(runs, problem.known, self.logs, strict=True))
        errors = [run - log.temperatures for run, _, log in pairs]
        squares = sum(
            (np.where(known, error, 0.0) ** 2).sum(axis=0)
            for error, known in zip(errors, problem.known, strict=True)
        )
        numbers = np.maximum(sum(known.sum(axis=0) for known in problem.known), 1)
        variance = squares / numbers + self.floor**2
        per_channel = np.sqrt(EFFECTIVE_SAMPLES / numbers / variance)
        residuals = np.concatenate(
            [error[known] for error, known in zip(errors, problem.known, strict=True)]
        )
        weights = np.concatenate(
            [np.broadcast_to(per_channel, known.shape)[known] for known in problem.known]
        )
        if not np.isfinite(variance).all():
            return np.inf, residuals, weights
        cost = 0.5 * float(vector @ vector) + 0.5 * EFFECTIVE_SAMPLES * float(
            np.log(variance).sum()
        )
        return cost, residuals, weights


def _place(name: str) -> int:
    """The place of a parameter such as `T_wall_2`, counted from 0."""
    return int(name.rsplit("_", 1)[1]) - 1


@final
@dataclass(frozen=True, eq=False)
class Rivals:
    """The most probable networks of a log, which disagree where it says little.

    **Arguments:**

    - `screen`: with which they were matched.
    - `ends`: the networks.
    - `costs`: minus the logarithms of their probabilities, up to a constant.
    """

    screen: NetworkScreening
    ends: list[Screened]
    costs: Float[np.ndarray, " networks"]

    @cached_property
    def weights(self) -> Float[np.ndarray, " networks"]:
        """Their probabilities, tempered: the errors of wrong networks are not independent."""
        weights = np.exp(-(self.costs - self.costs.min()) / WEIGHT_WIDTH)
        return weights / weights.sum()

    @property
    def is_probable(self) -> Bool[np.ndarray, " networks"]:
        """Which networks are not improbable beside the most probable one."""
        return self.weights > MIN_WEIGHT * self.weights.max()

    @cached_property
    def central(self) -> int:
        """The number of the probable network whose prediction is nearest to the mean of all.

        Of networks that a log does not tell apart, the most probable one may be the one that
        predicts something of its own. This one has the least expected squared error over what
        follows: the inputs of the first recording, once more.
        """
        log = self.screen.logs[0]
        runs = self._runs(_repeated(log), 0)[:, len(log.experiment.time) :]
        mean = np.tensordot(self.weights, runs, 1)
        scaled = (runs - mean) / np.nanstd(log.temperatures, axis=0)
        distance = np.mean(scaled**2, axis=(1, 2))
        return int(np.argmin(np.where(self.is_probable, distance, np.inf)))

    def disagreement(
        self, experiment: Experiment, number: int
    ) -> Float[np.ndarray, "times channels"]:
        """The standard deviation of the rivals' predictions about that of the central one, K.

        **Arguments:**

        - `experiment`: the inputs.
        - `number`: of the recording whose own values are taken.
        """
        log = screened_log(experiment)
        runs = self._runs(log, number)
        squares = np.tensordot(self.weights, (runs - runs[self.central]) ** 2, 1)
        time = experiment.time - experiment.time[0]
        return np.stack(
            [np.interp(time, log.experiment.time, column) for column in np.sqrt(squares).T], axis=1
        )

    def separation(self, experiment: Experiment, highest: Float[np.ndarray, " channels"]) -> float:
        """How far the networks disagree over an experiment: the root mean square of their weighted
        standard deviation over channels and times, K; minus infinity if a channel may become hotter
        than its highest temperature.

        **Arguments:**

        - `experiment`: the inputs, from the start of the first recording.
        - `highest`: of each channel, degC.
        """
        runs = self._runs(screened_log(experiment), 0)
        if not np.all(runs[self.is_probable] <= highest):
            return -np.inf
        deviations = runs - np.tensordot(self.weights, runs, 1)
        return float(np.sqrt(np.tensordot(self.weights, deviations**2, 1).mean()))

    def _runs(self, log: ScreenedLog, number: int) -> Float[np.ndarray, "networks times channels"]:
        return self.screen.run(log, number, [end.values for end in self.ends])


def _repeated(log: ScreenedLog) -> ScreenedLog:
    """A recording whose inputs begin anew where it ends."""
    experiment, count = log.experiment, len(log.experiment.time)
    time = log.sample_time * np.arange(2 * count)
    room = experiment.ambient
    return ScreenedLog(
        Experiment(
            time,
            np.tile(np.asarray(experiment.duty), (2, 1)),
            channels=experiment.channels,
            cells=experiment.cells,
            ambient=None if room is None else np.tile(np.asarray(room), 2),
            name=experiment.name,
        ),
        log.sample_time,
    )
