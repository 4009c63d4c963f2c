"""The health of a rig over sessions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from .._display import aligned, picture
from .._name_suggestions import unknown_name
from .._number_text import short_number
from .._result import AbstractResult, dataset, table
from ..errors import ParameterError
from ._trend import Trend

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

TABLE_HEAD = ("parameter", "at the end", "unit", "change", "95 %", "p", "spread", "last", "limit")


@final
@dataclass(frozen=True, eq=False)
class ParameterHealth:
    """A parameter over sessions.

    **Arguments:**

    - `name`, `unit`: as in the rig's table.
    - `is_logarithmic`: whether `trend` and `errors` are those of the logarithm, so that changes and
      spreads are relative.
    - `values`: what each session says of it, without its prior, in `unit`; NaN for a session that
      does not determine it. `errors`: the standard errors.
    - `trend`: the trend of the sessions.
    - `span`: the first and the last time of all sessions.
    - `p_value`: the probability that at least one of all parameters without a trend has one as
      clear as this (the correction of Holm, Scand. J. Statist. 6 (1979) 65-70).
    - `last_distance`: how far the last session is from what the trend of those before lets expect,
      in standard errors. `last_p_value`: the probability of such a distance if nothing happened.
      NaN if fewer than three sessions before determine it.
    - `limit`: the limit that it should not pass, or None.
    """

    name: str
    unit: str
    is_logarithmic: bool
    values: Float[np.ndarray, " sessions"]
    errors: Float[np.ndarray, " sessions"]
    trend: Trend
    span: tuple[float, float]
    p_value: float
    last_distance: float
    last_p_value: float
    limit: float | None

    @property
    def value(self) -> float:
        """The trend at the last session, in `unit`."""
        return float(self._value(self.trend.line(self.span[1])))

    @property
    def change(self) -> float:
        """How much the trend has changed from the first session to the last: relative, or in
        `unit` if the parameter is not matched by its logarithm."""
        return self._change(0.0)

    @property
    def change_interval(self) -> tuple[float, float]:
        """The 95 % interval of `change`."""
        return self._change(-self.trend.reach), self._change(self.trend.reach)

    @property
    def is_upward(self) -> bool:
        """Whether the limit is above the trend at the first session, so that values above it are
        beyond it."""
        if self.limit is None:
            return False
        return self._entry(self.limit) >= float(self.trend.line(self.span[0]))

    def at(
        self, times: ArrayLike | float | int
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """The trend at some times, and the ends of its 95 % interval, in `unit`."""
        line, error = self.trend.line(times), self.trend.line_error(times)
        return self._around(line, error)

    def sessions_at(
        self, times: ArrayLike | float | int
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """The same for the value of a single session: the interval has the spread between sessions
        too, but not the session's own error."""
        line, error = self.trend.line(times), self.trend.session_error(times)
        return self._around(line, error)

    def interval_of_sessions(
        self,
    ) -> tuple[Float[np.ndarray, " sessions"], Float[np.ndarray, " sessions"]]:
        """The 95 % intervals of what each session says, in `unit`, by its own error."""
        from scipy.special import ndtri

        entries = np.log(self.values) if self.is_logarithmic else self.values
        reach = float(ndtri(0.975)) * self.errors
        return self._value(entries - reach), self._value(entries + reach)

    def probability_of_passing(self, within: float | int) -> float:
        """The probability that the trend is beyond the limit at the last session, or passes it
        within a time after it; NaN without a limit.

        It is that of a trend which goes on as a straight line, and says nothing of a sudden change.

        **Arguments:**

        - `within`: the time, in the unit of the times of the sessions.
        """
        if self.limit is None:
            return math.nan
        return self.trend.probability_of_passing(
            self._entry(self.limit), self.span[1], within, is_upward=self.is_upward
        )

    def _change(self, errors: float) -> float:
        """`change` with a slope that is `errors` standard errors higher."""
        slope = self.trend.slope + errors * self.trend.slope_error
        difference = slope * (self.span[1] - self.span[0])
        return float(np.expm1(difference)) if self.is_logarithmic else difference

    def _around(
        self, line: Float[np.ndarray, "..."], error: Float[np.ndarray, "..."]
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        reach = self.trend.reach * error
        return self._value(line), self._value(line - reach), self._value(line + reach)

    def _entry(self, value: float) -> float:
        return math.log(value) if self.is_logarithmic else float(value)

    def _value(self, entries: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        with np.errstate(over="ignore"):
            return np.asarray(np.exp(entries) if self.is_logarithmic else entries)


@final
@dataclass(frozen=True, repr=False, eq=False)
class Health(AbstractResult):
    """The health of a rig over sessions.

    **Arguments:**

    - `rig`: the name of the rig.
    - `sessions`: their names. `times`: when they were, in `time_unit`: `day`, from the first
      session on, or `session`, their numbers from 1 on.
    - `converged`: whether the match of each converged.
    - `parameters`: name -> what the sessions say of it; what changed most is first.
    - `undetermined`: the free parameters that fewer than three sessions determine.
    - `within`: how far ahead limits are looked at, in `time_unit`.
    """

    rig: str
    sessions: tuple[str, ...]
    times: Float[np.ndarray, " sessions"]
    time_unit: str
    converged: tuple[bool, ...]
    parameters: Mapping[str, ParameterHealth]
    undetermined: tuple[str, ...]
    within: float

    def __getitem__(self, name: str) -> ParameterHealth:
        """A parameter by its name.

        **Raises:** `ParameterError` if the sessions do not determine one of this name.
        """
        if name not in self.parameters:
            raise ParameterError(f"health: {unknown_name('parameter', name, self.parameters)}")
        return self.parameters[name]

    @property
    def probabilities(self) -> dict[str, float]:
        """Parameter with a limit -> the probability that its trend passes it within `within`."""
        return {
            name: row.probability_of_passing(self.within)
            for name, row in self.parameters.items()
            if row.limit is not None
        }

    def summary(self) -> str:
        """What changed most, a table of the parameters, and a sentence for each limit."""
        count = len(self.sessions)
        length = _time_text(self.times[-1] - self.times[0], self.time_unit)
        lines = [f"{self.rig}: {count} sessions over {length}"]
        failed = [
            name
            for name, has_converged in zip(self.sessions, self.converged, strict=True)
            if not has_converged
        ]
        lines += [f"did not converge: {', '.join(failed)}"] * bool(failed)
        most = next(iter(self.parameters.values()))
        clear = "a clear trend" if most.p_value < 0.05 else "no clear trend"
        lines.append(f"what changed most: {most.name}, {_changed(most)} ({clear})")
        lines += [
            f"{self.sessions[-1]} is unlike those before: {row.name} is {row.last_distance:+.1f} "
            "standard errors off"
            for row in self.parameters.values()
            if row.last_p_value * len(self.parameters) < 0.05
        ]
        lines.append(aligned([TABLE_HEAD, *self._rows()]))
        lines += [self._passing(self.parameters[name], limit) for name, limit in self._limits()]
        if self.undetermined:
            lines.append(f"not determined by three sessions: {', '.join(self.undetermined)}")
        return "\n".join(lines)

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "sessions": self.sessions,
            "times": self.times,
            "time_unit": self.time_unit,
            "converged": self.converged,
            "within": self.within,
            "undetermined": self.undetermined,
            "parameters": {
                name: {"values": row.values, "errors": row.errors, **self._numbers(row)}
                for name, row in self.parameters.items()
            },
        }

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each parameter, its name as index: value at the last session,
        change with the ends of its interval, slope with its error, p_value, spread between sessions
        with the ends of its interval, distance of the last session from those before with its
        p-value, limit, and the probability of passing it."""
        rows = self.parameters.values()
        return table([{"name": row.name, **self._numbers(row)} for row in rows], "name")

    def to_xarray(self) -> "xarray.Dataset":
        """The numbers as a dataset: what each session says, session_value and session_error
        (session, parameter), and the numeric columns of `to_dataframe` (parameter)."""
        columns, rows = self.to_dataframe(), self.parameters.values()
        return dataset(
            {
                "session_value": ("session parameter", np.transpose([row.values for row in rows])),
                "session_error": ("session parameter", np.transpose([row.errors for row in rows])),
                **{str(name): ("parameter", values) for name, values in columns.items()},
                "time": ("session", self.times, self.time_unit),
            },
            {},
            session=self.sessions,
            parameter=columns.index,
        ).set_coords(["unit", "time"])

    def plot(self) -> "Figure":
        """Plots the parameters over the sessions (`jaxtwin.plots.plot_health`)."""
        return picture("plot_health", self)

    def _numbers(self, row: ParameterHealth) -> dict[str, Any]:
        lower, upper = row.change_interval
        return {
            "unit": row.unit,
            "is_logarithmic": row.is_logarithmic,
            "value": row.value,
            "change": row.change,
            "change_lower": lower,
            "change_upper": upper,
            "slope": row.trend.slope,
            "slope_error": row.trend.slope_error,
            "p_value": row.p_value,
            "spread": row.trend.spread,
            "spread_lower": row.trend.spread_interval[0],
            "spread_upper": row.trend.spread_interval[1],
            "last_distance": row.last_distance,
            "last_p_value": row.last_p_value,
            "limit": math.nan if row.limit is None else row.limit,
            "probability": row.probability_of_passing(self.within),
        }

    def _limits(self) -> list[tuple[str, float]]:
        return sorted(self.probabilities.items(), key=lambda pair: -pair[1])

    def _passing(self, row: ParameterHealth, probability: float) -> str:
        limit = f"{short_number(row.limit or 0.0)} {row.unit}".rstrip()
        time = _time_text(self.within, self.time_unit)
        return f"{row.name} passes {limit} within {time} with a probability of {probability:.2g}"

    def _rows(self) -> list[tuple[str, ...]]:
        return [
            (
                row.name,
                short_number(row.value, 3),
                row.unit or "1",
                _amount(row, row.change),
                f"{_amount(row, row.change_interval[0])} to {_amount(row, row.change_interval[1])}",
                f"{row.p_value:.2g}",
                _amount(row, row.trend.spread).lstrip("+"),
                "-" if math.isnan(row.last_distance) else f"{row.last_distance:+.1f}",
                "" if row.limit is None else short_number(row.limit),
            )
            for row in self.parameters.values()
        ]

    def __repr__(self) -> str:
        return (
            f"<Health of {self.rig}: {len(self.parameters)} parameters over "
            f"{len(self.sessions)} sessions>"
        )

    def _overview(self) -> "pandas.DataFrame":
        return table(self._rows(), columns=TABLE_HEAD)


def _amount(row: ParameterHealth, change: float) -> str:
    """A change or a spread, in per cent if it is relative."""
    return f"{100 * change:+.2g} %" if row.is_logarithmic else f"{change:+.2g}"


def _changed(row: ParameterHealth) -> str:
    unit = "" if row.is_logarithmic else f" {row.unit}"
    lower, upper = (_amount(row, end) for end in row.change_interval)
    return f"{_amount(row, row.change)}{unit}, 95 % {lower} to {upper}"


def _time_text(time: float, unit: str) -> str:
    return f"{short_number(time, 3)} {unit}{'' if time == 1 else 's'}"
