"""The result of a sensitivity analysis."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from jaxtyping import Bool, Float

from .._arguments import true_or_false
from .._display import picture
from .._name_suggestions import did_you_mean
from .._result import AbstractResult, dataset
from ..errors import ParameterError
from ._sampling import limits

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

# The name of the mean cost of all channels, which is in the result as a further channel.
MEAN = "mean"


@final
@dataclass(frozen=True, repr=False)
class Sensitivity(AbstractResult):
    """The correlations of parameters with costs over random draws.

    **Arguments:**

    - `rig`: name of the rig.
    - `names`, `values`: the parameters that were drawn, and the values around which they were
      drawn.
    - `channels`: the recorded channels and "mean".
    - `correlation`: Pearson's correlation, `(channels, parameters)`; `interval`: its 95 %
      confidence interval.
    - `rank_correlation`: Spearman's correlation, that of the ranks; `rank_interval`: its 95 %
      confidence interval.
    - `samples`: the parameters of each draw, `(draws, parameters)`, in the parameters' units.
    - `cost`: mean squared error of each channel and their mean, `(draws, channels)`, K^2.
    - `failed`: whether a draw gave no finite temperatures; it is then left out of the correlations.
    - `spread`, `seed`: relative standard deviation and seed of the draws.
    - `wall_time`: the computing time, s, including compilation.
    """

    rig: str
    names: tuple[str, ...]
    values: Float[np.ndarray, " parameters"]
    channels: tuple[str, ...]
    correlation: Float[np.ndarray, "channels parameters"]
    interval: Float[np.ndarray, "channels parameters 2"]
    rank_correlation: Float[np.ndarray, "channels parameters"]
    rank_interval: Float[np.ndarray, "channels parameters 2"]
    samples: Float[np.ndarray, "draws parameters"]
    cost: Float[np.ndarray, "draws channels"]
    failed: Bool[np.ndarray, " draws"]
    spread: float
    seed: int
    wall_time: float

    def ranking(self, channel: str = MEAN) -> tuple[str, ...]:
        """Returns the parameters from the strongest to the weakest correlation.

        **Raises:** `ParameterError` if there is no such channel.
        """
        strength = np.abs(self.correlation[self._row(channel)])
        return tuple(self.names[column] for column in np.argsort(-strength, kind="stable"))

    def tornado(self, channel: str = MEAN, ax: "Axes | None" = None) -> "Axes":
        """Plots the correlations as bars with their intervals, the strongest on top: Fig. 16 of the
        paper.

        **Raises:** `ParameterError` if there is no such channel.
        """
        self._row(channel)
        return picture("plot_tornado", self, channel, ax=ax)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Plots the correlations of all channels and parameters as a matrix. Correlations whose 95
        % interval does not contain 0 are written as numbers."""
        return picture("plot_sensitivity_matrix", self, ax=ax)

    def significant(self, channel: str = MEAN, *, ranks: bool = False) -> dict[str, Literal[1, -1]]:
        """The parameters with a significant correlation: their 95 % interval does not contain 0.

        **Arguments:**

        - `channel`: one of `channels`.
        - `ranks`: whether to judge by the rank correlation.

        **Returns:** parameter name -> sign of its correlation.

        **Raises:** `ParameterError` if there is no such channel, or for an invalid argument.
        """
        true_or_false("significant: ranks", ranks, ParameterError)
        low, high = (self.rank_interval if ranks else self.interval)[self._row(channel)].T
        return {
            name: 1 if below > 0 else -1
            for name, below, above in zip(self.names, low, high, strict=True)
            if below > 0 or above < 0
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Returns all numbers as a labelled dataset with the dimensions draw, channel, parameter
        and bound."""
        matrix, intervals = "channel parameter", "channel parameter bound"
        return dataset(
            {
                "correlation": (matrix, self.correlation, "1"),
                "interval": (intervals, self.interval, "1"),
                "rank_correlation": (matrix, self.rank_correlation, "1"),
                "rank_interval": (intervals, self.rank_interval, "1"),
                "sample": ("draw parameter", self.samples),
                "cost": ("draw channel", self.cost, "K^2"),
                "failed": ("draw", self.failed),
                "value": ("parameter", self.values),
            },
            {"rig": self.rig, "spread": self.spread, "seed": self.seed},
            channel=self.channels,
            parameter=self.names,
            bound=["lower", "upper"],
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns the correlations as a table with a row for each channel and parameter (its
        index), and the columns correlation, lower, upper, rank_correlation, rank_lower and
        rank_upper."""
        columns = {
            "correlation": self.correlation,
            "lower": self.interval[..., 0],
            "upper": self.interval[..., 1],
            "rank_correlation": self.rank_correlation,
            "rank_lower": self.rank_interval[..., 0],
            "rank_upper": self.rank_interval[..., 1],
        }
        matrices = {name: ("channel parameter", values) for name, values in columns.items()}
        return dataset(matrices, {}, channel=self.channels, parameter=self.names).to_dataframe()

    def to_salib(self) -> dict[str, Any]:
        """Returns the problem in SALib's form, for its samplers and analysers.

        Distributions are those of the draws, normal and truncated at 0: SALib's `truncnorm`, whose
        bounds are lower and upper limit, mean and standard deviation.
        """
        return {
            "num_vars": len(self.names),
            "names": list(self.names),
            "bounds": [
                [*limits(value, self.spread), value, self.spread * abs(value)]
                for value in self.values.tolist()
            ],
            "dists": ["truncnorm"] * len(self.names),
        }

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "draws": len(self.samples),
            "failed": int(self.failed.sum()),
            "spread": self.spread,
            "seed": self.seed,
            "wall_time_s": self.wall_time,
            "correlation": self._by_name(self.correlation),
            "interval": self._by_name(self.interval),
            "rank_correlation": self._by_name(self.rank_correlation),
            "rank_interval": self._by_name(self.rank_interval),
            "ranking": list(self.ranking()),
        }

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe().loc[MEAN].loc[list(self.ranking())]
        return rows.rename_axis("parameter, for the mean cost")

    def _by_name(self, numbers: Float[np.ndarray, "channels parameters *bounds"]) -> dict[str, Any]:
        return {
            channel: dict(zip(self.names, row.tolist(), strict=True))
            for channel, row in zip(self.channels, numbers, strict=True)
        }

    def _row(self, channel: str) -> int:
        if channel not in self.channels:
            raise ParameterError(
                f"channel: expected one of {', '.join(self.channels)}, got {channel!r}"
                f"{did_you_mean([channel], self.channels)}"
            )
        return self.channels.index(channel)

    def __repr__(self) -> str:
        failed = int(self.failed.sum())
        lost = f" ({failed} failed, left out)" if failed else ""
        strongest = ", ".join(self.ranking()[:3])
        draws = f"{len(self.samples)} draws{lost}"
        return f"<Sensitivity of {self.rig}: {draws}, strongest {strongest}>"
