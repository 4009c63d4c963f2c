"""The temperatures of many draws, which know their labels."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..errors import SimulationError

if TYPE_CHECKING:
    import xarray


class BatchLabels(NamedTuple):
    """What the temperatures of a batch belong to.

    - `draws`: parameter -> its draws. `units`: parameter -> its unit.
    - `time`: the times of the samples, s. `channels`: the names of the channels.
    - `rig`, `experiment`: their names.
    """

    draws: Mapping[str, Float[np.ndarray, " draws"]]
    units: Mapping[str, str]
    time: Float[np.ndarray, " times"]
    channels: tuple[str, ...]
    rig: str
    experiment: str


@final
class BatchTemperatures(np.ndarray):
    """Temperatures `(draws, times, channels)`, degC: an array with `to_xarray`. What is computed
    from it, and a part of it, is an array without labels."""

    labels: BatchLabels | None
    """What they belong to; None for a part or a result."""

    @classmethod
    def labelled(
        cls, temperatures: Float[np.ndarray, "draws times channels"], labels: BatchLabels
    ) -> "BatchTemperatures":
        """The same numbers, not copied, with labels."""
        result = temperatures.view(cls)
        result.labels = labels
        return result

    def __array_finalize__(self, obj: Any) -> None:
        self.labels = None

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: temperature (draw, time, channel), with the draws of each
        parameter as a coordinate (draw).

        **Raises:** `SimulationError` for a part of a batch: choose it in the dataset.
        """
        import xarray

        if self.labels is None:
            raise SimulationError(
                "to_xarray: expected the whole result of simulate_batch, got a part of it or what "
                "was computed from it; take the dataset first and choose there"
            )
        draws, units, time, channels, rig, experiment = self.labels
        parameters = {
            name: ("draw", np.asarray(values), {"units": units[name]})
            for name, values in draws.items()
        }
        return xarray.Dataset(
            {"temperature": (("draw", "time", "channel"), np.asarray(self), {"units": "degC"})},
            coords={
                "draw": np.arange(len(self)),
                "time": ("time", time, {"units": "s"}),
                "channel": list(channels),
                **parameters,
            },
            attrs={"rig": rig, "experiment": experiment},
        )
