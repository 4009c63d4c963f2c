"""What an observer says of the rig at each time: temperatures that nothing measures, the room,
heats and errors."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._name_suggestions import did_you_mean
from .._result import dataset
from .._statistics import QUANTILE_975
from ..errors import ObserverError
from ._augmented_model import AugmentedModel
from ._uncertain_values import UncertainDirections

if TYPE_CHECKING:
    import xarray


class Moment(NamedTuple):
    """The mean and the standard deviation of a vector."""

    mean: Float[Array | np.ndarray, "*size"]
    spread: Float[Array | np.ndarray, "*size"]


class Moments(NamedTuple):
    """What a distribution of the state says of each part.

    - `nodes`: the temperatures of all nodes, degC.
    - `channels`: what the channels see, without errors of their readings, degC.
    - `room`: degC. `heats`: the disturbance heats, W.
    - `common`: the error that the readings of all channels share, K.
    - `values`: the changes of the uncertain values, of their logarithm where they change by that.
    """

    nodes: Moment
    channels: Moment
    room: Moment
    heats: Moment
    common: Moment
    values: Moment


def moments(
    model: AugmentedModel, mean: Float[Array, " state"], covariance: Float[Array, "state state"]
) -> Moments:
    """The moments of each part."""
    layout = model.layout
    seen = model.read(mean)
    error = mean[layout.of("common")].sum(keepdims=True)
    # Readings without their errors.
    of_errors = jnp.zeros(layout.size, bool)
    of_errors = of_errors.at[layout.of("common")].set(True).at[layout.of("channels")].set(True)
    sight = jnp.where(of_errors, 0.0, seen.slope)
    bare = seen.mean - error
    if layout.channels:
        bare = bare - mean[layout.of("channels")]

    def part(name: str, matrix: Array | None = None) -> Float[Array, "rows state"]:
        block = layout.of(name)
        picked = jnp.eye(layout.size, dtype=mean.dtype)[block]
        return picked if matrix is None else matrix @ picked

    def moment(value: Array, rows: Array) -> Moment:
        variance = jnp.einsum("rs,st,rt->r", rows, covariance, rows)
        return Moment(value, jnp.sqrt(jnp.maximum(variance, 0.0)))

    shapes, common = part("modes", model.shapes), part("common").sum(axis=0, keepdims=True)
    if model.directions is None:
        values = moment(jnp.zeros(0, mean.dtype), jnp.zeros((0, layout.size), mean.dtype))
    else:
        amounts = mean[layout.of("values")]
        rows = jax.jacfwd(model.directions.change)(amounts)
        values = moment(model.directions.change(amounts), part("values", rows))
    return Moments(
        nodes=moment(model.to_degC(model.deviation(mean)), shapes),
        channels=moment(model.to_degC(bare), sight),
        room=moment(model.to_degC(mean[layout.of("room")]), part("room")),
        heats=moment(mean[layout.of("heats")], part("heats")),
        common=moment(error, common),
        values=values,
    )


class Estimate(NamedTuple):
    """An estimated quantity over time: its mean, and the edges of its 95 % band."""

    mean: Float[np.ndarray, "*times"]
    lower: Float[np.ndarray, "*times"]
    upper: Float[np.ndarray, "*times"]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Estimates:
    """The state of a rig at each sample, with 95 % bands.

    All of these are estimates, not measurements; most belong to places that no channel sees.

    **Arguments:**

    - `kind`: `"filtered"`, given the readings up to each time; or `"smoothed"`, given all.
    - `time`: s. `nodes`, `channels`, `cells`: names.
    - `moments`: means and standard deviations.
    - `directions`: the uncertain values, None for none.
    """

    kind: str
    time: Float[np.ndarray, " times"]
    nodes: tuple[str, ...]
    channels: tuple[str, ...]
    cells: tuple[str, ...]
    moments: Moments
    directions: UncertainDirections | None

    def node(self, name: str) -> Estimate:
        """The temperature of a node, degC, such as the side of a cell that no camera sees.

        **Raises:** `ObserverError` for a node that the rig does not have.
        """
        return _picked("node", name, self.nodes, self.moments.nodes)

    def channel(self, name: str) -> Estimate:
        """What a channel sees, without the errors of its readings, degC.

        **Raises:** `ObserverError` for a channel that was not recorded.
        """
        return _picked("channel", name, self.channels, self.moments.channels)

    def heat(self, cell: str) -> Estimate:
        """The heat into the node that a cell heats which the twin does not explain, W.

        **Raises:** `ObserverError` for a cell that the rig does not have.
        """
        return _picked("heat", cell, self.cells, self.moments.heats)

    @property
    def room(self) -> Estimate:
        """The room temperature, degC."""
        return _estimate(self.moments.room, 0)

    @property
    def common_error(self) -> Estimate:
        """The error that the readings of all channels share, K."""
        return _estimate(self.moments.common, 0)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Parameter -> its value over time, in the unit of the rig's table; empty for a twin whose
        values are taken as exact."""
        if self.directions is None:
            return {}
        table = parameter_estimates(self.directions, self.moments.values)
        return {
            name: Estimate(*(part[:, number] for part in table))
            for number, name in enumerate(self.directions.names)
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: node (time, node), channel_temperature (time, channel), heat
        (time, cell), room, common_error (time) and parameter (time, name), each with its standard
        deviation under the same name and `_spread`; for parameters `parameter_lower` and
        `parameter_upper`. The attribute `status` says that they are estimates."""
        variables: dict[str, Any] = {"time": ("time", self.time, "s")}
        for name, moment, dimensions, unit in (
            ("node", self.moments.nodes, "time node_name", "degC"),
            ("channel_temperature", self.moments.channels, "time channel", "degC"),
            ("heat", self.moments.heats, "time cell", "W"),
            ("room", _only(self.moments.room), "time", "degC"),
            ("common_error", _only(self.moments.common), "time", "K"),
        ):
            variables[name] = (dimensions, moment.mean, unit)
            spread_unit = "K" if unit == "degC" else unit
            variables[f"{name}_spread"] = (dimensions, moment.spread, spread_unit)
        labels = {"node_name": self.nodes, "channel": self.channels, "cell": self.cells}
        parameters = self.parameters
        if parameters:
            labels["parameter_name"] = tuple(parameters)
            for suffix, place in (("", 0), ("_lower", 1), ("_upper", 2)):
                table = np.stack([parameter[place] for parameter in parameters.values()], axis=1)
                variables[f"parameter{suffix}"] = ("time parameter_name", table)
        return dataset(variables, {"status": f"estimates, {self.kind}"}, **labels)

    def __repr__(self) -> str:
        return (
            f"<{self.kind.capitalize()} estimates of {len(self.nodes)} nodes at "
            f"{len(self.time)} times>"
        )


def parameter_estimates(directions: UncertainDirections | None, changes: Moment) -> Estimate:
    """The uncertain parameters, in the units of the rig's table, for the moments of their changes;
    the last axis of all arrays is that of the parameters."""
    mean, spread = (np.asarray(part) for part in changes)
    if directions is None:
        return Estimate(mean, mean, mean)
    is_logarithmic, values = np.array(directions.is_logarithmic), np.asarray(directions.values)

    def value(change: np.ndarray) -> np.ndarray:
        changed = values * np.exp(np.where(is_logarithmic, change, 0.0))
        return np.where(is_logarithmic, changed, values + change)

    return Estimate(*(value(mean + side * QUANTILE_975 * spread) for side in (0, -1, 1)))


def _only(moment: Moment) -> Moment:
    return Moment(*(np.asarray(part)[:, 0] for part in moment))


def _picked(kind: str, name: str, names: tuple[str, ...], moment: Moment) -> Estimate:
    if name not in names:
        raise ObserverError(
            f"{kind}: expected one of {', '.join(names)}, got {name!r}{did_you_mean([name], names)}"
        )
    return _estimate(moment, names.index(name))


def _estimate(moment: Moment, column: int) -> Estimate:
    mean, spread = (np.asarray(part)[:, column] for part in moment)
    return Estimate(mean, mean - QUANTILE_975 * spread, mean + QUANTILE_975 * spread)
