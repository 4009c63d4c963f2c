"""Many networks matched side by side, in one network that contains the parts of all.

A part that a network lacks has values with which it does nothing: all networks are draws of one
twin, and one program runs them. Derivatives are differences of two draws.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ..physics import Twin
from ..rig._load import rig_from_tables
from ..simulation import simulate_batch
from ._log import ScreenedLog
from ._network import Family

# Readings of a misfitting model are correlated for long: so many of each channel count.
EFFECTIVE_SAMPLES = 60
# Differences of logarithms, and of temperatures in K.
DIFFERENCE = 1e-3
MAX_ITERATIONS = 40
MIN_DECREASE = 1e-3


@final
@dataclass(frozen=True, eq=False)
class Problem:
    """A network and the readings that it is matched to.

    **Arguments:**

    - `parts`: of the network.
    - `known`: for each recording, which readings are matched.
    - `start`: parameter -> its value to start from, for each recording's own values with its
      number.
    """

    parts: frozenset[str]
    known: tuple[Bool[np.ndarray, "times channels"], ...]
    start: dict[tuple[str, int], float]


@final
@dataclass(frozen=True, eq=False)
class Screened:
    """The end of a match.

    **Arguments:**

    - `values`: (parameter, number of the recording or -1) -> value.
    - `cost`: minus the logarithm of the posterior probability, up to a constant.
    - `predicted`: of each recording, over all of it, degC.
    """

    problem: Problem
    values: dict[tuple[str, int], float]
    cost: float
    predicted: tuple[Float[np.ndarray, "times channels"], ...]


@final
class Screen:
    """Matches networks of a family to recordings.

    **Arguments:**

    - `family`: the networks.
    - `logs`: the recordings.
    - `floor`: the smallest error that counts, of each channel, K: that of the sensor.
    """

    def __init__(
        self, family: Family, logs: Sequence[ScreenedLog], floor: Float[np.ndarray, " channels"]
    ):
        self.family, self.logs, self.floor = family, tuple(logs), floor
        self.unknowns = {row.name: row for row in family.unknowns()}
        self.parts = frozenset(family.parts())
        self.twin = Twin(rig_from_tables(family.tables(self.parts), "the log"))

    def keys(self, parts: Set[str]) -> list[tuple[str, int]]:
        """The unknowns of a network, with the number of the recording for own values."""
        result = []
        for row in self.unknowns.values():
            if row.part and row.part not in parts:
                continue
            if row.name == "T_room" and self.logs[0].experiment.ambient is not None:
                continue
            result += (
                [(row.name, number) for number in range(len(self.logs))]
                if row.is_own
                else [(row.name, -1)]
            )
        return result

    def entries(self, end: Screened) -> dict[tuple[str, int], float]:
        """How far each value is from what was expected of it, in standard deviations."""
        return {key: self._vector(key, value) for key, value in end.values.items()}

    def _vector(self, key: tuple[str, int], value: float) -> float:
        row = self.unknowns[key[0]]
        return (
            np.log(value / row.prior) if row.is_positive else value - self._center(key)
        ) / row.spread

    def _value(self, key: tuple[str, int], entry: float) -> float:
        row = self.unknowns[key[0]]
        return (
            row.prior * np.exp(entry * row.spread)
            if row.is_positive
            else self._center(key) + entry * row.spread
        )

    def _center(self, key: tuple[str, int]) -> float:
        """What is expected of a temperature at the start: the first reading of the recording."""
        row = self.unknowns[key[0]]
        if row.name == "T_room":
            return row.prior
        place = int(row.name.rsplit("_", 1)[1]) - 1
        column = self.logs[key[1]].temperatures[:, place]
        return float(column[np.isfinite(column)][0])

    def simulate(
        self, draws: Sequence[dict[tuple[str, int], float]]
    ) -> list[Float[np.ndarray, "draws times channels"]]:
        """Runs many networks through all recordings, `(draws, times, channels)` for each."""
        results = []
        for number, log in enumerate(self.logs):
            columns: dict[str, np.ndarray] = {}
            for row in self.unknowns.values():
                index = number if row.is_own else -1
                if row.is_own and row.name != "T_room":
                    place = row.name.rsplit("_", 1)[1]
                    columns[row.name] = np.array(
                        [
                            draw.get(
                                (row.name, index), draw.get((f"T_start_{place}", index), row.prior)
                            )
                            for draw in draws
                        ]
                    )
                else:
                    absent = row.absent if row.part else row.prior
                    columns[row.name] = np.array(
                        [draw.get((row.name, index), absent) for draw in draws]
                    )
            results.append(simulate_batch(self.twin, log.experiment, columns))
        return results

    def match(self, problems: Sequence[Problem]) -> list[Screened]:
        """Matches all networks side by side by a Levenberg-Marquardt method."""
        keys = [self.keys(problem.parts) for problem in problems]
        vectors = [
            np.array(
                [self._vector(key, problem.start.get(key, self._value(key, 0.0))) for key in own]
            )
            for problem, own in zip(problems, keys, strict=True)
        ]
        damping = np.full(len(problems), 1e-2)
        active = list(range(len(problems)))
        best: list[Screened | None] = [None] * len(problems)
        jacobians: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for _ in range(MAX_ITERATIONS):
            draws, places = [], []
            for index in active:
                places.append(len(draws))
                for column in range(-1, len(keys[index])):
                    entry = vectors[index].copy()
                    if column >= 0:
                        entry[column] += DIFFERENCE / self._step(keys[index][column])
                    draws.append(
                        {
                            key: self._value(key, value)
                            for key, value in zip(keys[index], entry, strict=True)
                        }
                    )
            runs = self.simulate(draws)
            following = []
            for index, place in zip(active, places, strict=True):
                count = len(keys[index])
                parts = [run[place : place + count + 1] for run in runs]
                problem, vector = problems[index], vectors[index]
                cost, residuals, weights = self._cost(problem, [part[0] for part in parts], vector)
                before = best[index]
                if before is None or cost < before.cost - MIN_DECREASE * (
                    before is not None and damping[index] > 1e3
                ):
                    gain = np.inf if before is None else before.cost - cost
                    best[index] = Screened(
                        problem,
                        {
                            key: self._value(key, value)
                            for key, value in zip(keys[index], vector, strict=True)
                        },
                        cost,
                        tuple(part[0] for part in parts),
                    )
                    slopes = np.concatenate(
                        [
                            (part[1:] - part[0])[:, known].T
                            for part, known in zip(parts, problem.known, strict=True)
                        ]
                    )
                    steps = np.array([DIFFERENCE / self._step(key) for key in keys[index]])
                    jacobian = slopes / steps * weights[:, None]
                    ok = np.isfinite(jacobian).all(1) & np.isfinite(residuals)
                    jacobians[index] = jacobian[ok], residuals[ok] * weights[ok]
                    damping[index] = max(damping[index] / 5, 1e-6)
                    if gain < MIN_DECREASE:
                        continue
                    base = vector
                else:
                    damping[index] *= 8
                    if damping[index] > 1e4:
                        continue
                    base = np.array([self._vector(key, before.values[key]) for key in keys[index]])
                jacobian, scaled = jacobians[index]
                normal = jacobian.T @ jacobian + np.eye(count)
                step = np.linalg.solve(
                    normal + damping[index] * np.diag(np.diag(normal)),
                    -(jacobian.T @ scaled + base),
                )
                step *= min(1.0, 1.5 / max(float(np.abs(step).max()), 1e-12))
                vectors[index] = np.clip(base + step, -5, 5)
                following.append(index)
            active = following
            if not active:
                break
        return [end for end in best if end is not None]

    def _step(self, key: tuple[str, int]) -> float:
        row = self.unknowns[key[0]]
        return row.spread if row.is_positive else row.spread / 10

    def _cost(
        self, problem: Problem, runs: Sequence[np.ndarray], vector: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """The cost with the variance of each channel's errors at its most likely value, the
        residuals and their weights."""
        residuals, weights, cost = [], [], 0.5 * float(vector @ vector)
        squares, numbers = np.zeros(len(self.floor)), np.zeros(len(self.floor))
        for run, known, log in zip(runs, problem.known, self.logs, strict=True):
            errors = run - log.temperatures
            squares += (np.where(known, errors, 0.0) ** 2).sum(axis=0)
            numbers += known.sum(0)
            residuals.append(errors[known])
        variance = squares / np.maximum(numbers, 1) + self.floor**2
        for known in problem.known:
            per_channel = np.sqrt(EFFECTIVE_SAMPLES / np.maximum(numbers, 1) / variance)
            weights.append(np.broadcast_to(per_channel, known.shape)[known])
        if not np.isfinite(variance).all():
            return np.inf, np.concatenate(residuals), np.concatenate(weights)
        cost += 0.5 * EFFECTIVE_SAMPLES * float(np.log(variance)[numbers > 0].sum())
        return cost, np.concatenate(residuals), np.concatenate(weights)
